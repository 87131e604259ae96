"""A console that is attached over any connection: executes its commands, and sends it the engine's state."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from rsb_bridge.api import EngineError, InvalidRequestError, Unable
from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import ControlProtocolError
from rsb_bridge.control.states import EncodedRoutes, StateSender
from rsb_bridge.model.by_hand import TICKET_LIFE
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.commands import (
    ActingOperator,
    ArmTopic,
    AskHolder,
    ReleaseArmed,
    Right,
    Stop,
    TakeArming,
    acting,
    on_console,
    undoing,
)
from rsb_bridge.model.session import session_keys
from rsb_bridge.model.wording import Wording
from rsb_bridge.tasks import Tasks

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.protocol import BridgeInfo, ToBridge, ToConsole

_TICK = 0.25  # s between two looks for news: an engine renews its snapshot no more often
_PAUSE = 0.0005  # s of rest between two parts of a state, in which the bridge's threads run
_HELLO_WITHIN = 5.0  # s. A round figure: a silent connection holds one of the places for consoles
# s for which a console may take nothing, until its connection is given up. A round figure: one that is stopped for 30 s
# goes on afterwards.
_STALLED_FOR = 60.0
# s after which a look is answered though nothing is new: the engine has stopped, the bridge's process has not. After
# 5 s (`remote_engine.ANSWERS_WITHIN`) the console would call the bridge unreachable.
_ANSWERED_WITHIN = 2.0
_WAITING_BYTES = 4 << 20  # that may wait for one console beyond a state: answers to commands only
_FEW_EVENTS = 20  # that are sent at once at first, and at least: 6 kB, half a second of a link of 14 kB/s
# s from events to the next ones. A connection may keep megabytes (4 MiB over Zenoh), and the states behind them would
# come as late as that takes: minutes on a thin link. A round figure.
_EVENTS_TAKE = 0.5


class RequestRefused(Wording):
    """Reasons why an attached console's command is not executed."""

    READ_ONLY = "{reason}: nothing can be changed"
    ASKS_FIRST = "{reason}: ask the holder"
    LATE = "the command came too late: its connection, or this program, was held up; give it again"
    TOO_MANY_WAITING = "{count} requests already wait for an answer: try again later"


class AcceptedConnection(Protocol):
    """A console's byte stream, and the operator at its other end. Belongs to one event loop."""

    @property
    def operator(self) -> ActingOperator:
        """The operator, as the kernel or a key proves it."""

    @property
    def read_only_reason(self) -> str:
        """The reason this operator may change nothing, or an empty string."""

    @property
    def never_takes_reason(self) -> str:
        """The reason this operator may take no arming from its holder without asking, or an empty string."""

    @property
    def of_this_machine(self) -> bool:
        """Whether the console runs on the bridge's machine, as the bridge's user or root."""

    @property
    def buffered(self) -> int:
        """Bytes that wait to be taken."""

    @property
    def closing(self) -> bool:
        """Whether nothing can be sent any more."""

    def write(self, data: bytes) -> None:
        """Send, or keep until that is possible."""

    def close(self) -> None:
        """Close once what waits is sent."""

    def close_lingering(self) -> None:
        """Close once what waits is sent, and the console has had time to read it."""

    def abort(self) -> None:
        """Close, and forget what waits."""


class ConsoleHost(Protocol):
    """The engine that all its consoles share, and its process.

    Attributes:
        engine: to be shown and commanded.
        encoded: the parts of the state that are encoded already.
    """

    engine: EngineApi
    encoded: EncodedRoutes

    @property
    def info(self) -> BridgeInfo:
        """The description of its process."""

    def summary(self) -> bytes:
        """Return the engine in a few figures, at most `SUMMARY_EVERY` s old, or empty bytes."""

    def stop_process(self) -> None:
        """End the process, as `rsb_bridge.model.commands.Stop` asks."""


class TicketClock:
    """Issues the tickets of one connection: proofs that its console has heard from the bridge a moment ago.

    A command may wait in a frozen program, a hung tunnel or a full buffer. Answers and states bring tickets, a request
    brings the newest one back, and the bridge refuses what moves a robot if the ticket is old. Only the bridge's clock
    counts, and another connection's tickets are void.

    Args:
        steady: gives s on a clock that is never set.
    """

    def __init__(self, steady: Callable[[], float] = Clock.steady) -> None:
        self._steady = steady
        # 40 bits of ms are 35 years: a ticket of another connection is far too old, or not issued yet.
        self._first = secrets.randbits(40) - int(steady() * 1e3)

    def issue(self) -> int:
        return self._first + int(self._steady() * 1e3)

    def age(self, ticket: int) -> float:
        """Return the age of a ticket in s. It is negative for one that was never issued."""
        return (self.issue() - ticket) / 1e3


class AttachedConsole:
    """One console, from the start of its connection. The owner of the connection passes on its bytes, and its end.

    Args:
        served: the engine that it is attached to.
        refusal: the reason to refuse it as soon as it says hello, or an empty string.
    """

    def __init__(self, served: ConsoleHost, connection: AcceptedConnection, refusal: str = "") -> None:
        self._served = served
        self._refusal = refusal
        self._engine = served.engine
        self._connection = connection
        self._frames = protocol.frames_to_bridge()
        self._loop = asyncio.get_running_loop()
        self._sender = StateSender()
        self._sending = asyncio.Lock()
        self._looking = False
        self._looked_at = 0.0
        self._after: int | None = None
        """The number of the last event that it has or that is on the way to it, or None until it follows them."""
        self._events_sent = 0
        self._events_sent_at = 0.0
        self._has_events = False
        """Whether it has taken the events that were sent last."""
        self._watching = False
        self._summary = b""
        self._summed_at = float("-inf")
        self._denied: dict[Right, str] = {}
        """The reason that this console lacks a right, or an empty string; from the welcome on."""
        self._operator = ActingOperator("", "")
        self._welcomed = False
        self._tasks = Tasks(self._loop, self.abort)
        self._ended = False
        """Whether it was sent the goodbye."""
        self._requests = 0
        self._cancellable: dict[int, asyncio.Future[Any]] = {}
        """The engine's answers to these commands that are still to come, by the requests' ids."""
        self._tickets = TicketClock()
        self._has_armed = False
        self._tasks.spawn(self._tick())

    def received(self, data: bytes) -> None:
        """Act on bytes from the console.

        Raises:
            ProtocolError: the console breaks the protocol.
        """
        if self._ended:
            return
        for message in self._frames.feed(data):
            self._handle(message)

    def gone(self) -> None:
        """Take the end of the connection."""
        self._tasks.cancel()
        for done in self._cancellable.values():
            done.cancel()
        self.doubted()

    def doubted(self) -> None:
        """Disarm what the console has armed: it may be gone, and whether it is takes seconds to find out."""
        if self._has_armed:
            with acting(self._operator), on_console(self):
                self._engine.do(ReleaseArmed())

    def send(self, message: ToConsole) -> None:
        """Hand a message to the connection, or keep it until that takes it."""
        if self._ended or self._connection.closing:
            return
        self._connection.write(protocol.encode(message))
        if self._connection.buffered > _WAITING_BYTES + protocol.TO_CONSOLE_LIMIT:
            self.abort()

    def abort(self) -> None:
        self._connection.abort()

    def end(self, reason: str) -> None:
        """Send the last events and the reason for the end; then close."""
        while self._send_events(protocol.EVENTS_AT_ONCE):
            pass
        self.send(protocol.Goodbye(reason))
        self._ended = True
        self._connection.close_lingering()

    # --- messages from it

    def _handle(self, message: ToBridge) -> None:
        if isinstance(message, protocol.ConsoleHello):
            if self._welcomed:  # it could end the read-only access that it began with
                raise ControlProtocolError("a second hello")
            self._greet(message)
        elif not self._welcomed:
            raise ControlProtocolError("no hello")
        elif isinstance(message, protocol.PollState):
            if not self._looking:
                self._looking = True
                self._looked_at = self._loop.time()
                self._tasks.spawn(self._show())
        elif isinstance(message, protocol.FollowEvents):
            # A rogue console's -2**63 is more than `EventLog.after` can count.
            self._after = max(0, message.after)
            self._has_events = True
            self._follow()
        elif isinstance(message, protocol.Watch):
            self._watching = True
            self._send_summary()
        elif isinstance(message, protocol.CommandWithdrawn):
            if (done := self._cancellable.get(message.id)) is not None:
                done.cancel()
        else:
            self._request(message)

    def _greet(self, hello: protocol.ConsoleHello) -> None:
        info = self._served.info
        versions = protocol.version_problem((protocol.VERSION, info.program), (hello.version, hello.program))
        if problem := self._refusal or versions:
            self.send(protocol.HelloRefused(problem))
            self._connection.close()
            return
        self._welcomed = True
        self._operator = self._connection.operator
        read_only = self._connection.read_only_reason
        attached_read_only = "attached read-only" if hello.read_only else ""
        changes = read_only or attached_read_only
        takes = changes or self._connection.never_takes_reason
        self._denied = {Right.MEASURE: read_only, Right.CHANGE: changes, Right.TAKE: takes}
        self.send(protocol.ConsoleWelcome(info, bool(changes), may_take=not takes))

    def _request(self, request: protocol.CommandRequest) -> None:
        command, most = request.command, protocol.REQUESTS_WAITING
        if reason := self._denied.get(command.right):
            asks = command.right is Right.TAKE and not self._denied[Right.CHANGE]
            text = RequestRefused.ASKS_FIRST if asks else RequestRefused.READ_ONLY
            self.send(protocol.CommandFailed(request.id, text(reason=reason)))
        elif self._requests >= most:
            self.send(protocol.CommandFailed(request.id, RequestRefused.TOO_MANY_WAITING(count=most)))
        elif command.expires and not 0 <= self._tickets.age(request.ticket) <= TICKET_LIFE:
            late, ticket = RequestRefused.LATE(), self._tickets.issue()
            self.send(protocol.CommandFailed(request.id, late, late=True, ticket=ticket))
        else:
            self._requests += 1
            # Before it is carried out: the console may go meanwhile, and `gone` has to know.
            self._has_armed |= isinstance(command, ArmTopic | AskHolder | TakeArming)
            self._tasks.spawn(self._answer(request, self._begin(request)))

    def _begin(self, request: protocol.CommandRequest) -> asyncio.Future[Any]:
        """Give a command to the engine; not in a task, so that a `CommandWithdrawn` that comes with it finds it."""
        with acting(self._operator), undoing(request.undo), on_console(self):
            done = asyncio.wrap_future(self._engine.do(request.command, lambda text: self._step(request.id, text)))
        if isinstance(request.command, Stop):
            self._served.stop_process()
        done.add_done_callback(_look_at_error)
        if request.command.cancellable:
            self._cancellable[request.id] = done
            done.add_done_callback(lambda _: self._cancellable.pop(request.id, None))
        return done

    async def _answer(self, request: protocol.CommandRequest, done: asyncio.Future[Any]) -> None:
        try:
            await asyncio.wait((done,))  # if this console goes, the engine finishes most commands all the same
            await asyncio.sleep(0)  # steps that the engine's thread told before the result are sent before it, too
        finally:
            self._requests -= 1
        reply: protocol.Reply | protocol.CommandFailed
        try:
            reply = protocol.Reply(request.id, done.result())
        except EngineError as error:
            reply = protocol.CommandFailed(request.id, str(error), isinstance(error, InvalidRequestError))
        except asyncio.CancelledError:
            reply = protocol.CommandFailed(request.id, "this console has withdrawn it")
        except Exception as error:  # noqa: BLE001 -- the end of the connection would disarm what this console holds
            self._loop.call_exception_handler({"message": "a command failed", "exception": error})
            reply = protocol.CommandFailed(request.id, Unable.INTERNAL(problem=error))
        if (
            request.command.right in (Right.CHANGE, Right.TAKE)
            and self._sender.sent is not None
            and self._connection.buffered == 0
        ):
            await self._send_state()  # before the reply: the operator wants to see the effect
        self.send(msgspec.structs.replace(reply, ticket=self._tickets.issue()))

    def _step(self, request: int, text: str) -> None:
        """Tell a step of a restart; called on the engine's thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self.send, protocol.RestartStep(request, text))

    # --- messages to it

    async def _tick(self) -> None:
        """Send what is new, four times a second, for ever; give up on a console that is silent or takes nothing."""
        born = taken_at = self._loop.time()
        before = 0
        while True:
            await asyncio.sleep(_TICK)
            now, waiting = self._loop.time(), self._connection.buffered
            if not self._welcomed:
                if now - born > _HELLO_WITHIN:
                    self.abort()
                continue
            if waiting == 0 or waiting != before:
                taken_at = now
            before = waiting
            if now - taken_at > _STALLED_FOR:
                self.abort()
            elif waiting == 0:
                self._follow()
                self._send_summary()
                await self._show()

    def _follow(self) -> None:
        """Send the next events, as many as take `_EVENTS_TAKE`, once the console has the last ones."""
        if self._has_events:
            took = max(1e-3, self._loop.time() - self._events_sent_at)
            most = int(self._events_sent * _EVENTS_TAKE / took)
            self._send_events(min(protocol.EVENTS_AT_ONCE, max(_FEW_EVENTS, most)))

    def _send_events(self, most: int) -> bool:
        """Send the next events; return whether there were any."""
        events = [] if self._after is None or self._connection.buffered else self._engine.events(self._after)[:most]
        if events:
            self._after, self._has_events = events[-1].number, False
            self._events_sent, self._events_sent_at = len(events), self._loop.time()
            self.send(protocol.Events(tuple(events)))
        return bool(events)

    def _send_summary(self) -> None:
        """Send the engine's figures if they have changed, or as a sign of life."""
        since = self._loop.time() - self._summed_at
        if not self._watching or since < protocol.SUMMARY_EVERY:
            return
        summary = self._served.summary()
        if summary and (summary != self._summary or since >= protocol.SIGN_OF_LIFE_EVERY):
            self._summary, self._summed_at = summary, self._loop.time()
            self.send(protocol.Summary(summary))

    async def _show(self) -> None:
        """Send the state if it is a new one; or if it has been looked for long enough to wonder what is wrong."""
        if not self._looking or self._connection.buffered:
            return
        is_new = self._engine.snapshot() is not self._sender.sent
        if is_new or self._loop.time() - self._looked_at > _ANSWERED_WITHIN:
            # First: the console may poll for the next state while parts of this one wait to be sent.
            self._looking = False
            await self._send_state()

    async def _send_state(self) -> None:
        # Else an answer could send a newer state between two parts of this one.
        async with self._sending:
            engine, encoded = self._engine, self._served.encoded
            snapshot, session = engine.snapshot(), engine.session
            hidden = {name for name, key in session_keys().items() if key.hidden_as}
            if not self._connection.of_this_machine and not hidden.isdisjoint(session.features):
                # A command line may contain secrets, and is of no use to an operator elsewhere.
                shown = {name: value for name, value in session.features.items() if name not in hidden}
                session = msgspec.structs.replace(session, features=shown)
            for state in self._sender.differences(
                snapshot, session, waits_for_operator=engine.waits_for_operator, encoded=encoded
            ):
                self.send(state if state.more else msgspec.structs.replace(state, ticket=self._tickets.issue()))
                if state.more:
                    await asyncio.sleep(_PAUSE)
            encoded.keep_only(snapshot)


def _look_at_error(done: asyncio.Future[Any]) -> None:
    """Take a command's error, which asyncio would log with a traceback if the console has gone before it."""
    if not done.cancelled():
        done.exception()
