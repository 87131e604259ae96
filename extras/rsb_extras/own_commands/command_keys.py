"""The keys of own commands: the values at the cursor, the question, and the start."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from contextvars import copy_context
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Effect, Wording, escape_text
from rsb_console.feature_console import ConfirmScreen
from rsb_console.notation.formats import PatternRow, RowText
from rsb_extras.own_commands.interactive import run_in_terminal
from rsb_extras.own_commands.output_screen import OutputScreen, code_text, end_of
from rsb_extras.own_commands.own_command import UnsafeValueError
from rsb_extras.own_commands.running import RUNNING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.feature_api import LinkSnapshot, RouteSnapshot
    from rsb_console.feature_console import Console, MainScreen
    from rsb_extras.own_commands.own_command import OwnCommand
    from rsb_extras.own_commands.running import RunningCommand

MOST = 8
"""Commands at once: a round figure. An operator follows fewer, and a held key starts no more."""


class OwnCommandText(Wording):
    """Questions and notes about own commands."""

    ASKS = "Run {name}?"
    UNSAFE = 'not run: the {name} "{value}" is no plain word, and a shell might run parts of it'
    EMPTY = "not run: the {name} is not known yet"
    TOO_MANY = "not run: {most} of your commands run already; stop one on its pane with s"
    NOT_STARTED = "not run: {error}"
    ENDED = "{name}: {end}"


def link_at_cursor(screen: MainScreen) -> LinkSnapshot | None:
    """Return the link of the topic under the cursor, or the only one."""
    links, row = screen.console.snapshot().links, screen.topics.selected
    if row is None:
        return links[0] if len(links) == 1 else None
    return next((link for link in links if link.name == row.link), None)


def has_link(_command: OwnCommand, screen: MainScreen) -> bool | None:
    return link_at_cursor(screen) is not None or None


async def run_on_main(command: OwnCommand, screen: MainScreen) -> None:
    """Run a command on what is under the main screen's cursor."""
    if command.where == "topic":
        row = screen.topics.selected
        if isinstance(row, PatternRow):
            screen.notify(RowText.IS_PATTERN(topic=row.topic), markup=False, timeout=4)
        elif row is not None:
            await _run(command, screen.console, values_of_topic(screen.console, row))
    elif command.where == "link":
        link = link_at_cursor(screen)
        if link is not None:
            await run_on_link(command, screen.console, link)
    else:
        await _run(command, screen.console, {})


async def run_on_link(command: OwnCommand, console: Console, link: LinkSnapshot) -> None:
    await _run(command, console, {"robot": robot_of(console, link.name), "link": link.name, "state": link.state.value})


def values_of_topic(console: Console, route: RouteSnapshot) -> Mapping[str, str]:
    return {
        "robot": robot_of(console, route.link), "link": route.link, "topic": route.topic, "type": route.type_name,
        "state": route.state.value,
    }  # fmt: skip


def robot_of(console: Console, link: str) -> str:
    """Return the other side's name on a server, and its host on a client, whose link has the client's own name."""
    now = console.snapshot()
    if now.role != "client":
        return link
    address = now.address.partition(" ")[0]  # behind a Bluetooth address, the channel follows
    host, _, port = address.rpartition(":")
    return host.strip("[]") if host and port.isdecimal() and " " not in now.address else address


async def _run(command: OwnCommand, console: Console, values: Mapping[str, str]) -> None:
    """Run a command, after a question if it needs one, and show its output; or show it if it runs already."""
    try:
        line = command.line(values)
    except UnsafeValueError as error:
        text = OwnCommandText.UNSAFE if error.value else OwnCommandText.EMPTY
        _warn(console, text(name=error.name, value=escape_text(error.value)))
        return
    running = RUNNING.find(line)
    if running is None:
        if len(RUNNING) >= MOST:
            _warn(console, OwnCommandText.TOO_MANY(most=MOST))
            return
        # On a late key, too: what runs may move a robot.
        question = ConfirmScreen(OwnCommandText.ASKS(name=command.description), line, "Run", Effect.MOVES)
        if command.confirm and await console.ask(question) is not True:
            return
        try:
            if command.interactive:
                code = await run_in_terminal(console, line)
                console.notify(OwnCommandText.ENDED(name=command.description, end=code_text(code)), markup=False)
                return
            running = RUNNING.start(line, _on_this_loop(partial(_tell_end, console, command)))
        except OSError as error:
            _warn(console, OwnCommandText.NOT_STARTED(error=error.strerror or error))
            return
    await console.ask(OutputScreen(console, command.description, running))


def _on_this_loop(tell: Callable[[RunningCommand], None]) -> Callable[[RunningCommand], None]:
    """Return a function that calls `tell` on the app's loop, from another thread."""
    loop, context = asyncio.get_running_loop(), copy_context()

    def call(running: RunningCommand) -> None:
        with suppress(RuntimeError):  # the console has ended
            loop.call_soon_threadsafe(tell, running, context=context)

    return call


def _tell_end(console: Console, command: OwnCommand, running: RunningCommand) -> None:
    """Tell how a command has ended whose pane is closed."""
    if not running.is_shown:
        end = OwnCommandText.ENDED(name=command.description, end=end_of(running))
        console.notify(end, severity="warning" if running.code else "information", markup=False, timeout=8)


def _warn(console: Console, text: str) -> None:
    console.notify(text, severity="warning", markup=False, timeout=6)
