"""The part that both halves of a route of calls share: `calling` is the callers' half, and `providing` the other one.

Such a route consists of members (`rsb_bridge.model.calls`): services, and topics that go from the providing side to the
callers'. The frames of all members (`rsb_bridge.wire.headers`) go over one channel, which sends both ways. A frame
names its member by a number, the *lane*.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import zstandard

from rsb_bridge.cdr.checker import MalformedError, TooComplexError
from rsb_bridge.model.calls import LANES, Refused
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import CALL_TIMEOUT
from rsb_bridge.model.snapshot import Ledger, Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.calls_ledger import CallFailures, CallsLedger
from rsb_bridge.route.calls.calls_verdict import OF_CALLS, MalformedCall, Trouble, calls_stages
from rsb_bridge.route.calls.lane_types import LaneTypes
from rsb_bridge.route.calls.ros_retry import RosRetry
from rsb_bridge.route.combined_verdict import lasting, node_names, record_of
from rsb_bridge.route.message_check import ExpandsTooMuchError, Unpacker, malformed_text
from rsb_bridge.route.route import Route
from rsb_bridge.route.sending import STANDS_STILL
from rsb_bridge.wire.framing import CALL_LIMIT, LEASED, ZSTD, Message
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
    from collections.abc import Iterable, Sequence

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.channel.data_stream import StreamDuplex
    from rsb_bridge.channel.scheduler import SendingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, Stage
    from rsb_bridge.ros.ros_interface import RosError
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.blocking_rules import Rules
    from rsb_bridge.route.calls.calls_verdict import CallsProgress
    from rsb_bridge.route.calls.pending_calls import PendingCalls
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import LaneEntry

_NO_LEDGER = Ledger()
_FRAMES_AT_ONCE = 32
"""Frames of one batch. A round figure: long ones are bounded by `batch_bytes`."""
_OF_CALLS = (What.CALL, What.ANSWER)
_APART = 0.05
"""s that messages are kept apart at most: a node that takes nothing for ten times as long loses some. At a load average
of 20, some of 50 were lost in 3 of 4 runs with 4 ms, and in one run of the whole suite with 20 ms."""
_ZSTD_LEVEL = 3
"""As of topics: 2.4 ns a byte of a map (bench/README.md)."""
_MOST_REFUSALS = 8192
"""Refusals that wait at most; a peer that calls and reads nothing makes more. A call with a dropped refusal expires. A
round figure, twice `peer.CallLimits.under_way`."""
_KEPT_STILL = 1000
"""Messages of a lane that wait at most on a link that stands still: a gap may be over soon. A slow link gets as many as
the lane's depth, the newest. A round figure."""
_MESSAGE_BYTES = 32 << 20
"""Bytes of messages that wait, over all lanes. A round figure."""


class CallsOutbox:
    """Queues one half's frames, and sends them while the channel takes them.

    The budget of calls bounds the requests and answers that wait; messages and refusals are bounded here.
    """

    def __init__(self, route: CallsRoute) -> None:
        self.largest = min(CALL_LIMIT, route.transport.largest_message - CALL_HEADER_LENGTH - LEASE_HEADER_LENGTH)
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if route.proposal.compression == "zstd" else None
        self._route = route
        self._frames: OrderedDict[int, CallFrame] = OrderedDict()  # by call number; other frames count down from -1
        self._others = 0
        self._refusals = 0
        self._messages: Counter[int] = Counter()  # waiting messages, by lane
        self._message_bytes = 0

    def put(self, frame: CallFrame, still: float = 0.0) -> None:
        """Queue a frame. If too many messages of its lane wait, drop the oldest.

        Args:
            still: s without a receipt on the link.
        """
        if frame.what in _OF_CALLS:
            self._frames[frame.call] = frame
            return
        if frame.what is What.REFUSED:
            if self._refusals >= _MOST_REFUSALS:
                return
            self._refusals += 1
        else:
            self._make_room(frame, still)
        self._others -= 1
        self._frames[self._others] = frame

    def _make_room(self, frame: CallFrame, still: float) -> None:
        qos = self._route.members[frame.lane].qos
        depth = qos.depth if qos is not None else 1
        if qos is not None and not qos.latched:
            # What a gap has left is not dropped once the link moves again.
            depth = max(depth, _KEPT_STILL if still > STANDS_STILL else self._messages[frame.lane])
        self._messages[frame.lane] += 1
        self._message_bytes += len(frame.content)
        while self._messages[frame.lane] > depth or self._message_bytes > _MESSAGE_BYTES:
            messages = (
                at for at, each in self._frames.items() if each.what is What.MESSAGE and each.lane == frame.lane
            )
            if (oldest := next(messages, None)) is None:
                break
            self._uncount(self._frames.pop(oldest))

    def forget(self, call: int) -> None:
        """Drop the request or answer of a call that is over: it holds no place in the budget any more."""
        self._frames.pop(call, None)

    def flush(self, channel: SendingChannel) -> None:
        """Send while the channel takes frames."""
        frames, context = self._frames, self._route.context
        while frames and not channel.congested:
            batch: list[Message] = []
            size, most = 0, channel.batch_bytes
            now = shifted(context.clock.time_ns(), context.stamps.shift)
            while frames and len(batch) < _FRAMES_AT_ONCE and size < most:
                _, frame = frames.popitem(last=False)
                if frame.what not in _OF_CALLS:
                    self._uncount(frame)
                elif not self._route.leaves(frame):
                    continue
                batch.append(self._pack(frame, now))
                size += len(batch[-1][0])
            if batch:
                channel.send(batch)
        if frames:
            channel.ask()

    def clear(self) -> None:
        """Remove all frames."""
        self._frames.clear()
        self._refusals = self._message_bytes = 0
        self._messages.clear()

    def _uncount(self, frame: CallFrame) -> None:
        """Take a refusal or a message off the counts of waiting ones."""
        if frame.what is What.REFUSED:
            self._refusals -= 1
        else:
            self._messages[frame.lane] -= 1
            self._message_bytes -= len(frame.content)

    def _pack(self, frame: CallFrame, now: int) -> Message:
        """Return a frame as a message; its content is compressed if that is agreed and makes it smaller."""
        stamp, flags = frame.stamp or now, 0
        if self._compressor is not None:
            smaller = self._compressor.compress(frame.content)
            if len(smaller) < len(frame.content):
                frame, flags = frame._replace(content=smaller), ZSTD
        packed = frame.pack()
        if frame.lease:
            packed, flags = with_number(frame.lease, packed), flags | LEASED
        return packed, stamp, flags


class Spacing:
    """Keeps messages and results apart that come at once after a gap, in half of the time that was between them.

    An action's clients keep ten messages of feedback, and DDS overwrites older ones, acknowledged or not. Nothing tells
    what a client has taken. rclpy's ignore feedback once they have the result, so later frames wait for earlier ones.
    """

    def __init__(self) -> None:
        self._stamp = 0  # ns, of the last message
        self._due = float("-inf")  # s, when that was due

    def wait(self, stamp: int, now: float) -> float | None:
        """Return when a message may be published (s), or None if that is now."""
        due = self._due + max(0.0, min(_APART, (stamp - self._stamp) / 2e9))
        if due > now:
            return due
        # Timers are late by up to 1 ms, which must not add up.
        self._stamp, self._due = stamp, max(due, now - _APART)
        return None


class CallsRoute(Route):
    """One half of the route of a service, an action or a node's parameters.

    It has more than 40 methods because what the halves do differently has a method here, too.

    Attributes:
        members: the services and topics that it consists of.
        types: their types.
        calls: counts of its calls on this side.
        failures: counts those without an answer, and tells operators why.
        warning: the trouble that does not keep calls from crossing, or None.
        came: whether a call came in the present opening.
    """

    peer_report = CallsReport
    rules: ClassVar[Rules[Any]] = OF_CALLS
    duplex: ClassVar[bool] = True
    channel: StreamDuplex | None
    came = False
    _pending: PendingCalls[Any]

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.members = LANES[spec.kind]
        self.calls = CallsLedger()
        self.failures = CallFailures(self, self.calls)
        self._outbox = CallsOutbox(self)
        self._unpacker = Unpacker(peer.budget.expansion, context, self.deliver, self.request_reopen)
        self._spacing = Spacing()
        self.types = LaneTypes(self, self.members)
        self._last_malformed: MalformedCall | None = None  # the last one in the present opening
        self._report: CallsReport | None = None  # the peer's, of the present opening
        self._last_report: CallsReport | None = None
        self._unavailable: Trouble | None = None
        self.warning: Trouble | None = None
        self._retry = RosRetry(self)

    # --- what the halves do differently

    def leaves(self, frame: CallFrame) -> bool:
        """Return whether a call or an answer, which is about to be sent, is still wanted."""
        raise NotImplementedError

    def _receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        """Handle a frame that came.

        Args:
            frame: with a lane of this route.
            readable: whether its content could be unpacked within the limit on expansion.

        Raises:
            ProtocolError: the peer must not send it.
        """
        raise NotImplementedError

    def _give_up_all(self, why: str) -> None:
        """Give up all pending calls, for a reason in words."""
        raise NotImplementedError

    def _withdraw(self) -> None:
        """Close all endpoints in ROS."""
        raise NotImplementedError

    def endpoint_failed(self, error: RosError) -> None:
        """Close all endpoints in ROS, as ROS refuses one, or one has failed and closed itself."""
        raise NotImplementedError

    def progress(self) -> CallsProgress:
        """Return how far calls get, as this half knows it."""
        raise NotImplementedError

    def at_node(self) -> tuple[int, int]:
        """Return the newest call that was given to DDS, with all before it, and how many calls wait for their node."""
        return (self._report.given, self._report.waiting) if self._report is not None else (0, 0)

    @property
    def offered(self) -> bool:
        """Whether callers can call it, as far as this half knows."""
        raise NotImplementedError

    def end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the nodes that call, and the nodes that answer."""
        raise NotImplementedError

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make an operator's call: over the link on the callers' side, to the node itself on the providing side.

        Args:
            lane: its place among the route's members.

        Returns:
            The serialized response.

        Raises:
            CallError: no response came.
        """
        raise NotImplementedError

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane that can be called.

        Raises:
            CallError: nothing can be called now.
        """
        raise NotImplementedError

    # --- types and limits

    @property
    def call_timeout(self) -> float:
        """Seconds after which a call expires, unless its lane has no timeout."""
        return self.proposal.timeout or CALL_TIMEOUT

    def timeout_of(self, lane: int) -> float | None:
        """Return the seconds after which a lane's call expires, or None if it never does."""
        # Not by `call_timeout`, which would be one more function for each call.
        return None if self.members[lane].patient else self.proposal.timeout or CALL_TIMEOUT

    def set_check(self) -> None:
        self.types.set_check()

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        return self.types.messages

    # --- opening and closing

    def away(self) -> None:
        super().away()
        self._pending.pause()

    def back(self) -> None:
        super().back()
        self._pending.go_on()

    def open(self, route_id: int) -> None:
        super().open(route_id)
        self._report = self._last_report = None
        self._last_malformed = None
        self.came = False

    def close(self, reason: str) -> None:
        """End the opening; pending calls are lost."""
        self._withdraw()
        self._give_up_all(reason)
        # After `_give_up_all`, which queues refusals: the next opening has other calls of the same numbers.
        self._outbox.clear()
        self._unpacker.clear()
        self._unavailable = self.warning = None
        self._retry.clear()
        super().close(reason)

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Let nothing more cross in this opening, not even the answers to pending calls."""
        self._withdraw()
        self._give_up_all("it was disarmed")
        self._outbox.clear()
        super().disarm(why, reason)

    def _may_flow(self) -> None:
        self.failures.forget()

    def _ros_failed(self, text: str, entries: Sequence[LaneEntry]) -> None:
        """Report that ROS refuses an endpoint for these lanes. They are tried again later, others at once."""
        self._retry.failed(text, entries)
        self.notices.error(EventCode.ROUTE_OFFER_FAILED, text)
        self.judge_again()

    # --- frames

    def deliver(self, messages: Iterable[Message]) -> None:
        """Handle frames that arrived whole and authentic, or queue them for later turns of the I/O loop."""
        if self.idle:
            self.wake()
        # Frames keep their order, also behind one that is unpacked off the loop.
        if self._unpacker.holds:
            self._unpacker.wait(messages)
            return
        self.losses.arrived()
        messages, opening = iter(messages), self.id
        try:
            for message in messages:
                if self.id != opening:
                    return  # an earlier frame has ended the opening
                frame = self._frame_of(message)
                # Not requests: a cancel would wait behind them.
                spaced = frame.what is What.MESSAGE or (frame.what is What.ANSWER and self.members[frame.lane].patient)
                if spaced and (due := self._spacing.wait(message[1], self.context.now())) is not None:
                    self.context.loop.call_at(due, self._unpacker.go_on)
                    self._unpacker.wait((message, *messages))
                elif not message[2] & ZSTD:
                    self._receive(frame)
                elif self._unpacker.begin((frame.content, *message[1:])):
                    self._take_packed(frame)
                else:
                    self._unpacker.wait((message, *messages))
        except (ProtocolError, zstandard.ZstdError) as error:
            self.request_reopen(EventCode.ROUTE_CALLS_BROKEN, f"the peer broke the format: {error}", Level.ERROR)
        self.flush()

    def _frame_of(self, message: Message) -> CallFrame:
        payload, stamp, flags = message
        lease = 0
        if flags & LEASED:
            lease, payload = split_number(payload)
        frame = unpack_call(payload)
        if frame.lane >= len(self.members) or self.members[frame.lane].is_topic != (frame.what is What.MESSAGE):
            raise ProtocolError(f"a frame of kind {frame.what.name} on lane {frame.lane}")
        # Where neither is used, a call is spared the copy.
        if lease or self.age.is_on:
            frame = frame._replace(lease=lease, stamp=stamp if self.age.is_on else 0)
        return frame

    def _take_packed(self, frame: CallFrame) -> None:
        try:
            content = self._unpacker.unpack(frame.content)
        except ExpandsTooMuchError as error:
            self.notices.message_error(EventCode.ROUTE_EXPANDS_TOO_MUCH, str(error))
            self._receive(frame, readable=False)
        else:
            self._receive(frame._replace(content=content))

    def _malformed(self, frame: CallFrame, part: str) -> Refused | None:
        """Return the reason why ROS may not get a frame's content, or None if it may.

        Args:
            part: the suffix of the lane's type: ``_Request``, ``_Response`` or nothing.
        """
        if (size := len(frame.content)) > CALL_LIMIT:
            text = f"{self.peer.name} sent {size:,} bytes of {self.types.names[frame.lane]}, more than {CALL_LIMIT:,}"
            self.failures.say(text, EventCode.ROUTE_TOO_LARGE)
            return Refused.TOO_LARGE
        try:
            self.types.check(frame.lane, part, frame.content)
        except MalformedError as error:
            type_name = self.types.names[frame.lane] + part
            self._last_malformed = MalformedCall(type_name, sanitize_text(str(error)))
            self.failures.say(malformed_text(type_name, self.peer.name, error), EventCode.ROUTE_MALFORMED)
            return Refused.MALFORMED
        except TooComplexError as error:
            self.failures.say(str(error), EventCode.ROUTE_TOO_COMPLEX)
            return Refused.TOO_COMPLEX
        return None

    def flush(self) -> None:
        if self.channel is not None and self.channel.ready:
            self._outbox.flush(self.channel)

    # --- counts

    def _asked_for(self, size: int) -> None:
        """Count a call with a request of `size` bytes."""
        if self.idle:
            self.wake()
        self.calls.asked += 1
        self.came = True
        self.meter.add(1, size, self.context.now())

    def _answered(self, size: int) -> None:
        """Count an answer of `size` bytes."""
        self.calls.answered += 1
        self.meter.add(0, size, self.context.now())
        self.notices.flowing()

    @property
    def _passed(self) -> int:
        calls = self.calls
        return calls.asked + calls.answered + calls.expired + calls.refused.total() + calls.lost + calls.late

    def _signs(self) -> Signs:
        return (
            *super()._signs(), self._report, self.unavailable(), self.warning, self.offered, self.last_malformed(),
            self.end_nodes(),
        )  # fmt: skip

    def tick(self) -> None:
        if not self.offered:
            self.calls.forget_lately()
        self.calls.tick()
        self.failures.tick()
        super().tick()

    # --- verdict and snapshot

    def reported(self, report: CallsReport) -> None:
        """Take the peer's verdict, and how far its calls are."""
        found = _malformed_in(report)
        if found is not None and found != _malformed_in(self._report):
            text = f"malformed {found.type_name} to {self.peer.name}: {found.field}: see the node here that sent it"
            self.failures.say(text, EventCode.ROUTE_MALFORMED)
        self._report = report
        self.wake()
        self.judged.receive(report.verdict, self.context.now())

    def news(self) -> CallsReport | None:
        verdict = self.verdict()
        given, waiting = (0, 0) if self.outgoing else self.at_node()
        report = CallsReport(
            route=self.id,
            given=given,
            waiting=waiting,
            malformed_type="" if self._last_malformed is None else self._last_malformed.type_name,
            malformed="" if self._last_malformed is None else self._last_malformed.field,
            offered=self.offered,
            verdict=record_of(verdict),
            nodes=node_names(self.endpoints),
        )
        # Without the verdict's duration, which is another one each second.
        if report == self._last_report:
            return None
        self._last_report = report
        return msgspec.structs.replace(report, verdict=lasting(report.verdict, verdict, self.context.now()))

    @property
    def owing(self) -> bool:
        return self.calls.in_flight > 0

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called, or None if this side knows of none."""
        return self._unavailable or self._retry.trouble

    def last_malformed(self) -> MalformedCall | None:
        """Return the last malformed request or response, or None."""
        return self._last_malformed or _malformed_in(self._report)

    @property
    def waited(self) -> bool:
        """Whether calls expired lately that their node never got, because it had not read earlier ones."""
        return self.judged.peer.cause == Cause.CALLS_WAIT if self.outgoing else self.calls.waited_lately()

    def stages(self) -> tuple[Stage, ...]:
        return calls_stages(self, self.progress())

    @property
    def came_before(self) -> bool:
        return self.calls.asked > 0 and not self.came

    def snapshot(self) -> RouteSnapshot:
        callers, providers = self.end_nodes()
        return self.common_snapshot()(
            qos=None,
            publisher_qos=None,
            subscriber_qos=None,
            ledger=_NO_LEDGER,
            latency_p50=None,
            latency_p99=None,
            jitter=None,
            publishers=callers,
            subscribers=providers,
            calls=self.calls.snapshot(self.at_node()[1]),
            lanes=tuple(member.name for member in self.members if not member.is_topic),
        )


def from_wrong_side(frame: CallFrame) -> ProtocolError:
    """Return the error of a frame that only the other side may send."""
    return ProtocolError(f"a frame of kind {frame.what.name} from the wrong side")


def _malformed_in(report: CallsReport | None) -> MalformedCall | None:
    return MalformedCall(report.malformed_type, report.malformed) if report is not None and report.malformed else None
