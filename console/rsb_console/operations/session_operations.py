"""Sessions and what belongs to them (the registry's `Group.SESSION`): files, keys, links, Bluetooth."""

from __future__ import annotations

import asyncio
import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.control_sockets import SUFFIX
from rsb_bridge.model.commands import Effect, Save
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.session import Session
    from rsb_console.console_api import Console

_ANOTHER_DEMO = "This robot and its bridges end; a new robot starts, with the demo's first topics."


class SessionQuestion(Wording):
    """Questions about a session, and the reasons for them."""

    NOT_SAVED = "Not saved (w saves): {changes}."
    GOES_ON_UNSAVED = "It goes on with unsaved changes, which a restart loses (w saves): {changes}."
    UNNAMED = "its session differs from its file"
    SAVE_THERE = "Save the session of {name} to its file?"
    SAVES_THERE = "The bridge writes the file on its machine. Comments stay, and a backup is kept there."
    ALREADY_RUNS = "{name} already runs here. Attach to it?"


class SessionOperations:
    """Methods named after their actions, each run as a worker; a new one cancels the one before.

    Args:
        reload: has the bridge do what its session file says now, after a question.
    """

    def __init__(self, console: Console, reload: Callable[[], Awaitable[None]]) -> None:
        self._console = console
        self._reload = reload

    async def confirm_end(self, title: str, yes: str, then: Effect = Effect.MOVES, means: str = "") -> bool:
        """Return whether the session may end. Asks first if a bridge is shown or changes are not saved.

        Args:
            yes: the label of the button that ends the session.
            then: the effect of the next step; usually another session runs.
            means: the effect on the bridge in words, if it does not just stop, or an empty string.
        """
        from rsb_console.screens.dialog import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        while True:
            lost, reasons = self._not_saved(), []
            if self._console.attached_to:
                reasons.append(f"The bridge {self._console.attached_to} goes on; only this console leaves it.")
            elif means:
                reasons.append(means)
            elif self._console.linked:
                reasons.append("The bridge stops: no topic crosses any more.")
            elif self._console.snapshot().running:
                reasons.append("The bridge stops: nothing can link to it any more.")
            if lost:
                text = SessionQuestion.GOES_ON_UNSAVED if self._console.attached_to else SessionQuestion.NOT_SAVED
                reasons.append(text(changes=lost))
            if not reasons:
                return True
            effect = then if self._console.attached_to else then | Effect.LOSES
            if not await self._console.ask(ConfirmScreen(title, "\n".join(reasons), yes, effect)):
                return False
            # Others may have changed something while the question stood, which would be lost unnamed.
            if self._not_saved() in ("", lost):
                return True

    def _not_saved(self) -> str:
        """Return in words what is in no file, or an empty string."""
        from rsb_console.session.saving import file_of, unsaved  # noqa: PLC0415 -- keeps the start short

        engine, saved, path = self._console.engine, self._console.saved, self._console.path
        if engine is None or (path is not None and not self._console.snapshot().unsaved):
            return ""
        if saved is None:
            return SessionQuestion.UNNAMED() if self._console.snapshot().unsaved else ""
        # Somebody else may have saved the same.
        if path is not None and file_of(path, engine.session) is not None:
            return ""
        return unsaved(saved, engine.session)

    # --- choosing a session

    async def welcome(self) -> None:
        """Offer all ways to begin, until one has led to a session."""
        from rsb_console.screens.session_files import WelcomeScreen  # noqa: PLC0415 -- keeps the start short

        while choice := await self._console.ask(WelcomeScreen(await self._running(), readonly=self._console.readonly)):
            if choice == "quit":
                self._console.request_quit()
                return
            await self._begin(choice)
            if self._console.engine is not None:
                return

    async def _running(self) -> list[RunningBridge]:
        """Return the bridges on this machine, without this console's own."""
        from rsb_bridge.control.bridges import running_bridges  # noqa: PLC0415 -- keeps the start short

        return [each for each in await asyncio.to_thread(running_bridges) if each.pid != os.getpid()]

    async def attach_instead(self, running: RunningBridge) -> None:
        """Offer to attach to the bridge that runs a session already, or all ways to begin; watching only, attach."""
        from rsb_console.screens.dialog import OfferScreen  # noqa: PLC0415 -- keeps the start short

        message = f"{running}\n\nA second bridge of one session would take the link away from the first."
        title = SessionQuestion.ALREADY_RUNS(name=running.name)
        if self._console.readonly or await self._console.ask(OfferScreen(title, message, "Attach")):
            await self._console.attach(running.path)
        else:
            await self.welcome()

    async def _begin(self, choice: str) -> None:
        """Begin with the choice of a dialog: an action, or the path of a session file or of a control socket."""
        actions = {
            "demo": self.demo,
            "new_session": self.new_session,
            "import_session": self.import_session,
            "sessions": self.sessions,
            "save": self.save,
            "save_as": self.save_as,
        }
        if choice in actions:
            await actions[choice]()
        elif choice.endswith(SUFFIX):
            await self._console.attach(Path(choice))
        else:
            await self._open(Path(choice))

    async def sessions(self) -> None:
        from rsb_console.screens.session_files import SessionsScreen  # noqa: PLC0415 -- keeps the start short

        runs, path = self._console.engine is not None, ""
        while chosen := await self._console.ask(SessionsScreen(path, runs=runs, readonly=self._console.readonly)):
            if isinstance(chosen, str):
                await self._begin(chosen)
                return
            if await self._run(chosen.session, chosen.path):
                return
            # After a no, the dialog comes back with the choices made.
            path = str(chosen.path)

    async def _open(self, path: Path) -> None:
        from rsb_bridge.config.session_file import SessionError, load  # noqa: PLC0415 -- not needed without a file

        try:
            session = load(path)
        except SessionError as error:
            self._console.notify(str(error), title="Not opened", severity="error", markup=False, timeout=15)
        else:
            await self._run(session, path)

    async def new_session(self, server_ip: str = "") -> None:
        from rsb_console.screens.new_session import NewSessionScreen  # noqa: PLC0415 -- keeps the start short

        new = await self._console.ask(NewSessionScreen(self._console, self._may_run, server_ip))
        if new is not None:
            await self._console.run_session(new.session, new.path)

    async def import_session(self) -> None:
        """Import a file of another bridge."""
        from rsb_console.screens.new_session import ImportScreen  # noqa: PLC0415 -- keeps the start short

        imported = await self._console.ask(ImportScreen(self._console, self._may_run))
        if imported is not None:
            await self._console.run_session(imported.session, imported.path)

    async def demo(self) -> None:
        """Run the demo: a simulated robot on this machine."""
        from rsb_console.session.demo_session import running_demo  # noqa: PLC0415 -- keeps the start short

        runs = self._console.temporary and self._console.engine is not None
        if runs and self._console.snapshot().running:
            title = "The demo runs already. Start it again?"
            agreed = await self.confirm_end(title, "Start again", means=_ANOTHER_DEMO)
        else:
            agreed = await self.confirm_end("Run the demo instead?", "Run")
        if not agreed:
            return
        self._console.notify("the simulated robot starts …", timeout=3)
        resources = contextlib.ExitStack()
        starting = asyncio.ensure_future(asyncio.to_thread(resources.enter_context, running_demo()))
        try:
            # The thread cannot be cancelled: what it starts has to be ended once it is there.
            demo = await asyncio.shield(starting)
        except EngineError as error:
            self._console.notify(str(error), title="No demo", severity="error", markup=False, timeout=15)
        except asyncio.CancelledError:
            starting.add_done_callback(lambda _: resources.close())
            raise
        else:
            await self._console.run_session(demo.session, demo.path, resources, temporary=True)

    async def _may_run(self, path: Path) -> bool:
        """Whether the operator agrees to run the session of a file instead of the present one."""
        return await self.confirm_end(f"Run {path.name} instead?", "Run")

    async def _run(self, session: Session, path: Path) -> bool:
        """Run a session instead of the present one, if the operator agrees; whether they did."""
        agreed = await self._may_run(path)
        if agreed:
            await self._console.run_session(session, path)
        return agreed

    # --- saving it

    async def save(self) -> None:
        """Save the session with the topics it has now."""
        if self._console.path is not None:
            await self._save_to(self._console.path)
        elif self._console.snapshot().unsaved:
            await self._save_there()
        else:
            await self.save_as()

    async def _save_there(self) -> None:
        """Have a bridge on another machine save its session."""
        from rsb_console.screens.dialog import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine, title = self._console.engine, SessionQuestion.SAVE_THERE(name=self._console.attached_to)
        question = ConfirmScreen(title, SessionQuestion.SAVES_THERE(), "Save", Effect.LOSES)
        if engine is not None and await self._console.ask(question):
            await self._console.command(engine.do(Save()), "saved")

    async def save_as(self) -> None:
        from rsb_console.screens.session_files import SaveAsScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            self._console.notify("nothing to save: no session runs")
            return
        path: Path | None = self._console.path or Path(f"{engine.session.name}.yaml")
        while path is not None and (path := await self._console.ask(SaveAsScreen(path))) is not None:
            if await self._save_to(path):
                return

    async def _save_to(self, path: Path) -> bool:
        """Save the session to a file. Return False if the operator may name another one."""
        from rsb_bridge.config.session_file import open_file  # noqa: PLC0415 -- not needed without a file
        from rsb_console.screens.session_files import ChangedScreen, save_elsewhere  # noqa: PLC0415 -- keeps the start short
        from rsb_console.session.saving import file_of, is_changed  # noqa: PLC0415 -- keeps the start short

        engine, opened = self._console.engine, self._console.file
        if engine is None:
            return True
        session = engine.session
        if opened is not None and opened.is_at(path) and is_changed(opened):
            # Nothing of somebody else's is lost if the file says what runs, or still what it said when it was opened.
            if file_of(path, session) is None and file_of(path, opened.session) is None:
                match await self._console.ask(ChangedScreen(path)):
                    case "reload":
                        await self._reload()
                        return True
                    case "save_as":
                        await self.save_as()
                        return True
                    case "overwrite":
                        pass
                    case _:
                        return False
            # This keeps the comments that the file has now.
            opened = open_file(path)
        if await save_elsewhere(self._console, session, path, opened):
            self._console.saved_to(session, path)
            own = self._console.path
            if self._console.attached_to and own is not None and own.resolve() == path.resolve():  # noqa: ASYNC240 -- as all files of a session here
                await self._console.command(engine.do(Save()))  # it finds its session in the file
            return True
        return False

    # --- looking at what belongs to it

    async def keys(self) -> None:
        from rsb_console.screens.keys_screen import KeysScreen  # noqa: PLC0415 -- keeps the start short

        await self._console.ask(KeysScreen(self._console))

    async def links(self) -> None:
        from rsb_console.screens.links_screen import LinksScreen  # noqa: PLC0415 -- keeps the start short

        await self._console.ask(LinksScreen(self._console))

    async def bluetooth(self) -> None:
        """Scan for Bluetooth; a device that is picked becomes the server of a new session."""
        from rsb_console.screens.bluetooth_screen import BluetoothScreen  # noqa: PLC0415 -- needs D-Bus

        address = await self._console.ask(BluetoothScreen(self._console))
        if address is not None:
            await self.new_session(address)
