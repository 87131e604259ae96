"""Beginning with another session: a file, a new one, an imported one, the demo, or a bridge that runs already."""

from __future__ import annotations

import asyncio
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.control.control_sockets import SUFFIX
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import BY_ID
from rsb_console.operations.save_operations import not_saved
from rsb_console.screens.dialog import ConfirmScreen, OfferScreen

if TYPE_CHECKING:
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.session import Session
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen


class SessionQuestion(Wording):
    """Questions about a session, and the reasons for them."""

    NOT_SAVED = "Not saved (w saves): {changes}."
    GOES_ON_UNSAVED = "It goes on with unsaved changes, which a restart loses (w saves): {changes}."
    ALREADY_RUNS = "{name} already runs here. Attach to it?"


async def confirm_end(console: Console, title: str, yes: str, then: Effect = Effect.MOVES, means: str = "") -> bool:
    """Return whether the session may end. Asks first if a bridge is shown or changes are not saved.

    Args:
        yes: the label of the button that ends the session.
        then: the effect of the next step; usually another session runs.
        means: the effect on the bridge in words, if it does not just stop, or an empty string.
    """
    while True:
        lost, reasons = not_saved(console), []
        if console.attached_to:
            reasons.append(f"The bridge {console.attached_to} goes on; only this console leaves it.")
        elif means:
            reasons.append(means)
        elif console.linked:
            reasons.append("The bridge stops: no topic crosses any more.")
        elif console.snapshot().running:
            reasons.append("The bridge stops: nothing can link to it any more.")
        if lost:
            text = SessionQuestion.GOES_ON_UNSAVED if console.attached_to else SessionQuestion.NOT_SAVED
            reasons.append(text(changes=lost))
        if not reasons:
            return True
        effect = then if console.attached_to else then | Effect.LOSES
        if not await console.ask(ConfirmScreen(title, "\n".join(reasons), yes, effect)):
            return False
        # Others may have changed something while the question stood, which would be lost unnamed.
        if not_saved(console) in ("", lost):
            return True


async def welcome(screen: MainScreen) -> None:
    """Offer all ways to begin, until one has led to a session."""
    from rsb_console.screens.welcome_screen import WelcomeScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    while choice := await console.ask(WelcomeScreen(await _running(), readonly=console.readonly)):
        if choice == "quit":
            console.request_quit()
            return
        await _begin(screen, choice)
        if console.engine is not None:
            return


async def _running() -> list[RunningBridge]:
    """Return the bridges on this machine, without this console's own."""
    from rsb_bridge.control.bridges import running_bridges  # noqa: PLC0415 -- keeps the start short

    return [each for each in await asyncio.to_thread(running_bridges) if each.pid != os.getpid()]


async def attach_instead(screen: MainScreen, running: RunningBridge) -> None:
    """Offer to attach to the bridge that runs a session already, or all ways to begin; watching only, attach."""
    console = screen.console
    message = f"{running}\n\nA second bridge of one session would take the link away from the first."
    title = SessionQuestion.ALREADY_RUNS(name=running.name)
    if console.readonly or await console.ask(OfferScreen(title, message, "Attach")):
        await console.attach(running.path)
    else:
        await welcome(screen)


async def _begin(screen: MainScreen, choice: str) -> None:
    """Begin with the choice of a dialog: an action, or the path of a session file or of a control socket."""
    if choice in BY_ID:
        if (run := BY_ID[choice].run) and (doing := run(screen)):
            await doing
    elif choice.endswith(SUFFIX):
        await screen.console.attach(Path(choice))
    else:
        await _open(screen.console, Path(choice))


async def sessions(screen: MainScreen) -> None:
    from rsb_console.screens.session_files import SessionsScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    runs, path = console.engine is not None, ""
    while chosen := await console.ask(SessionsScreen(path, runs=runs, readonly=console.readonly)):
        if isinstance(chosen, str):
            await _begin(screen, chosen)
            return
        if await _run(console, chosen.session, chosen.path):
            return
        # After a no, the dialog comes back with the choices made.
        path = str(chosen.path)


async def _open(console: Console, path: Path) -> None:
    from rsb_bridge.config.session_file import SessionError, load  # noqa: PLC0415 -- not needed without a file

    try:
        session = load(path)
    except SessionError as error:
        console.notify(str(error), title="Not opened", severity="error", markup=False, timeout=15)
    else:
        await _run(console, session, path)


async def new_session(screen: MainScreen, server_ip: str = "") -> None:
    from rsb_console.screens.new_session import NewSessionScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    new = await console.ask(NewSessionScreen(console, partial(may_run, console), server_ip))
    if new is not None:
        await console.run_session(new.session, new.path)


async def may_run(console: Console, path: Path) -> bool:
    """Whether the operator agrees to run the session of a file instead of the present one."""
    return await confirm_end(console, f"Run {path.name} instead?", "Run")


async def _run(console: Console, session: Session, path: Path) -> bool:
    """Run a session instead of the present one, if the operator agrees; whether they did."""
    agreed = await may_run(console, path)
    if agreed:
        await console.run_session(session, path)
    return agreed


async def bluetooth(screen: MainScreen) -> None:
    """Scan for Bluetooth; a device that is picked becomes the server of a new session."""
    from rsb_console.screens.bluetooth_screen import BluetoothScreen  # noqa: PLC0415 -- needs D-Bus

    console = screen.console
    address = await console.ask(BluetoothScreen(console))
    if address is not None:
        await new_session(screen, address)
