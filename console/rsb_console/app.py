"""The Textual app of the console, around an engine that never waits for it."""

from __future__ import annotations

import asyncio
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from textual import events, work
from textual.app import App

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import Snapshot, State
from rsb_console.actions.registry import BY_ID, Action, Group, bindings
from rsb_console.look import themes
from rsb_console.look.glyphs import AsciiFilter, ControlFilter
from rsb_console.operations.bridge import BridgeOperations
from rsb_console.operations.deadman import Deadman
from rsb_console.operations.sessions import SessionOperations
from rsb_console.preferences import Preferences
from rsb_console.screens.main import MainScreen
from rsb_console.screens.palette import ActionsProvider
from rsb_console.terminal.driver import ConsoleDriver
from rsb_console.terminal.input_queue import DIALOG, InputQueue
from rsb_console.terminal.shutdown import ForcedEnd, ShutdownReason, record_crash

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future

    from textual.filter import LineFilter
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.control.server import ControlServer
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console import Console

    MakeEngine = Callable[[Session, Path], EngineApi]
    Serve = Callable[[EngineApi, Session, Path | None], tuple[ControlServer | None, RunningBridge | None]]

T = TypeVar("T")
REFRESH_RATES = (0.5, 1.0, 2.0, 4.0, 10.0)  # Hz
LOCAL_RATE, SSH_RATE = 4.0, 2.0


class ConsoleApp(App[None]):
    """Fulfils `rsb_console.console.Console`: owns the engine, the user's preferences, and the main screen.

    Args:
        session: to run; None: none yet.
        path: the session's file; None: it is in no file.
        readonly: nothing may be changed.
        ascii_only: draw only ASCII.
        theme: its name; None: the one that suits the terminal.
        config: the user's configuration folder; None: the platform's.
        make_engine: makes an engine from a session and the folder of its key files.
        serve: serves an engine on a control socket, or finds the bridge that runs its session already; None: neither.
        attach_to: the control socket of a bridge to begin with, instead of a session; None: none.
        temporary: the session's file is deleted when the session ends.
    """

    TITLE = "rsb-console"
    CSS_PATH = "console.tcss"
    BINDINGS = bindings(Group.CONSOLE)
    COMMANDS: ClassVar = {ActionsProvider}

    def __init__(
        self,
        session: Session | None,
        path: Path | None,
        *,
        readonly: bool = False,
        ascii_only: bool = False,
        theme: str | None = None,
        config: Path | None = None,
        make_engine: MakeEngine | None = None,
        serve: Serve | None = None,
        attach_to: Path | None = None,
        temporary: bool = False,
    ) -> None:
        super().__init__(driver_class=ConsoleDriver)
        self.engine: EngineApi | None = None
        self.base = Path()
        self.path = path
        self.saved: Session | None = None
        self.file: SessionFile | None = None
        self.temporary = temporary
        self.readonly = readonly
        self.ascii_only = ascii_only
        self.note = "no session"
        self.refresh_rate = SSH_RATE if os.environ.get("SSH_CONNECTION") else LOCAL_RATE
        self.config = themes.config_path() if config is None else config
        self.preferences = Preferences(self.config, theme)
        self.shutdown_reason = ShutdownReason.QUIT
        self.input_queue = InputQueue(self, {Group.OPERATE, Group.SESSION})
        self.deadman = Deadman()
        self.terminal = 1
        """File descriptor of the terminal."""
        console: Console = self
        bridge = BridgeOperations(console, lambda: self.main.selected)
        self.sessions = SessionOperations(console, bridge.reload)
        self.main: MainScreen = MainScreen(console, {Group.OPERATE: bridge, Group.SESSION: self.sessions})
        self.attached_to = ""
        self._session = session
        self._attach_to = attach_to
        self._make_engine = make_engine or self._new_engine
        self._serve = serve
        self._server: ControlServer | None = None
        self._resources = ExitStack()
        self._changing = asyncio.Lock()
        """Held while an engine starts or stops: two at once would fight for the port."""
        self._forced_end = ForcedEnd(self.stop)
        self._filters_ascii = AsciiFilter()
        self._filters_control = ControlFilter()
        self._last_event = 0

    # --- start

    def get_default_screen(self) -> Screen[Any]:
        return self.main

    def get_theme_variable_defaults(self) -> dict[str, str]:
        """The style sheet's variables that a theme need not define (Textual's)."""
        return themes.VARIABLES

    def get_line_filters(self) -> Sequence[LineFilter]:
        filters = [*super().get_line_filters(), self._filters_control]
        return [*filters, self._filters_ascii] if self.ascii_only else filters

    def on_mount(self) -> None:
        """Set themes and keys, before the first picture."""
        for name in self.available_themes:
            self.unregister_theme(name)
        for theme in self.preferences.themes.values():
            self.register_theme(theme)
        self.theme = self.preferences.theme
        self.set_keymap(self.preferences.keymap)

    def on_ready(self) -> None:
        """Tell what is wrong with the preferences, and start the session, after the first picture."""
        for title, message in self.preferences.problems:
            self.notify(message, title=title, severity="warning", markup=False, timeout=15)
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)
        if self._attach_to is not None:
            self._attach_to_bridge(self._attach_to)
        elif self._session is not None:
            self._run_session(self._session, self.path, None, temporary=self.temporary)
        else:
            self.main.run_worker(self.sessions.welcome(), group=Group.SESSION, exclusive=True)

    def key_labels(self, action: Action) -> list[str]:
        return self.preferences.key_labels(action, ascii_only=self.ascii_only)

    # --- the session

    async def run_session(
        self, session: Session, path: Path | None, resources: ExitStack | None = None, *, temporary: bool = False
    ) -> None:
        worker = self._run_session(session, path, resources, temporary=temporary)
        await asyncio.shield(worker.wait())  # whoever waits may be cancelled; a start may not

    @work(group="session")
    async def _run_session(
        self, session: Session, path: Path | None, resources: ExitStack | None, *, temporary: bool
    ) -> None:
        async with self._changing:
            self.note = "stopping"
            await asyncio.to_thread(self.stop)
            self._resources = resources or ExitStack()
            self.base = Path() if path is None else path.parent
            self.temporary = temporary
            if temporary:
                self.path = self.saved = self.file = None
            else:
                self.saved_to(session, path)
            await self._start(session)

    async def start_again(self) -> None:
        if self._changing.locked():
            self.notify(f"the bridge is {self.note}", timeout=3)
        else:
            await asyncio.shield(self._start_again().wait())

    @work(group="session")
    async def _start_again(self) -> None:
        async with self._changing:
            if self.engine is not None and not self.attached_to:
                await asyncio.to_thread(self._stop_engine)
                await self._start(self.engine.session)

    async def _start(self, session: Session) -> None:
        self.note, self._last_event = "starting", 0
        self.main.reset()
        self.attached_to = ""
        engine = self._make_engine(session, self.base)
        engine.use_file(self.path)
        if self._serve is not None:
            try:
                self._server, running = await asyncio.to_thread(self._serve, engine, session, self.path)
            except EngineError as error:
                running = None
                self.notify(str(error), title="Nobody can attach", severity="warning", markup=False, timeout=15)
            if running is not None:
                self.engine, self.note = None, "no session"
                self.main.run_worker(self.sessions.attach_instead(running), group=Group.SESSION, exclusive=True)
                return
        self.engine = engine
        try:
            await asyncio.to_thread(engine.start)
            self.note = ""
        except EngineError as error:
            self.note = "not started"
            self.notify(str(error), title="Not started", severity="error", markup=False, timeout=30)
        self.pull()

    def _new_engine(self, session: Session, base: Path) -> EngineApi:
        from rsb_bridge.engine import Engine  # noqa: PLC0415 -- the first picture comes before the engine's imports
        from rsb_bridge.history.folders import state_folder  # noqa: PLC0415 -- likewise

        return Engine(session, base=base, state=None if self.temporary else state_folder(os.environ))

    async def attach(self, path: Path) -> None:
        await asyncio.shield(self._attach_to_bridge(path).wait())

    @work(group="session")
    async def _attach_to_bridge(self, path: Path) -> None:
        from rsb_console.session.attaching import attach  # noqa: PLC0415 -- keeps the start short

        async with self._changing:
            self.note, self._last_event = "attaching", 0
            await asyncio.to_thread(self.stop)
            self._resources, self.engine, self.attached_to, self.temporary = ExitStack(), None, "", False
            self.main.reset()
            try:
                attached = await asyncio.to_thread(attach, path, read_only=self.readonly)
            except EngineError as error:
                self.note = "not attached"
                self.notify(str(error), title="Not attached", severity="error", markup=False, timeout=30)
                return
            self.engine, self.attached_to, self.note = attached.engine, attached.name, ""
            self.base, self.path, self.file, self.saved = attached.base, attached.path, attached.file, attached.saved

    def stop(self) -> None:
        """Stop the engine, or detach from it, and close the session's resources; may take some seconds."""
        self._stop_engine()
        self._resources.close()

    def _stop_engine(self) -> None:
        if self.engine is not None:
            self.engine.stop()
        if self._server is not None:
            self._server.close()
            self._server = None

    def saved_to(self, session: Session, path: Path | None) -> None:
        from rsb_console.session.recents import remember  # noqa: PLC0415 -- keeps the start short
        from rsb_console.session.saving import file_of  # noqa: PLC0415 -- keeps the start short

        self.path, self.saved = path, session
        if self.engine is not None:
            self.engine.use_file(path)
        self.file = None if path is None else file_of(path, session)
        if path is not None and path.is_file():
            try:
                remember(path)
            except OSError as error:
                self.notify(f"the list of recent sessions: {error}", severity="warning", markup=False)

    # --- the engine

    @property
    def linked(self) -> bool:
        return any(link.state is State.OK for link in self.snapshot().links)

    def snapshot(self) -> Snapshot:
        if self.engine is None:
            return Snapshot(time.time(), "", "", "", 0, running=False)
        return self.engine.snapshot()

    def peer_of(self, route: RouteSnapshot) -> str:
        now = self.snapshot()
        return now.address if now.role == "client" else route.link

    async def command(self, future: Future[T], done: str = "") -> bool:
        try:
            await asyncio.wrap_future(future)
        except EngineError as error:
            self.notify(str(error), title="Not done", severity="error", markup=False, timeout=10)
            return False
        if done:
            self.notify(done, markup=False, timeout=3)
        self.pull()
        return True

    def pull(self) -> None:
        if not self.screen_stack:  # the app is ending, and the timer not stopped yet
            return
        events = [] if self.engine is None else self.engine.events(self._last_event)
        if events:
            self._last_event = events[-1].number
        snapshot = self.snapshot()
        self.deadman.keep(self.engine, snapshot)
        self.main.show(snapshot, events)

    def change_refresh_rate(self, step: int) -> None:
        index = REFRESH_RATES.index(self.refresh_rate) + step
        self.refresh_rate = REFRESH_RATES[max(0, min(len(REFRESH_RATES) - 1, index))]
        self._pulling.stop()
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)
        self.pull()

    # --- actions

    async def ask(self, dialog: Screen[T]) -> T | None:
        self.input_queue.waits_for(dialog)
        return await self.push_screen_wait(dialog)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable the actions that change something while read-only (Textual's)."""
        known = BY_ID.get(action)
        if known is not None and known.changes and self.readonly:
            return False
        return super().check_action(action, parameters)

    def action_help(self) -> None:
        from rsb_console.screens.help import HelpScreen  # noqa: PLC0415 -- keeps the start short

        self.push_screen(HelpScreen(self))

    def action_help_quit(self) -> None:
        """Ctrl+C: Textual would only explain it; to an operator it means quit."""
        self.action_quit()

    def action_palette(self) -> None:
        self.action_command_palette()

    def action_theme(self) -> None:
        names = sorted(self.available_themes)
        self.theme = names[(names.index(self.theme) + 1) % len(names)]
        self.notify(f"theme: {self.theme}", timeout=2)

    def action_mouse(self) -> None:
        """Leave the mouse to the terminal, or take it back."""
        if isinstance(self._driver, ConsoleDriver):
            self._driver.mouse = not self._driver.mouse
            self.notify(
                "the mouse is the console's" if self._driver.mouse else "the mouse is the terminal's", timeout=3
            )

    def request_quit(self) -> None:
        self.action_quit()

    @work(exclusive=True, group=DIALOG)
    async def action_quit(self) -> None:  # type: ignore[override]  # a worker, because it asks
        if await self.sessions.confirm_end("Quit?", "Quit"):
            self.shut_down(ShutdownReason.QUIT)

    async def on_event(self, event: events.Event) -> None:
        """Handle an event as Textual does, but input only when it is its turn."""
        self.deadman.saw(event)
        if not self.input_queue.takes(event):
            await super().on_event(event)

    # --- end

    def shut_down(self, reason: ShutdownReason) -> None:
        """End the app; the engine goes on until `stop`."""
        self.shutdown_reason = reason
        self.exit()

    def shut_down_soon(self, reason: ShutdownReason) -> None:
        """As `shut_down`, from a signal handler or another thread; ends the process if the app hangs."""
        if not self.is_headless:
            self._forced_end.begin()
        self.call_later(self.shut_down, reason)

    def has_ended(self) -> None:
        """The app has ended by itself, so the process need not be ended."""
        self._forced_end.cancel()

    def terminal_gone(self) -> None:
        """The terminal has hung up; called by the driver's thread."""
        self.shut_down_soon(ShutdownReason.HANGUP)

    def _fatal_error(self) -> None:
        """Handle an unexpected error: Textual would print it with all local variables, which help no operator."""
        self.crashed()
        self._close_messages_no_wait()

    def crashed(self) -> None:
        """Keep the exception that is being handled, for a report."""
        self.shutdown_reason = ShutdownReason.CRASH
        record_crash()
