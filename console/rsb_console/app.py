"""The operator console: a Textual app around an engine that never waits for it."""

from __future__ import annotations

import asyncio
import os
import signal
import time
import traceback
from contextlib import ExitStack
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from platformdirs import user_log_path
from textual import events, work
from textual.app import App

from rsb_bridge.snapshot import Snapshot
from rsb_console import theming
from rsb_console.actions import BY_ID, Action, Group, KeymapError, bindings, load_keymap, split_keys
from rsb_console.glyphs import AsciiFilter
from rsb_console.palette import ActionsProvider
from rsb_console.screens.main import MainScreen
from rsb_console.shell import complain
from rsb_console.terminal import ConsoleDriver, prefers_ascii

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType

    from textual.filter import LineFilter
    from textual.screen import Screen

    from rsb_bridge.engine import Engine
    from rsb_bridge.session import Session

    MakeEngine = Callable[[Session, Path], Engine]

REFRESH_RATES = (0.5, 1.0, 2.0, 4.0, 10.0)  # Hz
LOCAL_RATE, SSH_RATE = 4.0, 2.0
KEY_SIGNS = {
    "slash": "/", "question_mark": "?", "enter": "⏎", "escape": "esc", "less_than_sign": "<", "greater_than_sign": ">",
    "plus": "+", "minus": "-", "colon": ":", "pagedown": "PgDn", "pageup": "PgUp", "up": "↑", "down": "↓",
}  # fmt: skip


class Leaving(Enum):
    """Why the app ended."""

    QUIT = "quit"
    TERMINATED = "terminated"
    HANGUP = "hangup"
    CRASH = "crash"


SIGNALS = {
    signal.SIGTERM: Leaving.TERMINATED,
    signal.SIGINT: Leaving.TERMINATED,
    signal.SIGHUP: Leaving.HANGUP,
}


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
    ) -> None:
        super().__init__(driver_class=ConsoleDriver)
        self.path = path
        self.readonly = readonly
        self.ascii_only = ascii_only
        self.config = theming.config_path() if config is None else config
        self.engine: Engine | None = None
        self.base = Path()
        self.saved: Session | None = None
        self._belongings = ExitStack()
        self.leaving = Leaving.QUIT
        self.refresh_rate = SSH_RATE if os.environ.get("SSH_CONNECTION") else LOCAL_RATE
        self.note = "no session"
        self.main = MainScreen()
        self._session = session
        self._make_engine = make_engine or _make_engine
        self._filters_ascii = AsciiFilter()
        self._theme_wanted = theme
        self._keys_of_user: dict[str, str] = {}
        self._last_event = 0
        self._problems: list[tuple[str, str]] = []

    # -- start --------------------------------------------------------------------------------------------------------

    def get_default_screen(self) -> Screen[Any]:
        """The main screen is always the first."""
        return self.main

    def get_theme_variable_defaults(self) -> dict[str, str]:
        """What the style sheet needs of a theme that doesn't say."""
        return theming.VARIABLES

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Textual's, and ours where nothing but ASCII may go out."""
        filters = super().get_line_filters()
        return [*filters, self._filters_ascii] if self.ascii_only else filters

    def on_mount(self) -> None:
        """Before the first picture: themes and keys."""
        self._load_themes()
        self._load_keys()

    def on_ready(self) -> None:
        """After the first picture: what was wrong so far, and the session."""
        for title, words in self._problems:
            self.notify(words, title=title, severity="warning", markup=False, timeout=15)
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)
        if self._session is not None:
            self.run_session(self._session, self.path)
        else:
            self.main.action_welcome()

    def _load_themes(self) -> None:
        themes = theming.load_themes(theming.shipped_path(), self.config / "themes")
        for name in self.available_themes:
            self.unregister_theme(name)
        for theme in themes.found.values():
            self.register_theme(theme)
        problems = list(themes.problems)
        if self._theme_wanted and self._theme_wanted not in themes.found:
            problems.append(f"no theme is called {self._theme_wanted!r}; there are {', '.join(themes.found)}")
        if problems:
            self._problems.append(("Themes left out", "\n".join(problems)))
        known = self._theme_wanted in themes.found
        self.theme = self._theme_wanted if self._theme_wanted and known else theming.default_theme()

    def _load_keys(self) -> None:
        try:
            self._keys_of_user = load_keymap(self.config / "keys.yaml")
        except KeymapError as error:
            self._problems.append(("Keys are the default ones", str(error)))
        self.set_keymap(self._keys_of_user)

    def key_labels(self, action: Action) -> list[str]:
        """The keys that do `action`, as they are written on a keyboard."""
        keys = self._keys_of_user.get(action.id, action.keys)
        return [KEY_SIGNS.get(key, key.replace("ctrl+", "^")) for key in split_keys(keys)]

    # -- the engine ---------------------------------------------------------------------------------------------------

    @work(exclusive=True, group="session")
    async def run_session(self, session: Session, path: Path | None, belongings: ExitStack | None = None) -> None:
        """Stop what runs and run `session` instead.

        Args:
            session: what to run.
            path: its file; None: it is in none.
            belongings: what is to end with it.
        """
        from rsb_bridge.engine import EngineError  # noqa: PLC0415 -- the first picture comes before the engine's imports

        self.note = "stopping"
        await asyncio.to_thread(self.stop)
        self._belongings = belongings or ExitStack()
        self.note, self._last_event = "starting", 0
        self.main.reset()
        self.base = Path() if path is None else path.parent
        self.engine = self._make_engine(session, self.base)
        self.saved_to(session, path)
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

        self.path, self.saved = path, session
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

    def pull(self) -> None:
        """Show the engine as it is now."""
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

    def action_palette(self) -> None:
        """Open the command palette."""
        self.action_command_palette()

    def action_theme(self) -> None:
        """Next theme."""
        names = sorted(self.available_themes)
        self.theme = names[(names.index(self.theme) + 1) % len(names)]
        self.notify(f"theme: {self.theme}", timeout=2)

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
        """As `leave`, from a signal handler or another thread."""
        self.call_later(self.leave, why)

    def terminal_gone(self) -> None:
        """The terminal has hung up; the driver's thread says so."""
        self.leave_soon(Leaving.HANGUP)

    def _fatal_error(self) -> None:
        """An error nobody handled. Textual would print it with all local variables, which no operator can use."""
        self.record_crash()
        self._close_messages_no_wait()

    def record_crash(self) -> None:
        """Write the error that is being handled where it can be reported from."""
        self.leaving = Leaving.CRASH
        path = crash_path()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(traceback.format_exc(), encoding="utf-8")


def crash_path() -> Path:
    """Where the last crash of the app is told."""
    return user_log_path("rsb-console") / "crash.txt"


def _make_engine(session: Session, base: Path) -> Engine:
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

    Returns:
        The exit code: 0, or 1 after a crash of the app.

    Raises:
        SessionError: the session file has mistakes.
    """
    from rsb_bridge.session_file import load  # noqa: PLC0415 -- not needed without a file

    app = ConsoleApp(
        load(path) if path is not None else session,
        path,
        readonly=readonly,
        ascii_only=ascii_only or prefers_ascii(os.environ),
        theme=theme,
    )
    for (
        number,
        why,
    ) in SIGNALS.items():  # not asyncio's handlers: they would be gone with its loop, and a second SIGHUP kill
        signal.signal(number, partial(_on_signal, app, why))
    try:
        app.run(mouse=mouse)
    except Exception:  # noqa: BLE001 -- whatever befell the app, the bridge goes on
        app.record_crash()
    return _after(app, on_hangup)


def _on_signal(app: ConsoleApp, why: Leaving, _number: int, _frame: FrameType | None) -> None:
    app.leave_soon(why)


def _after(app: ConsoleApp, on_hangup: str) -> int:
    """Stop the engine, or bridge on without the app."""
    crashed = app.leaving is Leaving.CRASH
    if crashed:
        complain(f"the console has crashed; please report {crash_path()}")
    code = int(crashed)
    if app.engine is not None and (crashed or (app.leaving is Leaving.HANGUP and on_hangup == "continue")):
        from rsb_console.headless import bridge_on  # noqa: PLC0415 -- seldom needed

        code = bridge_on(app.engine, crashed=crashed)
    app.stop()
    return code
