"""An engine in another process of this machine, attached through its control socket."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge import __version__
from rsb_bridge.api import EngineApi, EngineError
from rsb_bridge.control import protocol
from rsb_bridge.control.folders import ControlError, NotServedError, try_connect
from rsb_bridge.control.protocol import (
    AddClient,
    AddTopic,
    ChangeClient,
    Describe,
    EditTopic,
    Events,
    Failed,
    Follow,
    Goodbye,
    Hello,
    History,
    Look,
    Pause,
    Peek,
    ProtocolError,
    Refused,
    Reload,
    RemoveClient,
    RemoveTopic,
    Reply,
    Request,
    Restart,
    Retry,
    ShutDown,
    State,
    Step,
    Stop,
    Topics,
    Welcome,
)
from rsb_bridge.control.states import Receiver, out_of_reach
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.history import HistoryReport
from rsb_bridge.model.peek import PeekedMessage
from rsb_bridge.model.reloaded import Reloaded
from rsb_bridge.model.snapshot import Event, Level, Snapshot, TopicInfo
from rsb_bridge.telemetry.event_log import EventLog

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rsb_bridge.control.protocol import BridgeInfo, Command, ToBridge, ToConsole
    from rsb_bridge.model.session import Client, Session, Topic

T = TypeVar("T")
ANSWERS_WITHIN = 5.0
"""s in which a bridge welcomes a console, and after which one that is silent counts as unreachable."""
_RETRY_EVERY = 0.5
_BUSY_TRIED_EVERY = 0.05
_COMES_BEFORE_USE = 0.1
"""s: the next state is asked for so long before it is likely to be used."""
_USED_REGULARLY = 3.0
_READ_SIZE = 256 << 10


class RemoteEngine(EngineApi):
    """Fulfils `EngineApi` for an engine of another process.

    `start` attaches; when the connection breaks later, it says so (`unreachable`, and an event), shows everything as
    down, and attaches again as soon as that is possible. `stop` detaches; the engine goes on.

    Args:
        path: of its control socket.
        read_only: have the bridge refuse what would change anything.
        clock: the wall clock; None: the machine's.

    Attributes:
        bridge: who serves the socket, from `start` on.
        read_only: as given.
    """

    def __init__(self, path: Path, *, read_only: bool = False, clock: Clock | None = None) -> None:
        self.path = path
        self.read_only = read_only
        self.bridge: BridgeInfo
        self._log = EventLog(clock or Clock())
        self._clock = clock or Clock()
        self._shown: Snapshot
        self._session: Session
        self._waits_for_operator = False
        self._lost = ""
        self._receiver: Receiver
        self._started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, name="rsb-attached", daemon=True)
        self._loop: asyncio.AbstractEventLoop
        self._ends = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._ids = itertools.count(1)
        self._requests: dict[int, tuple[Future[object], Callable[[str], None] | None]] = {}
        self._followed = 0
        self._events_before = 0
        self._asked_at: float | None = None
        self._used_at = float("-inf")
        self._look_is_due = False

    # --- from any thread

    @property
    def session(self) -> Session:
        return self._session

    @property
    def waits_for_operator(self) -> bool:
        return self._waits_for_operator

    @property
    def unreachable(self) -> str:
        if self._lost:
            return self._lost
        silent = self._silent_for
        return f"the bridge has not answered for {silent:.0f} s" if silent > ANSWERS_WITHIN else ""

    @property
    def _silent_for(self) -> float:
        asked = self._asked_at
        return 0.0 if asked is None else time.monotonic() - asked

    def start(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread.start()
        try:
            self._started.result()
        except EngineError:
            self._thread.join()
            raise

    def stop(self, timeout: float = 5.0) -> None:
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._ends.set)
            self._thread.join(timeout)

    def snapshot(self) -> Snapshot:
        """The newest state that has come; the next one is asked for, so that it is there at the next call."""
        now = time.monotonic()
        since, self._used_at = now - self._used_at, now
        delay = since - _COMES_BEFORE_USE if since < _USED_REGULARLY else 0.0
        with contextlib.suppress(RuntimeError):  # detached already
            self._loop.call_soon_threadsafe(self._look_soon, delay)
        if self._silent_for > ANSWERS_WITHIN:
            return out_of_reach(self._shown, "the bridge does not answer", self._clock.time_ns() / 1e9)
        return self._shown

    def events(self, after: int = 0) -> list[Event]:
        return self._log.after(after)

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self._log.wait(after, timeout)

    def remembered_events(self, timeout: float) -> list[Event]:
        """The events that the bridge remembered when this attached; waits up to `timeout` s until all have come."""
        deadline = time.monotonic() + timeout
        while self._followed < self._events_before and (left := deadline - time.monotonic()) > 0:
            self._log.wait(self._log.last, min(left, _USED_REGULARLY))
        return self._log.after(0)

    # --- commands

    def add_topic(self, topic: Topic, link: str = "") -> Future[str]:
        return self._request(AddTopic(topic, link), str)

    def edit_topic(self, key: str, topic: Topic) -> Future[str]:
        return self._request(EditTopic(key, topic), str)

    def remove_topic(self, key: str) -> Future[None]:
        return self._request(RemoveTopic(key), _nothing)

    def pause(self, key: str, paused: bool) -> Future[None]:
        return self._request(Pause(key, paused), _nothing)

    def add_client(self, client: Client) -> Future[None]:
        return self._request(AddClient(client), _nothing)

    def change_client(self, client: Client) -> Future[None]:
        return self._request(ChangeClient(client), _nothing)

    def remove_client(self, name: str) -> Future[None]:
        return self._request(RemoveClient(name), _nothing)

    def retry(self, link: str = "") -> Future[None]:
        return self._request(Retry(link), _nothing)

    def shut_down(self) -> Future[None]:
        return self._request(ShutDown(), _nothing)

    def restart(self, step: Callable[[str], None] | None = None) -> Future[None]:
        return self._request(Restart(), _nothing, step)

    def reload(self, *, dry_run: bool = False) -> Future[Reloaded]:
        return self._request(Reload(dry_run), _reloaded)

    def use_file(self, path: Path | None) -> None:
        return  # the bridge keeps to its own

    def told_to_stop(self) -> None:
        return  # the bridge records it where it is told

    def topics(self, link: str | None = None) -> Future[list[TopicInfo]]:
        return self._request(Topics(link), _topics)

    def peek(self, key: str, *, kept: bool = False) -> Future[PeekedMessage | None]:
        return self._request(Peek(key, kept), _peeked)

    def describe(self, key: str) -> Future[str]:
        return self._request(Describe(key), str)

    def history(self, seconds: float) -> Future[HistoryReport]:
        return self._request(History(seconds), _history)

    def stop_bridge(self) -> Future[None]:
        """End the bridge's process, as SIGTERM does; done when it has understood."""
        return self._request(Stop(), _nothing)

    def _request(
        self, command: Command, convert: Callable[[object], T], step: Callable[[str], None] | None = None
    ) -> Future[T]:
        done: Future[T] = Future()
        answered: Future[object] = Future()

        def convert_answer(_: Future[object]) -> None:
            error = answered.exception()
            if done.cancelled():
                return
            if error is not None:
                done.set_exception(error)
            else:
                done.set_result(convert(answered.result()))

        answered.add_done_callback(convert_answer)
        try:
            self._loop.call_soon_threadsafe(self._send_request, command, answered, step)
        except RuntimeError:
            answered.set_exception(EngineError("detached from the bridge"))
        return done

    # --- on the thread

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._main())
        self._fail_requests("detached from the bridge")

    async def _main(self) -> None:
        ends = asyncio.create_task(self._ends.wait())
        attached = asyncio.create_task(self._attach_for_ever())
        await asyncio.wait((ends, attached), return_when=asyncio.FIRST_COMPLETED)
        for task in (ends, attached):
            task.cancel()
        await asyncio.gather(ends, attached, return_exceptions=True)
        if not self._started.done():
            self._started.set_exception(EngineError("detached from the bridge"))

    async def _attach_for_ever(self) -> None:
        """Attach, and again when the connection has broken; returns if the first attempt fails."""
        while True:
            try:
                reason = await self._attach()
            except NotServedError as error:
                reason = self._lost or str(error)  # the first reason says more
            except (ControlError, ProtocolError) as error:
                reason = str(error)
            except TimeoutError:
                reason = f"{self.path}: the bridge does not answer"
            except OSError as error:
                reason = f"{self.path}: {error.strerror or error}"
            self._writer = None
            if not self._started.done():
                self._started.set_exception(ControlError(reason))
                return
            self._lose(reason)
            await asyncio.sleep(_RETRY_EVERY)

    async def _attach(self) -> str:
        """Be attached until the connection ends; gives the reason."""
        reader, writer = await self._open()
        try:
            self._writer = writer
            self._send(Hello(protocol.VERSION, __version__, self.read_only))
            frames = protocol.frames_to_console()
            complete = False
            while True:
                async with asyncio.timeout(None if complete else ANSWERS_WITHIN):
                    data = await reader.read(_READ_SIZE)
                if not data:
                    return "the bridge's process has ended, or has closed the connection"
                for message in frames.feed(data):
                    if isinstance(message, (Goodbye, Refused)):
                        return message.reason
                    complete = self._handle(message) or complete
        finally:
            writer.transport.abort()

    async def _open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect; whatever ends this, no socket is left open.

        The socket is made between two awaits, so that a cancellation cannot come before somebody owns it.
        """
        async with asyncio.timeout(ANSWERS_WITHIN):
            while (connection := try_connect(self.path)) is None:  # noqa: ASYNC110 — the kernel tells of no event
                await asyncio.sleep(_BUSY_TRIED_EVERY)
        try:
            return await asyncio.open_unix_connection(sock=connection)
        except BaseException:
            connection.close()
            raise

    def _handle(self, message: ToConsole) -> bool:
        """Take a message; whether it completes a state."""
        match message:
            case Welcome():
                self._welcome(message.bridge)
            case State():
                if self._receiver.take(message):
                    self._show()
                    return True
            case Events():
                for event in message.events:
                    self._log.append(event)
                self._followed = message.events[-1].number
            case Step():
                _, step = self._requests.get(message.id, (None, None))
                if step is not None:
                    step(message.text)
            case Reply() | Failed():
                self._answered(message)
            case Refused() | Goodbye():
                raise AssertionError("ends the connection")
        return False

    def _welcome(self, bridge: BridgeInfo) -> None:
        another = not hasattr(self, "bridge") or self.bridge.instance != bridge.instance
        if another:
            self._followed = 0  # its events are numbered from 1
        self.bridge = bridge
        if self._lost:
            what = f", which has been started anew (pid {bridge.pid})" if another else ""
            self._log.add(Level.INFO, EventCode.ATTACH_AGAIN, f"attached to {bridge.name} again{what}")
        self._receiver = Receiver(bridge)
        self._look()
        self._send(Follow(self._followed))

    def _show(self) -> None:
        received = self._receiver
        assert received.snapshot is not None
        assert received.session is not None
        self._session = received.session
        self._waits_for_operator = received.waits_for_operator
        self._shown = replace(received.snapshot, last_event=self._log.last)
        self._asked_at = None
        self._lost = ""
        if not self._started.done():
            self._events_before = received.snapshot.last_event
            self._started.set_result(None)

    def _lose(self, reason: str) -> None:
        self._asked_at = None
        self._fail_requests(reason)
        if not self._lost:
            text = f"not attached to {self.bridge.name} any more: {reason}; trying again"
            self._log.add(Level.ERROR, EventCode.ATTACH_LOST, text)
        if reason != self._lost:
            self._lost = reason
            self._shown = out_of_reach(self._shown, reason, self._clock.time_ns() / 1e9)

    def _send(self, message: ToBridge) -> None:
        if self._writer is not None and not self._writer.is_closing():
            self._writer.write(protocol.encode(message))

    # --- looking

    def _look_soon(self, delay: float) -> None:
        if not self._look_is_due and self._asked_at is None and self._writer is not None:
            self._look_is_due = True
            self._loop.call_later(max(0.0, delay), self._look)

    def _look(self) -> None:
        self._look_is_due = False
        if self._writer is not None and self._asked_at is None:
            self._asked_at = time.monotonic()
            self._send(Look())

    # --- requests

    def _send_request(self, command: Command, answered: Future[object], step: Callable[[str], None] | None) -> None:
        if self._writer is None:
            answered.set_exception(EngineError(f"not attached: {self._lost}"))
            return
        number = next(self._ids)
        self._requests[number] = (answered, step)
        self._send(Request(number, command))

    def _answered(self, answer: Reply | Failed) -> None:
        answered, _ = self._requests.pop(answer.id, (None, None))
        if answered is None:
            raise ProtocolError("an answer without a request")
        if isinstance(answer, Failed):
            answered.set_exception(EngineError(answer.reason))
        else:
            answered.set_result(answer.reloaded or answer.history or answer.value)

    def _fail_requests(self, reason: str) -> None:
        requests, self._requests = self._requests, {}
        for answered, _ in requests.values():
            answered.set_exception(EngineError(f"no answer: {reason}"))


def _nothing(_: object) -> None:
    return None


def _peeked(value: object) -> PeekedMessage | None:
    assert value is None or isinstance(value, PeekedMessage)
    return value


def _reloaded(value: object) -> Reloaded:
    assert isinstance(value, Reloaded)
    return value


def _history(value: object) -> HistoryReport:
    assert isinstance(value, HistoryReport)
    return value


def _topics(value: object) -> list[TopicInfo]:
    assert isinstance(value, tuple)
    return list(value)
