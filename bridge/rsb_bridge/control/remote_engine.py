"""An engine in another process, attached over the control socket of this machine, or from another machine."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol

from rsb_bridge.api import EngineApi, EngineError, InvalidRequestError, NoAnswerError, Unable
from rsb_bridge.control import protocol
from rsb_bridge.control.control_sockets import (
    AttachProblem,
    ControlError,
    NotServedError,
    may_control,
    peer_of,
    try_connect,
)
from rsb_bridge.control.protocol import CommandRequest, ControlProtocolError, RequestProblem, UnexpectedMessage
from rsb_bridge.control.states import StateReceiver, UntrustedMessages
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import R, is_undo
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.wording import Wording
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import out_of_reach

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.control.protocol import BridgeInfo, ToBridge, ToConsole
    from rsb_bridge.model.commands import Command
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Event, Snapshot

ANSWERS_WITHIN = 5.0
"""s in which a bridge welcomes a console, and after which one that is silent counts as unreachable."""
_RETRY_EVERY = 0.5
"""s between two attempts to attach again. A round figure: a console shows a restarted bridge so much later."""
_COMES_BEFORE_USE = 0.1
"""s: the next state is asked for so long before it is likely to be used."""
_USED_REGULARLY = 3.0
"""s between two uses up to which the next use is expected after the same time. A later one waits for a new state: the
one here is as old as the use before. A round figure."""
_RENEWED_WITHIN = 1.0
"""s that such a use waits at most: a bridge renews its snapshot once a second."""
_BUSY_TRIED_EVERY = 0.05  # s. A round figure: a console attaches so much later at most
_READ_SIZE = 256 << 10

_logger = logging.getLogger(__name__)


class AttachedAgain(Wording):
    """Reports of a console that is attached again."""

    SAME = "attached again to {name}"
    RESTARTED = "attached again to {name}, which was restarted (pid {pid})"


class Connection(Protocol):
    """A console's end of a connection; belongs to one event loop."""

    async def read(self) -> bytes:
        """Return the next bytes, or nothing if the connection has ended.

        Raises:
            ControlError: the engine or this side ended it; the message has the reason.
            OSError: it broke.
        """

    def write(self, data: bytes) -> None:
        """Send, or keep until that is possible. After the end, nothing happens."""

    def abort(self) -> None:
        """Close, and forget what waits."""


class Connector(Protocol):
    """Connects to one engine, any number of times."""

    @property
    def uid(self) -> int | None:
        """The user who serves the newest connection, as this machine's kernel says; None on another machine."""

    @property
    def text(self) -> str:
        """The name of the engine for messages, until the engine itself has given one."""

    async def open(self, within: float) -> Connection:
        """Connect within so many s. Nothing is left open if this fails or is cancelled.

        Raises:
            ControlError, OSError, TimeoutError: there is no connection; the first one's message has the reason.
        """


class UnixSocket:
    """The control socket of an engine on this machine."""

    uid: int | None = None

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = str(path)

    async def open(self, within: float) -> Connection:
        # The socket is made between two awaits, so that a cancellation cannot come before somebody owns it.
        async with asyncio.timeout(within):
            while (connection := try_connect(self.path)) is None:  # noqa: ASYNC110 — the kernel tells of no event
                await asyncio.sleep(_BUSY_TRIED_EVERY)
        try:
            _, self.uid, _ = peer_of(connection)
            return _SocketConnection(*await asyncio.open_unix_connection(sock=connection))
        except BaseException:
            connection.close()
            raise


class _SocketConnection:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    async def read(self) -> bytes:
        return await self._reader.read(_READ_SIZE)

    def write(self, data: bytes) -> None:
        if not self._writer.is_closing():
            self._writer.write(data)

    def abort(self) -> None:
        self._writer.transport.abort()


@dataclass(frozen=True, slots=True)
class _Waiting(Generic[R]):
    """A command without a reply, given by its operator at a time (s) of `Clock.steady`."""

    command: Command[R]
    future: Future[R]
    step: Callable[[str], None] | None
    undo: bool
    given_at: float

    @property
    def is_old(self) -> bool:
        """Whether nobody may want it any more."""
        return self.command.expires and Clock.steady() - self.given_at > self.command.life

    def end(self, result: Callable[[], R] | EngineError) -> None:
        if not self.future.set_running_or_notify_cancel():
            return
        try:
            if isinstance(result, EngineError):
                raise result
            self.future.set_result(result())
        except EngineError as error:
            self.future.set_exception(error)


class RemoteEngine(EngineApi):
    """Fulfils `EngineApi` for an engine of another process.

    `start` attaches. When the connection breaks later, it reports that (`unreachable`, and an event), shows everything
    as down, and attaches again as soon as possible. `stop` detaches; the engine goes on.

    Args:
        where: the path of its control socket, or another way to it.
        read_only: whether the bridge is to refuse all changes.

    Attributes:
        given_at: the time (s) of `Clock.steady` when the operator gave the commands that this engine gets, or None for
            the time when it gets them.
        bridge: the description of its bridge; like `read_only` and `may_take`, as the bridge says from `start` on.
        uid: the user who serves the newest connection, as this machine's kernel says; None on another machine.
    """

    def __init__(self, where: Path | Connector, *, read_only: bool = False, clock: Clock | None = None) -> None:
        self._way: Connector = UnixSocket(where) if isinstance(where, Path) else where
        self.read_only = self._wants_read_only = read_only
        self.given_at: float | None = None
        self.bridge: BridgeInfo
        self._clock = clock or Clock()
        self._log = EventLog(self._clock)
        self._cleaner = UntrustedMessages(time.monotonic())
        self._shown: Snapshot
        self._session: Session
        self._waits_for_operator = False
        self._lost = ""
        self._goodbye = ""  # the reason, until the next state comes
        self._lost_at = 0.0
        self._receiver: StateReceiver | None = None
        self._connection: Connection | None = None
        self._ids = itertools.count(1)  # on across connections
        self._waiting: dict[int, _Waiting[Any]] = {}
        self._ticket = 0
        self._followed = self._events_before = 0
        self._asked_at: float | None = None
        self._heard_at = self._used_at = float("-inf")
        self._poll_is_due = False
        self._shown_at = float("-inf")
        self._renewed = threading.Event()
        self._started: Future[None] = Future()
        self._ends = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop
        self._thread = threading.Thread(target=self._run, name="rsb-attached", daemon=True)

    # --- from any thread

    @property
    def session(self) -> Session:
        return self._session

    @property
    def waits_for_operator(self) -> bool:
        return self._waits_for_operator

    @property
    def unreachable(self) -> str:
        silent = self._silent_for
        return self._lost or (AttachProblem.SILENT_FOR(seconds=silent) if silent > ANSWERS_WITHIN else "")

    @property
    def _silent_for(self) -> float:
        # A state may take longer over a thin line, but then parts of it come.
        asked = self._asked_at
        return 0.0 if asked is None else time.monotonic() - max(asked, self._heard_at)

    @property
    def uid(self) -> int | None:
        return self._way.uid

    @property
    def file_here(self) -> Path | None:
        """The path of the bridge's session file, or None if no bridge that is trusted names one."""
        return Path(self.bridge.file) if self.bridge.file is not None and self.trusted else None

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
            self._call(self._ends.set)
            self._thread.join(timeout)

    def _call(self, work: Callable[..., object], *arguments: object) -> bool:
        """Have the thread do something; return False if it is detached already."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(work, *arguments)
            return True
        return False

    def snapshot(self) -> Snapshot:
        """Return the newest state, and request the next one; wait for that after a pause."""
        now = time.monotonic()
        since, self._used_at = now - self._used_at, now
        if since > _USED_REGULARLY < now - self._shown_at and not self._lost:
            self._renewed.clear()
            if self._call(self._poll_soon, 0.0):
                self._renewed.wait(_RENEWED_WITHIN)
        else:
            self._call(self._poll_soon, since - _COMES_BEFORE_USE if since < _USED_REGULARLY else 0.0)
        if (silent := self._silent_for) > ANSWERS_WITHIN:
            wall = self._clock.time_ns() / 1e9
            return out_of_reach(self._shown, AttachProblem.SILENT(), since=wall - silent, now=wall)
        return self._shown

    @property
    def name(self) -> str:
        """The name by which operators choose its bridge: here its socket's, since two bridges may have one name."""
        return self._way.path.stem if isinstance(self._way, UnixSocket) else self.bridge.name

    def events(self, after: int = 0) -> list[Event]:
        return self._log.after(after)

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self._log.wait(after, timeout)

    def remembered_events(self, timeout: float) -> list[Event]:
        """Return the events that the bridge remembered at the attach; wait up to `timeout` s until all have come."""
        deadline = time.monotonic() + timeout
        while self._followed < self._events_before and (left := deadline - time.monotonic()) > 0:
            self._log.wait(self._log.last, min(left, _USED_REGULARLY))
        return self._log.after(0)

    def use_file(self, path: Path | None, holds: Session | None = None) -> None:
        return  # the bridge keeps to its own

    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        future: Future[R] = Future()
        given_at = Clock.steady() if self.given_at is None else self.given_at
        if not self._call(self._send_request, _Waiting(command, future, step, is_undo(), given_at)):
            future.set_exception(EngineError(AttachProblem.DETACHED()))
        return future

    # --- on the thread

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._main())
        self._fail(AttachProblem.DETACHED())

    async def _main(self) -> None:
        tasks = [asyncio.create_task(self._ends.wait()), asyncio.create_task(self._attach_for_ever())]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if not self._started.done():
            self._started.set_exception(EngineError(AttachProblem.DETACHED()))

    async def _attach_for_ever(self) -> None:
        """Attach, and again when the connection has broken; returns if the first attempt fails."""
        while True:
            failure = None
            try:
                reason = await self._attach()
            except NotServedError as error:
                reason = self._lost or str(error)  # the first reason says more
            except ControlError as error:
                reason, failure = str(error), error
            except (ControlProtocolError, TimeoutError) as error:
                problem = AttachProblem.SILENT() if isinstance(error, TimeoutError) else error
                reason = AttachProblem.ON_SOCKET(where=self._way.text, problem=problem)
            except OSError as error:
                # After a bridge's goodbye its machine refuses the next connection: the goodbye gives the better reason.
                reason = self._goodbye or AttachProblem.ON_SOCKET(where=self._way.text, problem=error.strerror or error)
            except Exception as error:  # the last resort: a console would show the last state for ever
                reason = Unable.INTERNAL(problem=error)
                if reason != self._lost:  # not twice a second
                    _logger.exception("internal error of the attachment")
            self._connection = None
            if not self._started.done():
                self._started.set_exception(failure or ControlError(reason))
                return
            self._lose(reason)
            await asyncio.sleep(_RETRY_EVERY)

    async def _attach(self) -> str:
        """Stay attached until the connection ends; return the reason."""
        connection = await self._way.open(ANSWERS_WITHIN)
        try:
            self._connection = connection
            # Root attaches to services, too, whose users may say anything.
            self.trusted = self.uid is not None and may_control(self.uid)
            self._send(protocol.hello(read_only=self._wants_read_only))
            frames = protocol.frames_to_console()
            complete = False
            while True:
                # Later, a bridge may have nothing new for hours; `unreachable` shows whether it owes an answer.
                async with asyncio.timeout(None if complete else ANSWERS_WITHIN):
                    data = await connection.read()
                if not data:
                    return AttachProblem.ENDED()
                self._heard_at = time.monotonic()
                for message in frames.feed(data):
                    if not self.trusted:
                        message = self._cleaner(message, time.monotonic())  # noqa: PLW2901 -- the same one, cleaned
                    if isinstance(message, (protocol.Goodbye, protocol.HelloRefused)):
                        self._goodbye = message.reason if isinstance(message, protocol.Goodbye) else ""
                        return message.reason
                    complete = self._handle(message) or complete
        finally:
            connection.abort()

    def _handle(self, message: ToConsole) -> bool:
        """Take a message; whether it completes a state."""
        match message:
            case protocol.ConsoleWelcome():
                self.read_only, self.may_take = message.read_only, message.may_take
                self._welcome(message.bridge)
            case protocol.StateChange():
                if self._receiver is None:
                    raise ControlProtocolError("a state before the welcome")
                if self._receiver.receive(message):
                    self._ticket = message.ticket
                    self._show(self._receiver)
                    return True
            case protocol.Events():
                for event in message.events:
                    self._log.append(event)
                    self._followed = event.number
                self._send(protocol.FollowEvents(self._followed))
            case protocol.RestartStep():
                if (waiting := self._waiting.get(message.id)) is not None and waiting.step is not None:
                    waiting.step(message.text)
            case protocol.Reply() | protocol.CommandFailed():
                self._ticket = message.ticket or self._ticket  # some refusals bring none
                self._replied(message)
            case protocol.Summary():
                raise ControlProtocolError("a summary that nobody has asked for")
            case protocol.HelloRefused() | protocol.Goodbye():
                raise AssertionError("ends the connection")
        return False

    def _replied(self, message: protocol.Reply | protocol.CommandFailed) -> None:
        waiting = self._waiting.pop(message.id, None)
        if waiting is None:
            raise ControlProtocolError(UnexpectedMessage.UNASKED())
        if isinstance(message, protocol.Reply):
            waiting.end(lambda: protocol.result_of(waiting.command, message))
        elif message.late:
            self._send_request(waiting)
        else:
            waiting.end((InvalidRequestError if message.invalid else EngineError)(message.reason))

    def _welcome(self, bridge: BridgeInfo) -> None:
        another = not hasattr(self, "bridge") or self.bridge.instance != bridge.instance
        if another:
            self._followed = 0  # its events are numbered from 1
        self.bridge = bridge
        if self._lost:
            text = AttachedAgain.RESTARTED if another else AttachedAgain.SAME
            self._log.add(Level.INFO, EventCode.ATTACH_AGAIN, text(name=self.name, pid=bridge.pid))
        self._receiver = StateReceiver(bridge, trusted=self.trusted)
        self._poll()
        self._send(protocol.FollowEvents(self._followed))

    def _show(self, received: StateReceiver) -> None:
        assert received.snapshot is not None
        assert received.session is not None
        self._session = received.session
        self._waits_for_operator = received.waits_for_operator
        # Events have other numbers here: this side adds its own.
        self._shown = replace(received.snapshot, last_event=self._log.last)
        self._shown_at = time.monotonic()
        self._renewed.set()
        self._asked_at = None
        self._lost = self._goodbye = ""
        if not self._started.done():
            self._events_before = received.snapshot.last_event
            self._started.set_result(None)

    def _lose(self, reason: str) -> None:
        """Show that the connection is lost, and report it last: its listeners look at once."""
        self._asked_at = None
        before, now = self._lost, self._clock.time_ns() / 1e9
        if not before:
            self._lost_at = now
        if reason != before:
            self._shown = out_of_reach(self._shown, reason, since=self._lost_at, now=now)
            self._lost = reason
        self._renewed.set()
        self._fail(reason)
        if not before:
            why = reason.removeprefix(f"{self._way.text}: ")
            text = f"not attached to {self.name} any more: {why}; trying again"
            self._log.add(Level.ERROR, EventCode.ATTACH_LOST, text)

    def _fail(self, reason: str) -> None:
        """Fail all commands, because no reply will come."""
        failed, self._waiting = self._waiting, {}
        for waiting in failed.values():
            waiting.end(NoAnswerError(f"no answer: {reason}"))

    def _send(self, message: ToBridge) -> None:
        if self._connection is not None:
            self._connection.write(protocol.encode(message))

    def _poll_soon(self, delay: float) -> None:
        if not self._poll_is_due and self._asked_at is None and self._connection is not None:
            self._poll_is_due = True
            self._loop.call_later(max(0.0, delay), self._poll)

    def _poll(self) -> None:
        self._poll_is_due = False
        if self._connection is not None and self._asked_at is None:
            self._asked_at = time.monotonic()
            self._send(protocol.PollState())

    def _send_request(self, waiting: _Waiting[R]) -> None:
        """Send a command, unless its operator has waited so long that it may no longer be wanted."""
        if waiting.is_old:
            waiting.end(EngineError(RequestProblem.TOO_LATE()))
            return
        if waiting.future.cancelled():
            return
        if self._connection is None:
            waiting.end(EngineError(AttachProblem.NOT_ATTACHED(why=self._lost)))
            return
        number = next(self._ids)
        request = CommandRequest(number, waiting.command, waiting.undo, self._ticket)
        try:
            size = len(protocol.encode(request))
        except UnicodeEncodeError:
            waiting.end(InvalidRequestError(RequestProblem.NOT_UNICODE()))
            return
        if size > protocol.TO_BRIDGE_LIMIT:  # the bridge would end the connection
            waiting.end(EngineError(RequestProblem.TOO_LONG(size=size)))
            return
        self._waiting[number] = waiting
        self._send(request)

        def given_up(future: Future[R]) -> None:
            """Tell the bridge that nobody waits for it any more. Called on any thread."""
            if future.cancelled():
                self._call(self._send, protocol.CommandWithdrawn(number))

        waiting.future.add_done_callback(given_up)


def attach(where: Path | Connector, *, read_only: bool) -> RemoteEngine:
    """Attach to a bridge by its control socket or another connection; may take some seconds.

    Raises:
        EngineError: the attachment fails.
    """
    engine = RemoteEngine(where, read_only=read_only)
    engine.start()
    return engine
