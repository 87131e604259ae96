"""The frames of one route of calls that wait for its channel."""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.wire.framing import LEASED, ZSTD, Message
from rsb_bridge.wire.headers import CALL_HEADER_LENGTH, LEASE_HEADER_LENGTH, CallFrame, What, with_number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.model.calls import ServiceMember
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import Propose

_BATCH = 32
"""Frames of one batch. A round figure: long ones are bounded by `batch_bytes`."""
_OF_CALLS = (What.CALL, What.AGAIN, What.ANSWER)
_ZSTD_LEVEL = 3
"""As of topics: 2.4 ns a byte of a map (bench/README.md)."""
_MOST_REFUSALS = 8192
"""Refusals that wait at most; a peer that calls and reads nothing makes more. A call with a dropped refusal expires."""
_MESSAGE_BYTES = 32 << 20
"""Bytes of messages that wait, over all lanes."""


class CallsOutbox:
    """Queues one half's frames, and sends them while the channel takes them.

    The budget of calls bounds the requests and answers that wait; messages and refusals are bounded here.

    Args:
        proposal: what the two sides have agreed on.
        leaves: whether a call or an answer is still wanted; asked right before it is sent.
        stamp: gives the stamp of frames that have none.
    """

    def __init__(
        self,
        transport: Transport,
        proposal: Propose,
        members: Sequence[ServiceMember],
        leaves: Callable[[CallFrame], bool],
        stamp: Callable[[], int],
    ) -> None:
        self.largest = transport.largest_message - CALL_HEADER_LENGTH - LEASE_HEADER_LENGTH
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if proposal.compression == "zstd" else None
        self._members = members
        self._leaves = leaves
        self._stamp = stamp
        self._frames: OrderedDict[int, CallFrame] = OrderedDict()  # by call number; other frames count down from -1
        self._others = 0
        self._refusals = 0
        self._messages: Counter[int] = Counter()  # waiting messages, by lane
        self._message_bytes = 0

    def put(self, frame: CallFrame) -> None:
        """Queue a frame. If too many messages of its lane wait, drop the oldest."""
        if frame.what in _OF_CALLS:
            self._frames[frame.call] = frame
            return
        if frame.what is What.REFUSED:
            if self._refusals >= _MOST_REFUSALS:
                return
            self._refusals += 1
        else:
            self._make_room(frame)
        self._others -= 1
        self._frames[self._others] = frame

    def _make_room(self, frame: CallFrame) -> None:
        self._messages[frame.lane] += 1
        self._message_bytes += len(frame.content)
        qos = self._members[frame.lane].qos
        depth = qos.depth if qos is not None else 1
        while self._messages[frame.lane] > depth or self._message_bytes > _MESSAGE_BYTES:
            if not self._drop_oldest(frame.lane):
                break

    def _drop_oldest(self, lane: int) -> bool:
        """Drop the oldest message of a lane. Return False if none waits."""
        for at, frame in self._frames.items():
            if frame.what is What.MESSAGE and frame.lane == lane:
                del self._frames[at]
                self._uncount(frame)
                return True
        return False

    def forget(self, call: int) -> None:
        """Drop the request or answer of a call that is over: it holds no place in the budget any more."""
        self._frames.pop(call, None)

    def flush(self, channel: SendingChannel) -> None:
        """Send while the channel takes frames."""
        frames = self._frames
        while frames and not channel.congested:
            batch: list[Message] = []
            size, most, now = 0, channel.batch_bytes, self._stamp()
            while frames and len(batch) < _BATCH and size < most:
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
