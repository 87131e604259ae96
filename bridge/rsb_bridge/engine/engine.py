"""The engine: one session's bridge on threads of its own. Nothing in here waits for a user interface."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import gc
import logging
import os
import threading
from concurrent.futures import Future
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, TypeVar, cast

from rsb_bridge.api import EngineApi, EngineError, Unable
from rsb_bridge.config.validation import domain_of
from rsb_bridge.context import Context
from rsb_bridge.engine.access import Access, load_keys
from rsb_bridge.engine.bridge import Bridge
from rsb_bridge.engine.file_commands import EngineFile, FileCommands
from rsb_bridge.engine.io_loop import IoLoop
from rsb_bridge.installed_features import added
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import Stop, operator
from rsb_bridge.model.snapshot import Event, Level, Snapshot
from rsb_bridge.ros.ros_interface import RosError, RosInterface
from rsb_bridge.ros.ros_thread import RosToLoopQueue
from rsb_bridge.tasks import cancel_others
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher
from rsb_bridge.transport.registry import Transports, transports_of
from rsb_bridge.wire import codec

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from rsb_bridge.engine.part import EngineObserver
    from rsb_bridge.link.roles import Keys
    from rsb_bridge.model.commands import Command, R
    from rsb_bridge.model.session import Session


_LOADING = threading.Lock()
"""Held while an engine makes what all engines of this process decode with."""


class PendingCommands:
    """Runs commands on an event loop from `open` to `refuse`; `end` fails the commands that have no result yet."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        """None while commands are refused."""
        self._futures: set[Future[object]] = set()
        """The code that takes a future out gives it its result."""
        self._tasks: set[asyncio.Task[None]] = set()

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def run(self, work: Callable[[], Coroutine[None, None, T]]) -> Future[T]:
        """Run a command on the loop. May be called from any thread."""
        future: Future[T] = Future()
        with self._lock:
            if self._loop is None:
                return not_running()
            self._loop.call_soon_threadsafe(self._begin, self._loop, work, future)
            self._futures.add(future)  # type: ignore[arg-type]
        return future

    def refuse(self) -> None:
        """Take no more commands. May be called from any thread."""
        with self._lock:
            self._loop = None

    def end(self) -> None:
        """Take no more commands, and fail all others. May be called from any thread; the loop cancels their tasks."""
        with self._lock:
            self._loop = None
            left = tuple(self._futures)
        for future in left:
            self._failed(future, _error())

    def _begin(
        self, loop: asyncio.AbstractEventLoop, work: Callable[[], Coroutine[None, None, T]], future: Future[T]
    ) -> None:
        if future.cancelled():
            self._claim(future)
        # `end` may have failed it before its turn came.
        elif not future.done():
            task = loop.create_task(self._run(work, future))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            future.add_done_callback(lambda done: _cancel(task, loop) if done.cancelled() else None)

    async def _run(self, work: Callable[[], Coroutine[None, None, T]], future: Future[T]) -> None:
        # The result comes a turn later, so that the caller sees the callbacks that the command has added.
        later = asyncio.get_running_loop().call_soon
        try:
            later(self._succeeded, future, await work())
        except asyncio.CancelledError:  # by the caller through the future, or at the end of the engine
            later(self._failed, future, _error())
            raise
        except Exception as error:  # noqa: BLE001 — it is the future's
            later(self._failed, future, error)

    def _succeeded(self, future: Future[T], result: T) -> None:
        if self._claim(future):
            future.set_result(result)

    def _failed(self, future: Future[T], error: Exception) -> None:
        if self._claim(future):
            future.set_exception(error)

    def _claim(self, future: Future[T]) -> bool:
        """Whether it is up to the caller to give the future its result."""
        with self._lock:
            if future not in self._futures:
                return False
            self._futures.remove(future)  # type: ignore[arg-type]
        return future.set_running_or_notify_cancel()


def _node(domain: int, name: str) -> RosInterface:
    from rsb_bridge.ros.node import RosNode  # noqa: PLC0415 -- only a running engine needs ROS

    return RosNode(domain, name)


def not_running() -> Future[T]:
    """Return the future of a refused command."""
    failed: Future[T] = Future()
    failed.set_exception(_error())
    return failed


def _error() -> EngineError:
    return EngineError(Unable.NOT_RUNNING())


def _cancel(task: asyncio.Task[None], loop: asyncio.AbstractEventLoop) -> None:
    with contextlib.suppress(RuntimeError):  # the loop is closed, and has ended its tasks
        loop.call_soon_threadsafe(task.cancel)


_STOP_WITHIN = 5.0
"""s that `stop` takes at most. A round figure, below the 10 s after which systemd kills a service (configs/)."""
_ROS_STOPS_WITHIN = 1.0
"""s of these that `ros.node.RosNode.stop` may take."""
_OBSERVED_WITHIN = 0.5
"""s for each observer, even if a hanging I/O thread has used up all: else a history lacks the end. A round figure."""

_logger = logging.getLogger(__name__)
T = TypeVar("T")


def freeze_heap() -> None:
    """Leave out of all later garbage collections what this process has by now.

    For a program that only runs an engine, which has just started: a collection of everything holds up messages, for
    3 ms instead of 33 then (118 with 500 topics, which have come meanwhile, becomes 57). Called again after a restart,
    it frees the engine before.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


class Engine(EngineApi):
    """Bridges a session from `start` to `stop`. Used once: after `stop`, `start` raises an error.

    All state belongs to the I/O thread. Commands run there.

    Args:
        base: the folder that its key files are relative to.
        ros: the ROS side, or None for `rsb_bridge.ros.node.RosNode` in the session's domain.
        clock: the wall clock, or None for the machine's.
        random: for jitter, or None for one that the system seeds.
        transports: carry the links, or None for the kernel's sockets.
        state: the folder for what outlives the engine, or None if nothing is to be kept.

    Attributes:
        access: the operators that may attach over a network.
        clock: the wall clock.
        log: its events.
        snapshots: has the newest snapshot.
        state: as above.
        transports: as above.
    """

    def __init__(
        self,
        session: Session,
        *,
        base: Path = Path(),
        ros: RosInterface | None = None,
        clock: Clock | None = None,
        random: Random | None = None,
        transports: Transports | None = None,
        state: Path | None = None,
    ) -> None:
        self._file = EngineFile(session, base)
        self._ros = ros
        self.clock = clock or Clock()
        self.state = state
        self._random = random or Random()  # noqa: S311 — jitter, no secret
        self.transports = transports or transports_of(session, base, self._random)
        self.log = EventLog(self.clock)
        self.access = Access(session.name, self.log, self.clock, self.transports.strangers)
        self._starting = threading.Lock()
        """Held while threads start or end."""
        self._stop_wanted = False
        self._commands = PendingCommands()
        self._thread: threading.Thread | None = None
        self._bridge: Bridge | None = None
        transport = self.transports.of_link(session.host)
        address = transport.format_address((session.host, session.server_port))
        started = self.clock.time_ns() / 1e9
        blank = Snapshot(started, session.name, session.role, address, session.domain_id or 0, running=False)
        self.snapshots = SnapshotPublisher(blank, self.log, self.clock)
        self._observers: list[EngineObserver] = list(added("observers", self))
        self._answers = {kind: answer for each in self._observers for kind, answer in each.answers.items()}

    # --- from any thread

    @property
    def session(self) -> Session:
        return self._file.session if self._bridge is None else self._bridge.session

    @property
    def waits_for_operator(self) -> bool:
        return self._bridge is not None and any(link.end.shut_down for link in self._bridge.role.links())

    @property
    def unreachable(self) -> str:
        return ""

    def start(self) -> None:
        with _LOADING:
            codec.decoders()
        with self._starting:
            self._check_not_stopped()
            try:
                self._start()
            except EngineError as error:
                self.log.add(Level.ERROR, EventCode.ENGINE_NOT_STARTED, str(error))
                raise
            try:
                self._check_not_stopped()
            except EngineError:
                self._end(_STOP_WITHIN)
                raise

    def stop(self, timeout: float = _STOP_WITHIN) -> None:
        self._stop_wanted = True
        # A start that is still running sees this and cleans up, so that nothing remains to be done here. If it
        # hangs (in the middleware, say), it is not waited for any longer, and cleans up when it returns.
        if not self._starting.acquire(timeout=timeout):
            return
        try:
            self._end(timeout)
        finally:
            self._starting.release()

    def _check_not_stopped(self) -> None:
        if self._stop_wanted:
            raise EngineError(Unable.STOPPED_BEFORE_START())

    def _start(self) -> None:
        session = self._file.session
        try:
            domain = domain_of(session, os.environ.get("ROS_DOMAIN_ID"))
        except ValueError as error:
            raise EngineError(str(error)) from None
        self.snapshots.latest = dataclasses.replace(self.snapshots.latest, domain_id=domain)
        if not session.use_encryption:
            text = "encryption is off: all data crosses unencrypted"
            self.log.add(Level.WARNING, EventCode.KEY_UNENCRYPTED, text)
        keys, granted = load_keys(session, self._file.base)
        self.access.warn_of(keys, granted)
        self.access.grant(granted)
        ros = self._ros or _node(domain, session.name)
        try:
            ros.start()
        except RosError as error:
            raise EngineError(str(error)) from None
        for shortfall in ros.shortfalls:
            self.log.add(Level.INFO, EventCode.ENGINE_ROS_LIMITED, shortfall)
        for level, text in ros.discovery.notes():
            self.log.add(level, EventCode.ENGINE_DISCOVERY, text)
        started: Future[None] = Future()
        self._thread = threading.Thread(
            target=self._run_thread, args=(ros, domain, keys, started), name="rsb-io", daemon=True
        )
        self._thread.start()
        try:
            started.result()
        except EngineError:
            # Nothing of this attempt is left when `start` raises: the next one needs the same port.
            self._thread.join()
            self._thread = None
            ros.stop()
            raise
        for each in self._observers:
            with self._observer_may_fail(each):
                each.start()

    def _end(self, timeout: float) -> None:
        """End what `_start` has begun; nothing happens where that is nothing."""
        thread, bridge = self._thread, self._bridge
        if thread is None or bridge is None:
            return
        deadline = self.clock.steady() + timeout
        self._commands.refuse()
        bridge.context.call(bridge.stop)
        # The rest of the time belongs to ROS and to the observers, even if the I/O thread hangs.
        thread.join(max(0.0, timeout - _ROS_STOPS_WITHIN - _OBSERVED_WITHIN))
        self._commands.end()  # the thread does so itself, unless it hangs
        bridge.context.ros.stop()
        for each in self._observers:
            with self._observer_may_fail(each):
                each.stop(max(_OBSERVED_WITHIN, deadline - self.clock.steady()))
        self._thread = None

    @contextlib.contextmanager
    def _observer_may_fail(self, observer: EngineObserver) -> Iterator[None]:
        """Do work of an observer; a failure of it is logged, and ends nothing else."""
        try:
            yield
        except Exception as error:  # of code that is not ours
            what = f"the observer {type(observer).__name__} of a feature failed"
            _logger.exception("%s", what)
            message = Unable.INTERNAL(problem=f"{what}: {error}")
            self.log.add(Level.ERROR, EventCode.ENGINE_ERROR, message)

    def snapshot(self) -> Snapshot:
        """Return the engine as it was at most 1 s ago; while somebody asks more often than that, 0.25 s.

        The first call in a while waits until all of it is renewed, a few ms.
        """
        return self.snapshots.newest()

    def recorded(self) -> Snapshot:
        return self.snapshots.latest

    def events(self, after: int = 0) -> list[Event]:
        return self.log.after(after)

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self.log.wait(after, timeout)

    def use_file(self, path: Path | None, holds: Session | None = None) -> None:
        self._file.use(path, holds or self.session)
        if (bridge := self._bridge) is not None:
            places = self._file.places
            bridge.context.call(lambda: bridge.context.demands.set_places(places))

    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        bridge = self._bridge
        # Needs no I/O thread, so that a bridge that hangs can be ended, too.
        if isinstance(command, Stop):
            return cast("Future[R]", self._record_stop())
        if bridge is None:
            return not_running()
        if (answer := self._answers.get(type(command))) is not None:
            return answer(command)
        return self._commands.run(lambda: bridge.do(command, step))

    def _record_stop(self) -> Future[None]:
        who = operator()
        self.log.add(Level.INFO, EventCode.OPERATOR_STOPPED, f"stopped by {who}", who=who)
        done: Future[None] = Future()
        done.set_result(None)
        return done

    # --- on the I/O thread

    def _run_thread(self, ros: RosInterface, domain: int, keys: Keys, started: Future[None]) -> None:
        try:
            with asyncio.Runner(loop_factory=IoLoop) as runner:
                runner.run(self._main(ros, domain, keys, started))
        except Exception as error:
            _logger.exception("internal error of the engine")
            message = Unable.INTERNAL(problem=error)
            self.log.add(Level.ERROR, EventCode.ENGINE_ERROR, message)
            # `start` waits for this without a limit.
            if not started.done():
                started.set_exception(EngineError(message))

    async def _main(self, ros: RosInterface, domain: int, keys: Keys, started: Future[None]) -> None:
        loop = asyncio.get_running_loop()
        queue = RosToLoopQueue(loop, loop.do_now if isinstance(loop, IoLoop) else None, ros.turns)
        context = Context(
            self._file.session,
            domain,
            ros,
            self.log,
            queue,
            loop,
            self.clock,
            self._random,
            self.transports,
            self._file.contents,
        )
        context.demands.set_places(self._file.places)
        self._bridge = bridge = Bridge(context, keys, self.snapshots, self._file.folder)
        bridge.handlers |= FileCommands(bridge, self._file, self.access).handlers
        loop.set_exception_handler(bridge.internal_error)
        self._commands.open(loop)
        try:
            await bridge.start()
        except EngineError as error:
            started.set_exception(error)
        else:
            started.set_result(None)
            await bridge.run()
        finally:
            self._commands.end()
            # Before the transports: an attempt to connect that is refused meanwhile would wait for its peer's end.
            await cancel_others()
            self.transports.close()
