"""The Textual app of the console, around an engine that never waits for it."""

from __future__ import annotations

import asyncio
import os
import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from textual import work

from rsb_bridge.api import EngineError
from rsb_bridge.installed_features import added_by, guarded
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.faults import ChangeKind, FaultWatch, fault_count
from rsb_bridge.model.snapshot import LinkSnapshot, PatternSnapshot, Snapshot, State
from rsb_bridge.model.verdict import LinkCause
from rsb_console.actions.action import Group, call_of
from rsb_console.notation.glyphs import STATE_WORD
from rsb_console.operations.deadman import Deadman
from rsb_console.operations.session_operations import attach_instead, confirm_end, welcome
from rsb_console.screens.dialog import FullScreen
from rsb_console.screens.main import MainScreen
from rsb_console.screens.take_over import HandOverScreen, NewQuestions
from rsb_console.session.changes import Changes
from rsb_console.terminal.input_queue import DIALOG, is_guarded
from rsb_console.terminal_app import ShutdownReason, TerminalApp

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future

    from textual import events
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.faults import FaultChange, Faulty
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Event, RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.notation.formats import Row

    MakeEngine = Callable[[Session, Path], EngineApi]
    Attach = Callable[[], RemoteEngine]
    Serve = Callable[[EngineApi, Session, Path | None], tuple[ControlServer | None, RunningBridge | None]]

T = TypeVar("T")
LOCAL_RATE, SSH_RATE = 4.0, 2.0
"""500 topics take 4 ms and up to 10 kB a refresh (docs/design.md, 9). Over SSH half as often: the line may be slow."""
RINGS_EVERY = 10.0
"""Least seconds between two rings, so that faults which begin close together ring once."""


class ConsoleApp(TerminalApp[None]):
    """Fulfils `rsb_console.console_api.Console`: owns the engine, the user's preferences, and the main screen.

    Args:
        path: the session's file, or None without a file.
        theme: name of the theme, or None for one that suits the terminal.
        config: the user's configuration folder, or None for the platform's.
        make_engine: makes an engine from a session and the folder of its key files.
        serve: serves an engine on a control socket, or finds the bridge that already runs its session; or None.
        attach_to: control socket of a bridge to begin with instead of a session, or a function that attaches to one and
            may take some seconds, or None.
        temporary: the session's file is deleted when the session ends.
        resources: closed when that session ends, or None.
    """

    main_screen: type[MainScreen] = MainScreen

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
        attach_to: Path | Attach | None = None,
        temporary: bool = False,
        resources: ExitStack | None = None,
    ) -> None:
        super().__init__(
            readonly=readonly,
            ascii_only=ascii_only,
            theme=theme,
            config=config,
            dialogs={Group.OPERATE, Group.SESSION, Group.OWN},
        )
        self.actions = self.preferences.actions
        for action in self.actions:
            if action.group is Group.OWN:
                self.bind(action.keys, f"screen.{action.id}", description=action.label, show=False)
        self.engine: EngineApi | None = None
        self.base = Path()
        self.path = path
        self.saved: Session | None = None
        self.file: SessionFile | None = None
        self.temporary = temporary
        self.note = "no session"
        usual = SSH_RATE if os.environ.get("SSH_CONNECTION") else LOCAL_RATE
        self.refresh_rate = self.preferences.refresh_rate or usual
        self.deadman = Deadman()
        self._questions = NewQuestions()
        self.fault_bell = Bell(self._ring, is_on=self.preferences.bell)
        self.changes = Changes()
        console: Console = self
        self._listeners = SnapshotListeners(console)
        self.main: MainScreen = self.main_screen(console)
        self.attached_to = ""
        self._session = session
        self._attach_to = attach_to
        self._make_engine = make_engine or partial(_new_engine, self)
        self._serve = serve
        self._server: ControlServer | None = None
        self._resources = ExitStack()
        """Closed when the present session ends."""
        self._first_resources = resources
        self._changing = asyncio.Lock()
        """Held while an engine starts or stops: two at once would fight for the port."""
        self._last_event = 0

    # --- start

    def get_default_screen(self) -> Screen[Any]:
        return self.main

    def on_ready(self) -> None:
        """Report problems of the preferences and start the session, after the first picture."""
        self.tell_problems()
        # Not earlier: the first picture waits for no engine.
        self.begin_pulling()
        if self._attach_to is not None:
            self._attach_to_bridge(self._attach_to)
        elif self._session is not None:
            self._run_session(self._session, self.path, self._first_resources, temporary=self.temporary)
        else:
            self.main.run_worker(call_of(welcome, self.main), group=Group.SESSION, exclusive=True)

    # --- the session

    async def run_session(
        self, session: Session, path: Path | None, resources: ExitStack | None = None, *, temporary: bool = False
    ) -> None:
        worker = self._run_session(session, path, resources, temporary=temporary)
        await asyncio.shield(worker.wait())  # a caller may be cancelled, the start may not

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
            # With a path, a session whose file goes with it would be among the recent ones, and saved already.
            if temporary:
                self.path = self.saved = self.file = None
            else:
                self.saved_to(session, path)
            await self._start(session)

    async def start_again(self) -> None:
        # Without it, R pressed twice would end the engine that the first one has just started.
        if self._changing.locked():
            self.notify(f"the bridge is {self.note}", timeout=3)
        else:
            await asyncio.shield(self._start_again().wait())

    @work(group="session")
    async def _start_again(self) -> None:
        async with self._changing:
            # An attached bridge belongs to another process.
            if self.engine is not None and not self.attached_to:
                await asyncio.to_thread(self._stop_engine)
                await self._start(self.engine.session)

    async def _start(self, session: Session) -> None:
        self.note, self._last_event = "starting", 0
        self.main.reset()
        self.changes.clear()
        self.attached_to = ""
        engine = self._make_engine(session, self.base)
        engine.use_file(self.path)
        # Before the engine starts: with a bridge that runs this session already, it would fight for the port.
        if self._serve is not None:
            try:
                self._server, running = await asyncio.to_thread(self._serve, engine, session, self.path)
            except EngineError as error:
                # The session is worth more than its control socket, so it runs without.
                running = None
                self.notify(str(error), title="Nobody can attach", severity="warning", markup=False, timeout=15)
            if running is not None:
                self.engine, self.note = None, "no session"
                self.main.run_worker(call_of(attach_instead, self.main, running), group=Group.SESSION, exclusive=True)
                return
        self.engine = engine
        try:
            await asyncio.to_thread(engine.start)
        except EngineError:  # its log has the reason, which the screen shows
            await asyncio.to_thread(self._close_server)  # nobody attaches to what does not run
        self.note = ""
        self.pull()

    async def attach(self, path: Path) -> None:
        await asyncio.shield(self._attach_to_bridge(path).wait())

    @work(group="session")
    async def _attach_to_bridge(self, to: Path | Attach) -> None:
        from rsb_bridge.config.session_file import open_file  # noqa: PLC0415 -- not needed without a file
        from rsb_bridge.control.remote_engine import attach  # noqa: PLC0415 -- keeps the start short

        open_it = partial(attach, to, read_only=self.readonly) if isinstance(to, Path) else to
        async with self._changing:
            self.note, self._last_event = "attaching", 0
            await asyncio.to_thread(self.stop)
            self._resources, self.engine, self.attached_to, self.temporary = ExitStack(), None, "", False
            self.main.reset()
            self.changes.clear()
            try:
                engine = await asyncio.to_thread(open_it)
            except EngineError as error:
                self.note = "not attached"
                self.notify(str(error), title="Not attached", severity="error", markup=False, timeout=30)
                return
            self.engine, self.attached_to, self.note = engine, engine.name, ""
            self.base, self.path = Path(engine.bridge.base), engine.file_here
            self.file = None if self.path is None else open_file(self.path)
            self.saved = None if self.file is None else self.file.session

    def stop(self) -> None:
        """Stop the engine, or detach from it, and close the session's resources; may take some seconds."""
        self._stop_engine()
        self._resources.close()  # last: the engine runs on them, such as on the demo's folder

    def _stop_engine(self) -> None:
        if self.engine is not None:
            self.engine.stop()
        self._close_server()

    def _close_server(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None

    def saved_to(self, session: Session, path: Path | None) -> None:
        from rsb_console.session.recent_sessions import remember  # noqa: PLC0415 -- keeps the start short
        from rsb_console.session.saving import file_of  # noqa: PLC0415 -- keeps the start short

        # An attached bridge keeps to its own file, even if another one gets a copy.
        own = None if self.path is None else self.path.resolve()
        if not self.attached_to or (path is not None and path.resolve() == own):
            self.path, self.saved = path, session
            self.file = None if path is None else file_of(path, session)
        if self.engine is not None:
            self.engine.use_file(path, session)
        if path is not None and path.is_file():
            try:
                remember(path)
            except OSError as error:
                self.notify(f"the list of recent sessions: {error}", severity="warning", markup=False)

    # --- the engine

    @property
    def readonly(self) -> bool:
        return self._readonly or (self.engine is not None and self.engine.read_only)

    @property
    def linked(self) -> bool:
        return any(link.state is State.OK for link in self.snapshot().links)

    def snapshot(self) -> Snapshot:
        if self.engine is None:
            return Snapshot(time.time(), "", "", "", 0, running=False)
        snapshot = self.engine.snapshot()
        seen_at = self.as_seen(snapshot.time)
        return snapshot if seen_at == snapshot.time else replace(snapshot, time=seen_at)

    def peer_of(self, route: Row) -> str:
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
        self.needs_young_keys = any(link.cause == LinkCause.SHUT_DOWN for link in snapshot.links) or any(
            route.arming is not None or route.spec.paused for route in snapshot.routes
        )
        self.deadman.keep(self.engine, snapshot)
        for route in self._questions.find_new(snapshot, self.deadman.held):
            self._hand_over(route)
        self.fault_bell.ring_for_new(self.engine, snapshot)
        self._listeners.tell(self.engine, snapshot, events)
        self.entitle(snapshot.name, fault_count(snapshot) if snapshot.name else 0)
        if any(isinstance(screen, FullScreen) for screen in self.screen_stack):
            self.main.hold(events)  # Textual would write the whole of the screen above for each of its changes
        else:
            self.main.show(snapshot, events)

    @work
    async def _hand_over(self, route: RouteSnapshot) -> None:
        """Ask the operator whether another one gets what this console holds, unless the screen on top does."""
        if is_guarded(self.screen) and self.screen.hands_over(route.key):
            return
        question = HandOverScreen(self, route)
        gives = await self.ask(question)
        if gives is not None and self.engine is not None:
            await self.command(self.engine.answer_asker(route.key, gives=gives, who=question.who))

    def _ring(self, begun: Sequence[FaultChange]) -> None:
        self.bell()
        if self.preferences.notify:
            self.tell_desktop(self.snapshot().name or self.TITLE, fault_text([change.subject for change in begun]))

    # --- actions

    def request_quit(self) -> None:
        self.action_quit()

    def action_bell_on_fault(self) -> None:
        """Turn the bell for new faults on or off."""
        self.fault_bell.is_on = not self.fault_bell.is_on
        self.remember("bell", self.fault_bell.is_on)
        self.notify("the bell rings when a fault begins" if self.fault_bell.is_on else "the bell is off", timeout=3)

    @work(exclusive=True, group=DIALOG)
    async def action_quit(self) -> None:  # type: ignore[override]  # a worker, because it asks
        if await confirm_end(self, "Quit?", "Quit", Effect.HARMLESS):
            self.shut_down(ShutdownReason.QUIT)

    async def on_event(self, event: events.Event) -> None:
        """Note that the operator is active (Textual's)."""
        if self.screen_stack and not self.input_gate.is_late(event):
            # Keys that were pressed long ago do not show that somebody watches now.
            self.deadman.saw(event, self.screen)
        await super().on_event(event)


def _new_engine(app: ConsoleApp, session: Session, base: Path) -> EngineApi:
    from rsb_bridge.config.state_folder import state_folder  # noqa: PLC0415 -- keeps the start short
    from rsb_bridge.engine import Engine  # noqa: PLC0415 -- the first picture comes before the engine's imports

    return Engine(session, base=base, state=None if app.temporary else state_folder(os.environ))


class SnapshotListeners:
    """The features' functions that hear of a console's snapshots and events. One that raises hears no more."""

    def __init__(self, console: Console) -> None:
        self._all = list(added_by("listeners", console))
        self._engine: EngineApi | None = None

    def tell(self, engine: EngineApi | None, snapshot: Snapshot, events: Sequence[Event]) -> None:
        """Tell of a snapshot and of new events; those that come first with an engine are from before."""
        if not self._all:
            return
        if engine is not self._engine:
            self._engine, events = engine, ()
        for each in tuple(self._all):
            feature, listener = each
            with guarded(feature, "listeners"):
                listener(snapshot, events)
                continue
            self._all.remove(each)


class Bell:
    """Rings when a fault of the shown engine begins. Earlier faults do not ring.

    Args:
        ring: gets the faults that have begun.
    """

    def __init__(
        self, ring: Callable[[Sequence[FaultChange]], None], *, is_on: bool, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.is_on = is_on
        self._ring = ring
        self._clock = clock
        self._rang_at = float("-inf")
        self._engine: EngineApi | None = None
        self._watch: FaultWatch | None = None

    def ring_for_new(self, engine: EngineApi | None, snapshot: Snapshot) -> None:
        """Look for new faults. Called at each refresh; costs nothing while the bell is off."""
        now = self._clock()
        if engine is None or not self.is_on or not snapshot.running:
            self._watch = None
        elif self._watch is None or engine is not self._engine:
            self._engine, self._watch = engine, FaultWatch()
            self._watch.assume(snapshot, now)  # what is wrong already does not ring
        else:
            begun = [change for change in self._watch.find_changes(snapshot, now) if rings_for(change)]
            if begun and now - self._rang_at >= RINGS_EVERY:
                self._rang_at = now
                self._ring(begun)


def fault_text(faulty: Sequence[Faulty]) -> str:
    """Return the first of some faults in words, and how many more there are."""
    first, more = faulty[0], len(faulty) - 1
    reason = first.reason
    match first:
        case LinkSnapshot():
            name, reason = first.name, reason or first.warning
        case PatternSnapshot():
            name = first.spec.topic
        case _:
            name = first.topic
    shown = ": ".join(filter(None, (f"{name} {STATE_WORD[first.state]}", reason)))
    return f"{shown} (and {more} more)" if more else shown


def rings_for(change: FaultChange) -> bool:
    """Whether a change is worth a ring: a fault has begun that no operator has acknowledged."""
    return change.kind is ChangeKind.BEGUN and change.subject.acknowledged is None
