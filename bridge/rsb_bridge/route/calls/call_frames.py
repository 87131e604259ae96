"""The frames of one half of a route of calls: those that wait for its channel, and those that come from it."""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import TYPE_CHECKING, Protocol

import zstandard

from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.route.message_check import ExpandsTooMuchError, Unpacker
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

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.route.calls.calls_flow import CallsFlow

_FRAMES_AT_ONCE = 32
"""Frames of one batch. A round figure: long ones are bounded by `batch_bytes`."""
_OF_CALLS = (What.CALL, What.ANSWER)
APART = 0.05
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

_SPACED_BYTES = 16 << 20
"""Bytes that wait at most to be kept apart: more than `message_check.BACKLOG_LIMIT` end the opening. A round figure."""


class CallsOutbox:
    """Queues one half's frames, and sends them while the channel takes them.

    The budget of calls bounds the requests and answers that wait; messages and refusals are bounded here.

    Args:
        leaves: called with a call or an answer that is about to be sent; tells whether it is still wanted.

    Attributes:
        largest: bytes of the largest content that crosses.
    """

    def __init__(self, flow: CallsFlow, leaves: Callable[[CallFrame], bool]) -> None:
        route = flow.route
        self.largest = min(CALL_LIMIT, route.transport.largest_message - CALL_HEADER_LENGTH - LEASE_HEADER_LENGTH)
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if route.proposal.compression == "zstd" else None
        self._flow, self._context, self._leaves = flow, route.context, leaves
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
        qos = self._flow.members[frame.lane].qos
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

    def flush(self) -> None:
        """Send while the channel takes frames."""
        channel = self._flow.carried.channel
        if channel is None or not channel.ready:
            return
        frames, context = self._frames, self._context
        while frames and not channel.congested:
            batch: list[Message] = []
            size, most = 0, channel.batch_bytes
            now = shifted(context.clock.time_ns(), context.stamps.shift)
            while frames and len(batch) < _FRAMES_AT_ONCE and size < most:
                _, frame = frames.popitem(last=False)
                if frame.what not in _OF_CALLS:
                    self._uncount(frame)
                elif not self._leaves(frame):
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
    """Keeps messages and answers apart that come at once after a gap, in half of the time that was between them.

    A node's clients keep ten messages of feedback and ten answers, and DDS overwrites older ones, acknowledged or not.
    Nothing tells what a client has taken. rclpy's ignore feedback once they have the result, so later frames wait for
    earlier ones.

    Args:
        slack: s that one may come earlier than its distance after one that was late.
    """

    def __init__(self, slack: float = APART) -> None:
        self._slack = slack
        self._stamp = 0  # ns, of the last one
        self._due = float("-inf")  # s, when that was due

    def wait(self, stamp: int, now: float, part: float = 0.5) -> float | None:
        """Return when one may be published (s), or None if that is now.

        Args:
            part: of the time between it and the last one, to be kept.
        """
        due = self._due + max(0.0, min(APART, (stamp - self._stamp) * part / 1e9))
        if due > now:
            return due
        # Timers are late by up to 1 ms, which must not add up.
        self._stamp, self._due = stamp, max(due, now - self._slack)
        return None


class TakesFrames(Protocol):
    """A taker of the frames that come."""

    def receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        """Handle a frame that came.

        Args:
            frame: with a lane of this route.
            readable: whether its content could be unpacked within the limit on expansion.

        Raises:
            ProtocolError: the other side must not send it.
        """


class TakesCalls(TakesFrames, Protocol):
    """A taker of frames about calls."""

    def due(self, frame: CallFrame) -> float | None:
        """Return when (s) an answer may be passed on that comes now, or None if that is now."""


class CallFrames:
    """Takes frames as they come: unpacks them, and keeps those apart that must not reach a node at once.

    Args:
        outbox: is flushed after a batch: its frames have answers, or have made room.
        calls: takes frames about calls.
        messages: takes messages of lanes that are topics.
    """

    def __init__(self, flow: CallsFlow, outbox: CallsOutbox, calls: TakesCalls, messages: TakesFrames) -> None:
        self._route = route = flow.route
        self._members, self._outbox, self._calls, self._messages = flow.members, outbox, calls, messages
        # Later frames wait behind one that is not unpacked yet.
        self._unpacker = Unpacker(route.peer.budget.expansion, route.context, self.deliver, route.request_reopen)
        self._spacing = Spacing()

    def deliver(self, messages: Iterable[Message]) -> None:
        """Handle frames that arrived whole and authentic, or queue them for later turns of the I/O loop."""
        route = self._route
        if route.idle:
            route.wake()
        # Frames keep their order, also behind one that is unpacked off the loop.
        if self._unpacker.holds:
            self._unpacker.wait(messages)
            return
        route.losses.arrived()
        messages, opening = tuple(messages), route.id
        try:
            for at, message in enumerate(messages):
                if route.id != opening:
                    return  # an earlier frame has ended the opening
                frame = self._frame_of(message)
                is_message = frame.what is What.MESSAGE
                due = None  # requests come at once: a cancel would wait behind them
                if is_message or (frame.what is What.ANSWER and self._members[frame.lane].patient):
                    due = self._spacing.wait(message[1], route.context.now())
                elif frame.what is What.ANSWER:
                    due = self._calls.due(frame)
                if due is not None and sum([len(each[0]) for each in messages[at:]]) < _SPACED_BYTES:
                    route.context.loop.call_at(due, self._unpacker.go_on)
                    self._unpacker.wait(messages[at:])
                    break
                if not message[2] & ZSTD:
                    (self._messages if is_message else self._calls).receive(frame)
                elif self._unpacker.begin((frame.content, *message[1:])):
                    self._take_packed(frame)
                else:
                    self._unpacker.wait(messages[at:])
                    break
        except (ProtocolError, zstandard.ZstdError) as error:
            route.request_reopen(EventCode.ROUTE_CALLS_BROKEN, f"the peer broke the format: {error}", Level.ERROR)
        self._outbox.flush()

    def clear(self) -> None:
        """Drop the frames that wait to be unpacked, as the opening has ended."""
        self._unpacker.clear()

    def _frame_of(self, message: Message) -> CallFrame:
        payload, stamp, flags = message
        lease = 0
        if flags & LEASED:
            lease, payload = split_number(payload)
        frame = unpack_call(payload)
        if frame.lane >= len(self._members) or self._members[frame.lane].is_topic != (frame.what is What.MESSAGE):
            raise ProtocolError(f"a frame of kind {frame.what.name} on lane {frame.lane}")
        # Where neither is used, a call is spared the copy.
        if lease or self._route.age.is_on:
            frame = frame._replace(lease=lease, stamp=stamp if self._route.age.is_on else 0)
        return frame

    def _take_packed(self, frame: CallFrame) -> None:
        take = self._messages if frame.what is What.MESSAGE else self._calls
        try:
            content = self._unpacker.unpack(frame.content)
        except ExpandsTooMuchError as error:
            self._route.notices.message_error(EventCode.ROUTE_EXPANDS_TOO_MUCH, str(error))
            take.receive(frame, readable=False)
        else:
            take.receive(frame._replace(content=content))


def from_wrong_side(frame: CallFrame) -> ProtocolError:
    """Return the error of a frame that only the other side may send."""
    return ProtocolError(f"a frame of kind {frame.what.name} from the wrong side")
