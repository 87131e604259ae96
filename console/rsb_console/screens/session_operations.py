"""What an operator does with sessions and what belongs to them: files, keys, links, Bluetooth, the demo."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from textual import work
from textual.screen import Screen

from rsb_bridge.api import EngineError

if TYPE_CHECKING:
    from rsb_bridge.model.session import Session
    from rsb_console.app import ConsoleApp


class SessionOperationsScreen(Screen[None]):
    """The handlers of the registry's `Group.SESSION`."""

    app: ConsoleApp

    async def may_end(self, title: str, yes: str) -> bool:
        """Whether the session may end: asks while it is linked, or changed and not saved.

        Args:
            title: of the question.
            yes: the label of the button that ends it.
        """
        from rsb_console.saving import unsaved  # noqa: PLC0415 -- keeps the start short
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine, saved, reasons = self.app.engine, self.app.saved, []
        if self.app.linked:
            reasons.append("The bridge is linked and stops: no topic crosses any more.")
        if engine is not None and saved is not None:
            changes = unsaved(saved, engine.session)
            if changes:
                reasons.append(f"Not saved (w saves): {changes}.")
        return not reasons or await self.app.push_screen_wait(ConfirmScreen(title, "\n".join(reasons), yes))

    async def _run(self, session: Session, path: Path) -> None:
        """Run a session in place of what runs, if the operator agrees."""
        if await self.may_end(f"Run {path.name} instead?", "Run"):
            await self.app.run_session(session, path).wait()

    @work(exclusive=True, group="session-dialog")
    async def action_welcome(self) -> None:
        """Choose what to begin with."""
        from rsb_console.screens.welcome import WelcomeScreen  # noqa: PLC0415 -- keeps the start short

        while choice := await self.app.push_screen_wait(WelcomeScreen(readonly=self.app.readonly)):
            if choice == "quit":
                self.app.action_quit()
                return
            await self._begin(choice)
            if self.app.engine is not None:
                return

    async def _begin(self, choice: str) -> None:
        """Do what was chosen: an action, or the path of a session."""
        ways = {
            "demo": self._demo,
            "new_session": self._new,
            "import_session": self._import,
            "sessions": self._sessions,
            "save": self._save,
            "save_as": self._save_as,
        }
        await (ways[choice]() if choice in ways else self._open(Path(choice)))

    @work(exclusive=True, group="session-dialog")
    async def action_sessions(self) -> None:
        """Open another session, or go to another way to get one."""
        await self._sessions()

    @work(exclusive=True, group="session-dialog")
    async def action_new_session(self) -> None:
        """Write a new session's file."""
        await self._new()

    @work(exclusive=True, group="session-dialog")
    async def action_import_session(self) -> None:
        """Import a thesis bringup.yaml."""
        await self._import()

    @work(exclusive=True, group="session-dialog")
    async def action_demo(self) -> None:
        """Run the demo."""
        await self._demo()

    @work(exclusive=True, group="session-dialog")
    async def action_save(self) -> None:
        """Save the session, as operators have changed it."""
        await self._save()

    @work(exclusive=True, group="session-dialog")
    async def action_save_as(self) -> None:
        """Save the session to another file."""
        await self._save_as()

    @work
    async def action_keys(self) -> None:
        """Look at the key files, or make a key."""
        from rsb_console.screens.keys import KeysScreen  # noqa: PLC0415 -- keeps the start short

        await self.app.push_screen_wait(KeysScreen())

    @work
    async def action_links(self) -> None:
        """Look at the links."""
        from rsb_console.screens.links import LinksScreen  # noqa: PLC0415 -- keeps the start short

        await self.app.push_screen_wait(LinksScreen())

    @work
    async def action_bluetooth(self) -> None:
        """Look for Bluetooth; a MAC that is picked begins a new session."""
        from rsb_console.screens.bluetooth import BluetoothScreen  # noqa: PLC0415 -- needs D-Bus

        address = await self.app.push_screen_wait(BluetoothScreen())
        if address is not None:
            await self._new(address)

    # -- how ----------------------------------------------------------------------------------------------------------

    async def _sessions(self) -> None:
        from rsb_console.screens.session_files import SessionsScreen  # noqa: PLC0415 -- keeps the start short

        chosen = await self.app.push_screen_wait(SessionsScreen(runs=self.app.engine is not None))
        if isinstance(chosen, str):
            await self._begin(chosen)
        elif chosen is not None:
            await self._run(chosen.session, chosen.path)

    async def _open(self, path: Path) -> None:
        from rsb_bridge.config.session_file import SessionError, load  # noqa: PLC0415 -- not needed without a file

        try:
            session = load(path)
        except SessionError as error:
            self.notify(str(error), title="Not opened", severity="error", markup=False, timeout=15)
        else:
            await self._run(session, path)

    async def _new(self, server_ip: str = "") -> None:
        from rsb_console.screens.new_session import NewSessionScreen  # noqa: PLC0415 -- keeps the start short

        new = await self.app.push_screen_wait(NewSessionScreen(server_ip))
        if new is not None:
            await self._run(new.session, new.path)

    async def _import(self) -> None:
        from rsb_console.screens.import_session import ImportScreen  # noqa: PLC0415 -- keeps the start short

        imported = await self.app.push_screen_wait(ImportScreen())
        if imported is not None:
            await self._run(imported.session, imported.path)

    async def _demo(self) -> None:
        from rsb_console.demo import running_demo  # noqa: PLC0415 -- keeps the start short

        if not await self.may_end("Run the demo instead?", "Run"):
            return
        self.notify("the simulated robot starts …", timeout=3)
        parts = contextlib.ExitStack()
        try:
            demo = await asyncio.to_thread(parts.enter_context, running_demo())
        except EngineError as error:
            self.notify(str(error), title="No demo", severity="error", markup=False, timeout=15)
        else:
            await self.app.run_session(demo.session, demo.path, parts, temporary=True).wait()

    async def _save(self) -> None:
        if self.app.path is None:
            await self._save_as()
        else:
            await self._save_to(self.app.path)

    async def _save_as(self) -> None:
        from rsb_console.screens.session_files import SaveAsScreen  # noqa: PLC0415 -- keeps the start short

        engine = self.app.engine
        if engine is None:
            self.notify("no session runs: there is nothing to save")
            return
        begin = self.app.path or Path(f"{engine.session.name}.yaml")
        path = await self.app.push_screen_wait(SaveAsScreen(begin))
        if path is not None:
            await self._save_to(path)

    async def _save_to(self, path: Path) -> None:
        from rsb_console.saving import save_elsewhere  # noqa: PLC0415 -- keeps the start short

        engine = self.app.engine
        if engine is None:
            return
        session = engine.session
        if await save_elsewhere(self.app, session, path):
            self.app.saved_to(session, path)
