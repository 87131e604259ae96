"""What both halves of a route of calls share.

Such a route consists of *lanes* (`rsb_bridge.model.calls`): services, and topics that go from the providing side to the
callers'. All that crosses is a frame of a lane (`rsb_bridge.wire.headers`), on one channel, which sends both ways.

Where a lane's frames pass, for kinds that do more than carry them:

- a request, on the callers' side: `CallingRoute._asked` (from ROS) → `_begin` → `_leaves` → the channel
- a request, on the providing side: the channel → `ProvidingRoute._take_call` → ROS
- a response, on the providing side: `ProvidingRoute._responded` (from ROS) → `_leaves` → the channel
- a response, on the callers' side: the channel → `CallingRoute._take_answer` → ROS
- a message: `ProvidingRoute._published` (from ROS) → the channel → `CallingRoute._take_message` → ROS
- a call that will have no answer: `_give_up`, on either side; `_give_up_all`, when the opening or the offer ends
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import msgspec
import zstandard

from rsb_bridge.cdr.checker import MalformedError, TooComplexError
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.calls import LANES, Refused
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import CALL_TIMEOUT
from rsb_bridge.model.snapshot import Ledger, Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_endpoints import name_of, route_type_of
from rsb_bridge.route.calls.calls_ledger import REMEDIES, CallsLedger
from rsb_bridge.route.calls.calls_verdict import CallsFacts, Trouble, judge_calls
from rsb_bridge.route.combined_verdict import lasting, node_names, record_of
from rsb_bridge.route.message_check import ExpandsTooMuchError, MessageCheck, Unpacker, malformed_text
from rsb_bridge.route.route import Route
from rsb_bridge.wire.framing import LEASED, ZSTD, Message
from rsb_bridge.wire.headers import (
    CALL_HEADER_LENGTH,
    LEASE_HEADER_LENGTH,
    CallFrame,
    What,
    split_number,
    unpack_call,
    with_number,
)
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import CallsReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.channel.channel import DuplexChannel, SendingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.route import Owner
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import LaneEntry

_BATCH = 32
_OF_CALLS = (What.CALL, What.AGAIN, What.ANSWER)
_ZSTD_LEVEL = 3
_MOST_REFUSALS = 8192
"""That wait; a peer that asks and does not read makes more. A call whose refusal is dropped expires there."""
_MESSAGE_BYTES = 32 << 20
"""Of messages that wait, of all lanes."""


class CallsOutbox:
    """One half's.

    What calls and answers hold is in the budget of calls; messages and refusals are bounded here.

    Args:
        transport: what carries the route.
        proposal: what the two sides have agreed on.
        lanes: of the route.
        leaves: asked right before a call or an answer is sent: False: it is wanted no more.
        stamp: gives the stamp of a message that has none.
    """

    def __init__(
        self,
        transport: Transport,
        proposal: Propose,
        lanes: Sequence[Lane],
        leaves: Callable[[CallFrame], bool],
        stamp: Callable[[], int],
    ) -> None:
        self.largest = transport.largest_message - CALL_HEADER_LENGTH - LEASE_HEADER_LENGTH
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if proposal.compression == "zstd" else None
        self._lanes = lanes
        self._leaves = leaves
        self._stamp = stamp
        self._frames: OrderedDict[int, CallFrame] = OrderedDict()  # by number of the call; others by one below 0
        self._others = 0
        self._refusals = 0
        self._messages: Counter[int] = Counter()  # that wait, by lane
        self._message_bytes = 0

    def put(self, frame: CallFrame) -> None:
        """Have a frame wait for its turn; of a lane that has too many messages waiting, the oldest go."""
        if frame.what is What.REFUSED:
            if self._refusals >= _MOST_REFUSALS:
                return
            self._refusals += 1
        elif frame.what is What.MESSAGE:
            self._messages[frame.lane] += 1
            self._message_bytes += len(frame.content)
            qos = self._lanes[frame.lane].qos
            depth = qos.depth if qos is not None else 1
            while self._messages[frame.lane] > depth or self._message_bytes > _MESSAGE_BYTES:
                if not self._drop_oldest(frame.lane):
                    break
        if frame.what in _OF_CALLS:
            self._frames[frame.call] = frame
        else:
            self._others -= 1
            self._frames[self._others] = frame

    def forget(self, call: int) -> None:
        """A call is over: its request or its answer waits no more, which nobody holds a place in the budget for."""
        self._frames.pop(call, None)

    def _drop_oldest(self, lane: int) -> bool:
        """Whether a message of that lane waited."""
        for at, frame in self._frames.items():
            if frame.what is What.MESSAGE and frame.lane == lane:
                del self._frames[at]
                self._forget(frame)
                return True
        return False

    def flush(self, channel: SendingChannel) -> None:
        """Send while the channel takes frames."""
        frames = self._frames
        while frames and not channel.congested:
            batch: list[Message] = []
            size = 0
            while frames and len(batch) < _BATCH and size < channel.batch_bytes:
                _, frame = frames.popitem(last=False)
                if self._goes(frame):
                    batch.append(self._pack(frame))
                    size += len(batch[-1][0])
            if batch:
                channel.send(batch)

    def clear(self) -> None:
        """Remove all frames."""
        self._frames.clear()
        self._refusals = self._message_bytes = 0
        self._messages.clear()

    def _goes(self, frame: CallFrame) -> bool:
        if frame.what in _OF_CALLS:
            return self._leaves(frame)
        self._forget(frame)
        return True

    def _forget(self, frame: CallFrame) -> None:
        """A refusal or a message waits no more."""
        if frame.what is What.REFUSED:
            self._refusals -= 1
        else:
            self._messages[frame.lane] -= 1
            self._message_bytes -= len(frame.content)

    def _pack(self, frame: CallFrame) -> Message:
        """A frame as it is sent: its content is compressed, where that is agreed and makes it smaller."""
        stamp, flags = frame.stamp or self._stamp(), 0
        if self._compressor is not None:
            smaller = self._compressor.compress(frame.content)
            if len(smaller) < len(frame.content):
                frame, flags = frame._replace(content=smaller), ZSTD
        packed = frame.pack()
        if frame.lease:
            packed, flags = with_number(frame.lease, packed), flags | LEASED
        return packed, stamp, flags


_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s."""
_HEALED_AFTER = 60.0
"""s without a failure after which the delays begin anew."""
_NO_LEDGER = Ledger()
_SAID_AGAIN_AFTER = 60.0
"""s."""
_MOST_SAID = 32


class RosRetry:
    """Refusals of ROS to make the servers or clients of one half, and when they are tried again.

    Whoever makes endpoints asks first whether to wait.

    Args:
        context: has the clock and the timers.
        try_again: called when a delay is over.

    Attributes:
        trouble: the last failure, until an attempt succeeds; None: there was none.
    """

    def __init__(self, context: Context, try_again: Callable[[], None]) -> None:
        self.trouble: Trouble | None = None
        self._context = context
        self._try_again = try_again
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._failed_at = float("-inf")
        self._about: object = None
        self._timer: asyncio.TimerHandle | None = None

    def waits(self, about: object) -> bool:
        """Whether the same has failed so lately that it is not tried again yet.

        Args:
            about: what the endpoints are made of; if that has changed, they are tried at once.
        """
        return self._timer is not None and about == self._about

    def failed(self, text: str, about: object) -> None:
        """An attempt has failed, or what it made; `text` says why."""
        now = self._context.now()
        if now - self._failed_at >= _HEALED_AFTER:
            self._backoff.reset()
        self._failed_at, self._about = now, about
        self.trouble = Trouble(Cause.OFFER_FAILED, f"{text}; it is tried again by itself")
        self.close()
        self._timer = self._context.loop.call_later(self._backoff.next(), self._due)

    def clear(self) -> None:
        """Nothing fails: all endpoints are there, or none is wanted."""
        self.trouble = None
        self.close()

    def close(self) -> None:
        """Try no more by itself."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._try_again()


class CallsRoute(Route):
    """A half of a service's, an action's or a node's parameters' route.

    Attributes:
        lanes: what it consists of.
        calls: what became of its calls, as this side counts them.
    """

    peer_report = CallsReport
    duplex: ClassVar[bool] = True
    channel: DuplexChannel | None

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.lanes = LANES[spec.kind]
        self.calls = CallsLedger()
        self._outbox = CallsOutbox(self.transport, proposal, self.lanes, self._leaves, self._stamp_now)
        self._unpacker = Unpacker(peer.budget.expansion, context)
        self._checks = [MessageCheck(context, peer.budget.checks) for _ in self.lanes]
        self._types: tuple[str, ...] = ()  # by lane, as last known
        self._loaded: tuple[str, ...] = ()  # by lane, of those of which it was tried
        self._loading: tuple[str, ...] = ()
        self._later: deque[Message] = deque()
        self._report: CallsReport | None = None  # the peer's, of the present opening
        self._told_report: CallsReport | None = None
        self._came = False  # a call, in the present opening
        self._failing_since: float | None = None
        self._unavailable: Trouble | None = None
        self._warning: Trouble | None = None
        self._failures = RosRetry(context, self._again_if_open)
        self._said: dict[str, float] = {}

    def _stamp_now(self) -> int:
        return shifted(self.context.wall_ns(), self.peer.stamp_shift)

    # --- what the halves do differently

    def _leaves(self, frame: CallFrame) -> bool:
        """A call or an answer is about to be sent: whether it still should be."""
        raise NotImplementedError

    def _take(self, frame: CallFrame) -> None:
        """A frame came that has one of the route's lanes.

        Raises:
            ProtocolError: the peer must not send it.
        """
        raise NotImplementedError

    def set_check(self) -> None:
        """Take over `check_messages` of the session."""
        for check in self._checks:
            check.set()

    def _take_unreadable(self, frame: CallFrame) -> None:
        """As `_take`, of a frame whose content grows too much when it is unpacked."""
        raise NotImplementedError

    def _give_up_all(self, why: str) -> None:
        """The calls that are under way will have no answer any more: they are lost, for a reason in words."""
        raise NotImplementedError

    def _withdraw(self) -> None:
        """Have no endpoints in ROS any more."""
        raise NotImplementedError

    @property
    def offered(self) -> bool:
        """Whether callers can call it, as far as this half knows."""
        raise NotImplementedError

    @property
    def provider_nodes(self) -> tuple[str, ...]:
        """The nodes that answer."""
        raise NotImplementedError

    @property
    def caller_nodes(self) -> tuple[str, ...]:
        """The nodes that call."""
        raise NotImplementedError

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Have an operator's call answered: over the link on the callers' side, by the node itself on the other one.

        Args:
            lane: its place among the route's lanes.
            request: serialized.

        Returns:
            The serialized response.

        Raises:
            CallError: there is none.
        """
        raise NotImplementedError

    def entry(self, lane: int) -> LaneEntry:
        """The type of what there is to call.

        Raises:
            CallError: there is nothing to call now.
        """
        raise NotImplementedError

    @property
    def call_timeout(self) -> float:
        """S after which a call is given up, as a rule."""
        return self.proposal.timeout or CALL_TIMEOUT

    def timeout_of(self, lane: int) -> float | None:
        """S after which a call of a lane is given up; None: never."""
        return None if self.lanes[lane].patient else self.call_timeout

    # --- opening and closing

    @property
    def local_names(self) -> list[str]:
        """What the lanes' services and topics are called on this side."""
        return [name_of(lane, self.local_topic) for lane in self.lanes]

    def _know_type(self, entries: Sequence[LaneEntry]) -> None:
        """Take the route's type from those of its lanes. Of an action and of parameters, there is no hash of it all."""
        self._types = tuple(entry.type for entry in entries)
        types = [route_type_of(lane, entry.type) for lane, entry in zip(self.lanes, entries, strict=True)]
        self.type_name = next(filter(None, types), "")
        self.type_hash = entries[0].type_hash if len(entries) == 1 else ""

    def _load(self, entries: Sequence[LaneEntry]) -> bool:
        """Return whether the types of lanes are loaded; if not, load them on another thread, and advance then.

        The first type that a process loads takes up to a second, as NumPy comes with it. In the loop that would end the
        lease of whatever is armed.
        """
        types = tuple(entry.type for entry in entries)
        if types not in {self._loaded, self._loading}:
            self._loading, ros = types, self.context.ros
            installed = [ros.installed_hash if lane.is_topic else ros.installed_service_hash for lane in self.lanes]
            loads = [partial(of, each) for of, each in zip(installed, types, strict=True) if each]
            future = self.context.loop.run_in_executor(None, lambda: [load() for load in loads])
            future.add_done_callback(lambda done: self._types_loaded(types, done))
        return types == self._loaded

    def _types_loaded(self, types: tuple[str, ...], done: asyncio.Future[Any]) -> None:
        if done.cancelled() or types != self._loading:
            return
        if (error := done.exception()) is not None and not isinstance(error, RosError):
            raise error
        self._loaded, self._loading = types, ()
        if self.id:
            self.advance()

    def held(self, lane: int) -> Refused | None:
        """Why a lane carries nothing, as operators want; None: it may. A cancel, above all, is never held up."""
        if not self.lanes[lane].limited:
            return None
        if self.paused:
            return Refused.PAUSED
        return None if self.arming.stands(self.context.now()) else Refused.DISARMED

    def unarmed_now(self, lane: int) -> Refused | None:
        """Return the reason why what has to be armed may not pass a lane now, or None if it may."""
        now = self.context.now()
        if not self.lanes[lane].limited or self.arming.passes(now):
            return None
        return Refused.UNHEARD if self.arming.stands(now) else Refused.DISARMED

    def held_now(self, lane: int) -> Refused | None:
        """Return the reason why a call of a lane may not pass now, or None if it may."""
        return self.held(lane) or self.unarmed_now(lane)

    def open(self, route_id: int) -> None:
        """Begin a new opening."""
        super().open(route_id)
        self._report = self._told_report = None
        self._came = False

    def close(self, reason: str) -> None:
        """End the opening; the calls that are under way are lost."""
        self._withdraw()
        self._give_up_all(reason)
        self._outbox.clear()
        self._later.clear()
        self._unavailable = self._warning = None
        self._failures.clear()
        super().close(reason)

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Nothing more may cross in this opening, be it under way."""
        self._withdraw()
        self._give_up_all("it was disarmed")
        self._outbox.clear()
        super().disarm(why, reason)

    def _may_flow(self) -> None:
        self.calls.forget_lately()
        self._failing_since = None

    def _again_if_open(self) -> None:
        if self.id:
            self.advance()

    def _ros_failed(self, text: str) -> None:
        """ROS refuses what this half needs: say so, and try again later, or once that changes."""
        self._failures.failed(text, self._made_of())
        self.notices.error(EventCode.ROUTE_OFFER_FAILED, text)
        self._verdict = None

    def _made_of(self) -> object:
        """What this half's endpoints in ROS depend on."""
        raise NotImplementedError

    # --- frames

    def deliver(self, messages: Iterable[Message]) -> None:
        """Take frames that arrived whole and authentic, or have them wait for later turns of the I/O loop."""
        if self._later:
            self._later.extend(messages)
            return
        self.losses.arrived()
        messages, opening = iter(messages), self.id
        try:
            for message in messages:
                if self.id != opening:
                    return  # what came before has ended the opening
                payload, stamp, flags = message
                lease = 0
                if flags & LEASED:
                    lease, payload = split_number(payload)
                frame = self._of_a_lane(unpack_call(payload)._replace(lease=lease))
                if self.age.is_on:
                    frame = frame._replace(stamp=stamp)
                if not flags & ZSTD:
                    self._take(frame)
                elif self._unpacker.begin((frame.content, stamp, flags)):
                    self._take_packed(frame)
                else:
                    self._later.extend((message, *messages))
                    self.peer.budget.expansion.wait(self._go_on)
        except (ProtocolError, zstandard.ZstdError) as error:
            self.request_reopen(EventCode.ROUTE_CALLS_BROKEN, f"the peer broke the format: {error}", Level.ERROR)
        self.flush()

    def _go_on(self) -> None:
        later, self._later = self._later, deque()
        self.deliver(later)

    def _of_a_lane(self, frame: CallFrame) -> CallFrame:
        if frame.lane >= len(self.lanes) or self.lanes[frame.lane].is_topic != (frame.what is What.MESSAGE):
            raise ProtocolError(f"a frame of kind {frame.what.name} on lane {frame.lane}")
        return frame

    def _take_packed(self, frame: CallFrame) -> None:
        try:
            content = self._unpacker.unpack(frame.content)
        except ExpandsTooMuchError as error:
            self.notices.message_error(EventCode.ROUTE_EXPANDS_TOO_MUCH, str(error))
            self._take_unreadable(frame)
        else:
            self._take(frame._replace(content=content))

    def _malformed(self, frame: CallFrame, part: str) -> Refused | None:
        """Return the reason why ROS may not get a frame's content, or None if it may.

        Args:
            frame: that came.
            part: the suffix of the lane's type: ``_Request``, ``_Response`` or nothing.
        """
        if not self.context.session.check_messages or frame.lane >= len(self._types):
            return None
        type_name, check = self._types[frame.lane] + part, self._checks[frame.lane]
        if check.type_name != type_name:
            check.begin(type_name)
        try:
            check.check(frame.content)
        except MalformedError as error:
            self._failed(malformed_text(type_name, self.peer.name, error), EventCode.ROUTE_MALFORMED)
            return Refused.MALFORMED
        except TooComplexError as error:
            self._failed(str(error), EventCode.ROUTE_TOO_COMPLEX)
            return Refused.TOO_COMPLEX
        return None

    def unexpected(self, frame: CallFrame) -> NoReturn:
        """A frame came that only the other side may send.

        Raises:
            ProtocolError: always.
        """
        raise ProtocolError(f"a frame of kind {frame.what.name} from the wrong side")

    def _send(self, frame: CallFrame) -> None:
        """Send a frame, or have it wait until the channel takes it; see `flush`."""
        self._outbox.put(frame)

    def flush(self) -> None:
        """Send what waits while the path takes it."""
        if self.channel is not None and self.channel.ready:
            self._outbox.flush(self.channel)

    # --- what becomes of calls

    def _refuse(self, why: Refused) -> None:
        """Count a call that has no answer because either side will not carry it, and say so once."""
        if why is Refused.LOST:
            self.calls.lost += 1
        else:
            self.calls.refused[why] += 1
        self._failed(f"a call was refused: {REMEDIES[why]}" if why is not Refused.LOST else REMEDIES[why])

    def _lose(self, calls: int, why: str) -> None:
        """Count calls whose answers will not come, as what carried them is gone. The log has that already."""
        if calls:
            self.calls.lost += calls
            self.calls.last_failure = f"given up while it was under way: {why}"

    def _failed(self, text: str, code: EventCode = EventCode.ROUTE_CALL_FAILED) -> None:
        """Note why a call had no answer. The log says the same of a route once a minute at most."""
        self.calls.last_failure = self.notices.last_error = text
        now = self.context.now()
        if now - self._said.get(text, float("-inf")) < _SAID_AGAIN_AFTER:
            return
        if len(self._said) >= _MOST_SAID:
            self._said.clear()
        self._said[text] = now
        self.log(Level.WARNING, code, text)

    def _asked_for(self, size: int) -> None:
        """Count a call, with a request of `size` bytes."""
        self.calls.asked += 1
        self._came = True
        self.meter.add(1, size, self.context.now())

    def _answered(self, size: int) -> None:
        """Count an answer of `size` bytes."""
        self.calls.answered += 1
        self.meter.add(0, size, self.context.now())
        self.notices.flowing()

    # --- time

    def tick(self) -> None:
        """Once a second."""
        if not self.offered:
            self.calls.forget_lately()
        self.calls.tick()
        fails = bool(self.calls.unanswered or self.calls.expired_lately() or self.calls.refused_lately())
        if not fails:
            self._failing_since = None
        elif self._failing_since is None:
            self._failing_since = self.context.now()
        super().tick()

    # --- what is made of it

    def reported(self, report: CallsReport) -> None:
        """The peer said what it counts, and what it makes of the route."""
        self._report = report
        self.judged.take(report.verdict, self.context.now())

    def news(self) -> CallsReport | None:
        """The report that the peer has not been sent yet; None: it knows everything."""
        verdict = self.verdict()
        report = self.calls.report(self.id, record_of(verdict), node_names(self.endpoints))
        report = msgspec.structs.replace(report, offered=self.offered)
        if report == self._told_report:
            return None
        self._told_report = report
        return msgspec.structs.replace(report, verdict=lasting(report.verdict, verdict, self.context.now()))

    def facts(self) -> CallsFacts:
        """What this half knows."""
        return CallsFacts(
            self.status()._replace(breaking=self.losses.repeated),
            unavailable=self._unavailable or self._failures.trouble,
            warning=self._warning,
            offered=self.offered,
            came=self._came,
            came_before=self.calls.asked > 0 and not self._came,
            expired=self.calls.expired_lately(),
            unanswered=self.calls.unanswered,
            refused=self.calls.refused_lately(),
            failing_since=self._failing_since,
            timeout=self.call_timeout,
            providers=" and ".join(self.provider_nodes),
        )

    def _judge(self) -> Verdict:
        return judge_calls(self.facts())

    def snapshot(self) -> RouteSnapshot:
        """The route as it is now."""
        return self.common_snapshot()(
            qos=None,
            publisher_qos=None,
            subscriber_qos=None,
            ledger=_NO_LEDGER,
            latency_p50=None,
            latency_p99=None,
            jitter=None,
            publishers=self.caller_nodes,
            subscribers=self.provider_nodes,
            calls=self.calls.snapshot(),
            lanes=tuple(lane.name for lane in self.lanes if not lane.is_topic),
        )


def frame_size(content: bytes) -> int:
    """Bytes that a call holds of the budget for its request or its response."""
    return CALL_HEADER_LENGTH + len(content)
