"""The output of an own command, while it runs and after its end."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, ClassVar

from rich.cells import cell_len
from textual.binding import Binding
from textual.content import Content

from rsb_bridge.feature_api import escape_text, one_line
from rsb_console.feature_console import DONE, FAILED, FullScreen, ScrolledLines, clip
from rsb_console.notation import formats
from rsb_console.screens.dialog import RUNNING
from rsb_console.terminal.driver import copy
from rsb_extras.own_commands.running import KEPT_LINES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

    from rsb_console.feature_console import Console, Line
    from rsb_extras.own_commands.running import RunningCommand

_LOOK_EVERY = 0.2
"""s between two looks at the output: as often as an operator reads another line."""
_KEYS, _KEYS_WHILE_IT_RUNS = " esc close · y copy ", " esc close, it goes on · s stop · y copy "


def end_of(command: RunningCommand) -> str:
    """Return how a command has ended, in words."""
    return f"{code_text(command.code or 0)} after {formats.age(command.seconds)}"


def code_text(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:  # a real-time one
        name = f"signal {-code}"
    return f"ended by {name}"


def wrapped(text: str, width: int) -> Iterator[str]:
    """Cut a line into pieces that fit."""
    while cell_len(text) > width > 1:
        piece = clip(text, width)
        yield piece
        text = text[len(piece) :]
    yield text


class OutputPane(ScrolledLines):
    """Its first line, the state, stays at the top."""

    sticky = 1


class OutputScreen(FullScreen[None]):
    """Shows a command's output and follows it, unless the operator has scrolled up.

    Attributes:
        command: the command that it shows.
    """

    BINDINGS: ClassVar = [
        Binding("escape,q,enter", "dismiss", show=False),
        Binding("s", "stop", show=False),
        Binding("y", "copy", show=False),
    ]

    def __init__(self, console: Console, title: str, command: RunningCommand) -> None:
        super().__init__()
        self.console, self._title, self.command = console, title, command
        command.is_shown = True  # not later: it may end at once
        self._drawn: tuple[object, ...] = ()

    def compose(self) -> ComposeResult:
        self._pane = OutputPane(classes="dialog -whole")
        self._pane.border_title = Content(f" {escape_text(self._title)} ")
        yield self._pane

    def on_mount(self) -> None:
        self.set_interval(_LOOK_EVERY, self._draw)
        self.call_after_refresh(self._draw)

    def on_unmount(self) -> None:
        self.command.is_shown = False

    def on_resize(self) -> None:
        self.call_after_refresh(self._draw)

    def _draw(self) -> None:
        """Show the output, if there is more, and the state."""
        if not self._pane.is_attached:
            return
        command, pane = self.command, self._pane
        width = pane.scrollable_content_region.width
        now = command.output.changes, self._state(), width
        if now != self._drawn:
            self._drawn = now
            follows = pane.scroll_offset.y >= pane.max_scroll_y - 1
            self._pane.border_subtitle = Content(_KEYS_WHILE_IT_RUNS if command.code is None else _KEYS)
            pane.show([self._state(), *self._output(width)])
            if follows:
                pane.scroll_end(animate=False)

    def _state(self) -> Line:
        command = self.command
        if command.code is None:
            doing = "stops: what has not ended in 3 s is killed" if command.is_stopping else "runs"
            state, look = f"{RUNNING} {doing}, {formats.age(self.console.as_seen(command.seconds))}", "waiting"
        elif command.code == 0:
            state, look = f"{DONE} {end_of(command)}", "ok"
        else:
            state, look = f"{FAILED} {end_of(command)}", "down"
        return ((state, look),)

    def _output(self, width: int) -> Iterator[Line]:
        output = self.command.output
        for line in f"$ {self.command.line}".splitlines():
            yield from (((piece, "dim"),) for piece in wrapped(one_line(line.expandtabs()), width))
        if output.dropped:
            yield ((f"… only the last {formats.thousands(KEPT_LINES)} lines are kept", "stale"),)
        for line in output.lines:
            yield from (((piece, ""),) for piece in wrapped(line, width))

    def action_stop(self) -> None:
        self.command.stop()
        self._draw()

    def action_copy(self) -> None:
        self.notify(copy(self.app, "\n".join(self.command.output.lines)), timeout=3, markup=False)
