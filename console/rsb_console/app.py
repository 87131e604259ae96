"""The operator console: a Textual app around an engine that never waits for it."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from textual import events, work
from textual.app import App

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import Snapshot
from rsb_console import theming
from rsb_console.actions import BY_ID, Action, Group, bindings
from rsb_console.glyphs import AsciiFilter, ControlFilter
from rsb_console.leaving import Leaving, finish, leave_on_signals, output_path, record_crash
from rsb_console.palette import ActionsProvider
from rsb_console.preferences import Preferences
from rsb_console.screens.main import MainScreen
from rsb_console.shell import FAILURE
from rsb_console.terminal import ConsoleDriver, prefers_ascii, terminal_to_itself

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from textual.filter import LineFilter
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import RouteSnapshot

    MakeEngine = Callable[[Session, Path], EngineApi]

REFRESH_RATES = (0.5, 1.0, 2.0, 4.0, 10.0)  # Hz
LOCAL_RATE, SSH_RATE = 4.0, 2.0
_LEFT_WITHIN = 10.0


class ConsoleApp(App[None]):
    """The app: owns the engine's life, the themes, and what all screens share.

    Args:
        session: what to run; None: nothing yet.
        path: the session's file; None: it is in none.
        readonly: nothing may be changed.
        ascii_only: draw nothing but ASCII.
        theme: its name; None: what suits the terminal.
        config: the user's folder; None: the platform's.
        make_engine: makes an engine of a session and the folder that its key files are relative to.
        temporary: the session's file ends with it: see `run_session`.
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
        temporary: bool = False,
    ) -> None:
        super().__init__(driver_class=ConsoleDriver)
        self.path = path
        self.readonly = readonly
        self.ascii_only = ascii_only
        self.config = theming.config_path() if config is None else config
        self.engine: EngineApi | None = None
        self.base = Path()
        self.saved: Session | None = None
        self.file: SessionFile | None = None
        self._belongings = ExitStack()
        self._changing = asyncio.Lock()
        """Held while an engine starts or stops: two at once would fight for the port."""
        self.leaving = Leaving.QUIT
        self._deadline: threading.Timer | None = None
        self.terminal = 1
        self.refresh_rate = SSH_RATE if os.environ.get("SSH_CONNECTION") else LOCAL_RATE
        self.note = "no session"
        self.main = MainScreen()
        self._session, self.temporary = session, temporary
        self._make_engine = make_engine or _make_engine
        self._filters_ascii = AsciiFilter()
        self._filters_control = ControlFilter()
        self.preferences = Preferences(self.config, theme)
        self._last_event = 0

    # -- start --------------------------------------------------------------------------------------------------------

    def get_default_screen(self) -> Screen[Any]:
        """The main screen is always the first."""
        return self.main

    def get_theme_variable_defaults(self) -> dict[str, str]:
        """What the style sheet needs of a theme that doesn't say."""
        return theming.VARIABLES

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Textual's, ours against control characters, and where nothing but ASCII may go out, that one."""
        filters = [*super().get_line_filters(), self._filters_control]
        return [*filters, self._filters_ascii] if self.ascii_only else filters

    def on_mount(self) -> None:
        """Before the first picture: themes and keys."""
        for name in self.available_themes:
            self.unregister_theme(name)
        for theme in self.preferences.themes.values():
            self.register_theme(theme)
        self.theme = self.preferences.theme
        self.set_keymap(self.preferences.keymap)

    def on_ready(self) -> None:
        """After the first picture: what was wrong with them, and the session."""
        for title, words in self.preferences.problems:
            self.notify(words, title=title, severity="warning", markup=False, timeout=15)
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)
        if self._session is not None:
            self.run_session(self._session, self.path, temporary=self.temporary)
        else:
            self.main.action_welcome()

    def key_labels(self, action: Action) -> list[str]:
        """The keys that do `action`, as they are written on a keyboard."""
        return self.preferences.key_labels(action, ascii_only=self.ascii_only)

    # -- the engine ---------------------------------------------------------------------------------------------------

    @work(group="session")
    async def run_session(
        self, session: Session, path: Path | None, belongings: ExitStack | None = None, *, temporary: bool = False
    ) -> None:
        """Stop what runs and run `session` instead.

        Args:
            session: what to run.
            path: its file; None: it is in none.
            belongings: what is to end with it.
            temporary: the file ends with it too, so nothing is kept by saving to it.
        """
        async with self._changing:
            self.note = "stopping"
            await asyncio.to_thread(self.stop)
            self._belongings = belongings or ExitStack()
            self.base = Path() if path is None else path.parent
            self.temporary = temporary
            if temporary:
                self.path = self.saved = self.file = None
            else:
                self.saved_to(session, path)
            await self._start(session)

    @work(group="session")
    async def start_anew(self) -> None:
        """Run the session again whose engine has ended by itself, or could not start."""
        if self._changing.locked():
            self.notify(f"the bridge is {self.note}", timeout=3)
            return
        async with self._changing:
            if self.engine is not None:
                await asyncio.to_thread(self.engine.stop)
                await self._start(self.engine.session)

    async def _start(self, session: Session) -> None:
        self.note, self._last_event = "starting", 0
        self.main.reset()
        self.engine = self._make_engine(session, self.base)
        try:
            await asyncio.to_thread(self.engine.start)
            self.note = ""
        except EngineError as error:
            self.note = "not started"
            self.notify(str(error), title="Not started", severity="error", markup=False, timeout=30)
        self.pull()

    def stop(self) -> None:
        """Stop the engine, and what belongs to its session; takes up to some seconds."""
        if self.engine is not None:
            self.engine.stop()
        self._belongings.close()

    def saved_to(self, session: Session, path: Path | None) -> None:
        """What the session's file is, and what is in it."""
        from rsb_console.recents import remember  # noqa: PLC0415 -- keeps the start short
        from rsb_console.saving import file_of  # noqa: PLC0415 -- keeps the start short

        self.path, self.saved = path, session
        self.file = None if path is None else file_of(path, session)
        if path is not None and path.is_file():
            try:
                remember(path)
            except OSError as error:
                self.notify(f"the list of recent sessions: {error}", severity="warning", markup=False)

    @property
    def linked(self) -> bool:
        """Whether a peer is linked now."""
        return any(link.state == "ok" for link in self.snapshot().links)

    def snapshot(self) -> Snapshot:
        """The engine as it is now."""
        if self.engine is None:
            return Snapshot(time.time(), "", "", "", 0, running=False)
        return self.engine.snapshot()

    def peer_of(self, route: RouteSnapshot) -> str:
        """What the other side of a route is called: a client's link has the client's own name, so there its address."""
        now = self.snapshot()
        return now.address if now.role == "client" else route.link

    def pull(self) -> None:
        """Show the engine as it is now."""
        if not self.screen_stack:  # the app is ending; the timer does not know yet
            return
        events = [] if self.engine is None else self.engine.events(self._last_event)
        if events:
            self._last_event = events[-1].number
        self.main.show(self.snapshot(), events)

    def change_refresh_rate(self, step: int) -> None:
        """Pull faster or slower by `step` places in `REFRESH_RATES`."""
        at = REFRESH_RATES.index(self.refresh_rate) + step
        self.refresh_rate = REFRESH_RATES[max(0, min(len(REFRESH_RATES) - 1, at))]
        self._pulling.stop()
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)
        self.pull()

    # -- actions ------------------------------------------------------------------------------------------------------

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Nothing that changes anything while read-only."""
        known = BY_ID.get(action)
        if known is not None and known.changes and self.readonly:
            return False
        return super().check_action(action, parameters)

    def action_help(self) -> None:
        """Show every key."""
        from rsb_console.screens.help import HelpScreen  # noqa: PLC0415 -- keeps the start short

        self.push_screen(HelpScreen())

    def action_help_quit(self) -> None:
        """Ctrl+C, which Textual only explains, means quit to an operator."""
        self.action_quit()

    def action_palette(self) -> None:
        """Open the command palette."""
        self.action_command_palette()

    def action_theme(self) -> None:
        """Next theme."""
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

    @work(exclusive=True, group="quit")
    async def action_quit(self) -> None:  # type: ignore[override]  # a worker, for it asks
        """Leave; ask first while linked, or while something is not saved."""
        if await self.main.may_end("Quit?", "Quit"):
            self.leave(Leaving.QUIT)

    async def on_event(self, event: events.Event) -> None:
        """As Textual's, but a key that comes back from where the focus was may be part of the filter by now."""
        if isinstance(event, events.Key) and event.is_forwarded and self.main.type_ahead(event):
            return
        await super().on_event(event)

    # -- end ----------------------------------------------------------------------------------------------------------

    def leave(self, why: Leaving) -> None:
        """End the app; what becomes of the engine is `run_console`'s to decide."""
        self.leaving = why
        self.exit()

    def leave_soon(self, why: Leaving) -> None:
        """As `leave`, from a signal handler or another thread. An app that does not come to it ends all the same."""
        if self._deadline is None and not self.is_headless:
            self._deadline = threading.Timer(_LEFT_WITHIN, self._end_at_once)
            self._deadline.daemon = True
            self._deadline.start()
        self.call_later(self.leave, why)

    def has_left(self) -> None:
        """The app has ended by itself: nobody needs to end it."""
        if self._deadline is not None:
            self._deadline.cancel()

    def _end_at_once(self) -> None:
        self.stop()
        os._exit(FAILURE)

    def terminal_gone(self) -> None:
        """The terminal has hung up; the driver's thread says so."""
        self.leave_soon(Leaving.HANGUP)

    def _fatal_error(self) -> None:
        """An error nobody handled. Textual would print it with all local variables, which no operator can use."""
        self.crashed()
        self._close_messages_no_wait()

    def crashed(self) -> None:
        """Keep the error that is being handled, for a report."""
        self.leaving = Leaving.CRASH
        record_crash()


def _make_engine(session: Session, base: Path) -> EngineApi:
    from rsb_bridge.engine import Engine  # noqa: PLC0415 -- the first picture comes before the engine's imports

    return Engine(session, base=base)


def run_console(
    path: Path | None,
    *,
    readonly: bool,
    ascii_only: bool,
    theme: str | None,
    on_hangup: str,
    session: Session | None = None,
    mouse: bool = True,
    temporary: bool = False,
) -> int:
    """Open the console, and stay until its end and the engine's.

    Args:
        path: a session file to run; None: `session`, or ask.
        readonly: nothing may be changed.
        ascii_only: draw nothing but ASCII, whatever the terminal can.
        theme: its name; None: what suits the terminal.
        on_hangup: ``stop`` or ``continue``: what the bridge does when the terminal hangs up.
        session: runs if there is no `path`.
        mouse: take the mouse from the terminal.
        temporary: the session file ends with the console, as the demo's does.

    Returns:
        The exit code: 0, or 1 after a crash of the app.

    Raises:
        SessionError: the session file has mistakes.
    """
    from rsb_bridge.config.session_file import load  # noqa: PLC0415 -- not needed without a file

    app = ConsoleApp(
        load(path) if path is not None else session,
        path,
        readonly=readonly,
        ascii_only=ascii_only or prefers_ascii(os.environ),
        theme=theme,
        temporary=temporary,
    )
    leave_on_signals(app)
    try:
        with terminal_to_itself(output_path()) as app.terminal:
            app.run(mouse=mouse)
    except Exception:  # noqa: BLE001 -- whatever befell the app, the bridge goes on
        app.crashed()
    app.has_left()
    return finish(app, on_hangup)
