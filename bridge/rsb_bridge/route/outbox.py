"""A sending half's messages on their way to its channel: compressed, limited and queued."""

from __future__ import annotations

from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.channel.receipts import Pace
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.profiles import PLAIN
from rsb_bridge.model.qos import AUTO_SECONDS
from rsb_bridge.route.overload import WAITS, Overload
from rsb_bridge.route.send_queue import QueueLimits, SendQueue
from rsb_bridge.wire.framing import ZSTD, Message

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.model.profiles import LinkProfile
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.route.age import MessageAge
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import Propose

_AUTO_DEPTH = 10
_QUEUE_BYTES = 32 * 1024 * 1024
_SLOW_QUEUE_BYTES = 64 * 1024  # best effort on a slow transport: a second or two, later it would be stale
_BATCH = 16
_ZSTD_LEVEL = 3


class Outbox:
    """Every message passes through it; those that are dropped in it are in the ledger.

    Args:
        transport: what carries the route.
        proposal: what the two sides have agreed on.
        ledger: the route's.
        failed: told of a message that the transport does not carry.
        age: how old the messages may be when they are sent, or None for any age.
    """

    def __init__(
        self,
        transport: Transport,
        proposal: Propose,
        ledger: RouteLedger,
        failed: Callable[[EventCode, str], None],
        age: MessageAge | None = None,
    ) -> None:
        self._age = age
        self._transport = transport
        self._automatic = proposal.qos is None
        self._ledger = ledger
        self._failed = failed
        self._largest = transport.largest_message
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if proposal.compression == "zstd" else None
        self._queue = SendQueue()
        self._overload = Overload()

    def pack(self, payload: bytes, stamp: int, flags: int) -> Message:
        """A message as it is sent: compressed, where that is agreed and makes it smaller."""
        if self._compressor is not None:
            smaller = self._compressor.compress(payload)
            if len(smaller) < len(payload):
                return smaller, stamp, flags | ZSTD
        return payload, stamp, flags

    def pass_on(self, messages: Sequence[Message], size: int, channel: SendingChannel) -> bool:
        """Send messages, of `size` bytes together, that would only pass through the queue; False: they have to wait."""
        if self._queue or channel.congested or len(messages) > _BATCH or size > min(self._largest, channel.batch_bytes):
            return False
        if self._age is not None and self._age.is_on:
            messages = self._young(messages, self._age)
        if messages:
            self._ledger.sent(len(messages))
            channel.send(messages)
        return True

    def fitting(self, messages: Sequence[Message], size: int) -> Sequence[Message]:
        """Return the messages that the transport carries, and drop the others. All together have `size` bytes."""
        if size <= self._largest:
            return messages
        return [message for message in messages if self._fits(len(message[0]))]

    def add(self, messages: Sequence[Message], now: float, publisher: bytes, limits: QueueLimits) -> None:
        """Have messages of one publisher wait, at `now` (s), within the limits."""
        self._queue.add(messages, now, publisher)
        self._ledger.drop("queue full", self._queue.trim(limits, now, publisher))

    def flush(self, channel: SendingChannel) -> None:
        """Send while the channel takes messages."""
        queue = self._queue
        while queue and not channel.congested:
            batch: Sequence[Message] = queue.take(_BATCH, channel.batch_bytes)
            if self._age is not None and self._age.is_on:
                batch = self._young(batch, self._age)
            if batch:
                self._ledger.sent(len(batch))
                channel.send(batch)
        if not queue:
            self._overload.over()

    def _young(self, messages: Sequence[Message], age: MessageAge) -> Sequence[Message]:
        young = age.young(messages)
        self._ledger.expired += len(messages) - len(young)
        return young

    def __len__(self) -> int:
        return len(self._queue)

    def waits(self, now: float) -> float:
        """Return how long (s) the oldest message has waited at `now` (s), or 0 if none waits."""
        oldest = self._queue.oldest_since
        return 0.0 if oldest is None else now - oldest

    def clear(self) -> int:
        """Remove all messages; returns how many they were."""
        self._overload.over()
        return self._queue.clear()

    def limits(self, qos: Qos | None, depth: int, pace: Pace, now: float, profile: LinkProfile = PLAIN) -> QueueLimits:
        """Return the queue's limits at `now` (s). While the channel takes messages, the queue only passes them on.

        Args:
            qos: of the route, or None if it is unknown.
            depth: messages that the publisher of a latched topic keeps, or 0.
            pace: of the channel.
            now: s.
            profile: of the link.
        """
        self._overload.look(now, self._queue.oldest_since, len(self._queue), moves=pace is Pace.SLOW)
        best_effort = qos is not None and qos.reliability == "best_effort"
        size = _QUEUE_BYTES + self._largest
        if best_effort:
            size = profile.queue_bytes or (_SLOW_QUEUE_BYTES if self._transport.slow else size)
        if qos is None or qos.history == "keep_all" or pace is Pace.FREE:
            return QueueLimits(0, 0.0, size)
        automatic = self._automatic and not best_effort
        if automatic and self._overload.lasts and not qos.latched:
            return QueueLimits(1, WAITS, size)
        most = qos.depth or (profile.depth if best_effort else _AUTO_DEPTH)
        kept_for = AUTO_SECONDS if profile.patience is None else profile.patience
        return QueueLimits(max(depth, most), kept_for if automatic else 0.0, size)

    def _fits(self, size: int) -> bool:
        """Whether the transport carries a message of so many bytes; one that it does not is dropped."""
        if size <= self._largest:
            return True
        self._ledger.drop("too large", 1)
        name = self._transport.name
        text = f"a message of {size:,} bytes is more than {name} carries here ({self._largest:,}): use tcp"
        self._failed(EventCode.ROUTE_TOO_LARGE, text)
        return False
