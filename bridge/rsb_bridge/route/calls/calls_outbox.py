"""Frames of a route of calls on their way to its channel: compressed, bounded and in order."""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.wire.framing import LEASED, ZSTD
from rsb_bridge.wire.headers import CALL_HEADER_LENGTH, LEASE_HEADER_LENGTH, CallFrame, What, with_number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.messages import Propose

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
