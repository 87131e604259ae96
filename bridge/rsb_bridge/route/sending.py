"""The sender of a route: messages from ROS are throttled, packed and queued until the channel takes them."""

from __future__ import annotations

from collections import Counter, deque
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple, Protocol

import zstandard

from rsb_bridge.channel.receipts import Pace, pace_of
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.profiles import PLAIN
from rsb_bridge.model.qos import AUTO_SECONDS
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.peeking import Peekable, peeked
from rsb_bridge.route.thinning import THINNED, LatestLater, Thinning, Throttle
from rsb_bridge.wire.framing import HISTORY, ZSTD, Message

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.profiles import LinkProfile
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.age import MessageAge
    from rsb_bridge.route.arming import Arming
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.notices import Notices
    from rsb_bridge.route.peeking import PeekSlot
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import Propose

_LOOKS_EVERY = 1.0
WAITS = 1.0
"""s that an overloaded topic's queue keeps a message, unless it is the only one."""
_AUTO_DEPTH = 10
_QUEUE_BYTES = 32 * 1024 * 1024
_SLOW_QUEUE_BYTES = 64 * 1024  # best effort on a slow transport: a second or two, later it would be stale
_BATCH = 16
_ZSTD_LEVEL = 3


class QueueLimits(NamedTuple):
    """How much may wait. What is more is dropped, the oldest first; one message always may.

    Attributes:
        depth: messages of one publisher (of all, where publishers are not told apart); 0: any number.
        younger_than: s; younger messages may wait even beyond the depth.
        size: bytes.
    """

    depth: int
    younger_than: float
    size: int


class SendQueue:
    """A first-in, first-out queue that is bounded in messages and bytes. Every message passes through it."""

    def __init__(self) -> None:
        self._queue: deque[tuple[Message, bytes, float]] = deque()  # message, publisher, since when (s)
        self._size = 0
        self._counts: Counter[bytes] = Counter()  # of the publishers that are told apart

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def oldest_since(self) -> float | None:
        """When (s) the oldest message was added, or None if the queue is empty."""
        return self._queue[0][2] if self._queue else None

    def add(self, messages: Sequence[Message], now: float, publisher: bytes = b"") -> None:
        """Append messages of one publisher, at `now` (s)."""
        self._queue.extend([(message, publisher, now) for message in messages])
        self._size += sum([len(message[0]) for message in messages])
        if publisher:
            self._counts[publisher] += len(messages)

    def trim(self, limits: QueueLimits, now: float, publisher: bytes = b"") -> int:
        """Drop what is beyond the limits after messages of a publisher were added.

        Returns:
            How many messages were dropped.
        """
        before = len(self._queue)
        if limits.depth:
            while self._count(publisher) > limits.depth:
                index = self._oldest_of(publisher)
                if now - self._queue[index][2] < limits.younger_than:
                    break
                self._forget(*self._queue[index])
                del self._queue[index]
        while self._size > limits.size and len(self._queue) > 1:
            self._forget(*self._queue.popleft())
        return before - len(self._queue)

    def take(self, most: int, size: int) -> list[Message]:
        """Remove the oldest messages: at most `most`, and no further one once they have `size` bytes."""
        queue = self._queue
        taken: list[Message] = []
        taken_size = 0
        while queue and len(taken) < most and taken_size < size:
            message, publisher, _ = queue.popleft()
            taken.append(message)
            taken_size += len(message[0])
            if publisher:
                self._uncount(publisher)
        self._size -= taken_size
        return taken

    def clear(self) -> int:
        """Remove all messages; returns how many they were."""
        count = len(self._queue)
        self._queue.clear()
        self._size = 0
        self._counts.clear()
        return count

    def _count(self, publisher: bytes) -> int:
        return self._counts[publisher] if publisher else len(self._queue)

    def _oldest_of(self, publisher: bytes) -> int:
        if not publisher:
            return 0
        return next(index for index, waiting in enumerate(self._queue) if waiting[1] == publisher)

    def _forget(self, message: Message, publisher: bytes, _: float) -> None:
        self._size -= len(message[0])
        if publisher:
            self._uncount(publisher)

    def _uncount(self, publisher: bytes) -> None:
        self._counts[publisher] -= 1
        if not self._counts[publisher]:
            del self._counts[publisher]


class Overload:
    """A steady overload of one topic, as distinguished from a link that stalls for a moment.

    With ``qos: auto`` a reliable topic keeps messages for some seconds, so that a link that stalls loses none. In a
    steady overload the link delivers, and yet the queue gets longer and older. Then every message would arrive late, so
    the queue keeps only new ones.

    Attributes:
        lasts: whether more is published than the channel delivers.
    """

    def __init__(self) -> None:
        self.lasts = False
        self._before: tuple[float, float, int] | None = None  # when (s), the oldest message's age (s), the length

    def look(self, now: float, oldest_since: float | None, length: int, *, moves: bool) -> None:
        """Judge the queue. Called whenever a message is queued.

        Args:
            now: s.
            oldest_since: when (s) the oldest message was queued, or None if the queue is empty.
            length: messages in the queue.
            moves: whether the channel delivers.
        """
        if oldest_since is None:
            self.lasts, self._before = False, None
            return
        age = now - oldest_since
        if not moves:
            self._before = None
        elif self._before is None:
            self._before = (now, age, length)
        elif now - self._before[0] >= _LOOKS_EVERY:
            _, age_before, length_before = self._before
            self.lasts = self.lasts or (age >= WAITS and age >= age_before and length >= length_before)
            self._before = (now, age, length)

    def over(self) -> None:
        """End the overload: the queue is empty."""
        self.lasts, self._before = False, None


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


_SHARED_ANEW = 1.0
"""s after which the link's shares may have changed, and with them how long a message is held back."""


class SendingRoute(Peekable, Protocol):
    """Whose messages they are.

    Attributes:
        transport: what carries them.
        proposal: what the two sides have agreed on.
        channel: the way to the peer; None: there is none now.
        qos: of the topic; None: not known yet.
        notices: what an operator is told.
        peek_slot: takes the next message for whoever looks at the topic.
        thinning: what it leaves to others of the link.
        arming: says whether its messages have to carry a number of the lease.
        age: how old its messages may be.
    """

    transport: Transport
    proposal: Propose
    channel: SendingChannel | None
    qos: Qos | None
    notices: Notices
    peek_slot: PeekSlot
    thinning: Thinning
    age: MessageAge
    arming: Arming

    @property
    def peer(self) -> Peer:
        """The other side."""
        ...

    @property
    def paused(self) -> bool:
        """Whether it carries no messages, as an operator wants."""
        ...

    @property
    def connected(self) -> bool:
        """Whether there is a way for messages."""
        ...

    def count(self, messages: int, size: int) -> None:
        """Note that messages pass."""
        ...


class Sending:
    """Counts in the ledger what it leaves out and what it drops.

    Args:
        context: what every part of the engine shares.
        route: whose messages they are.
        ledger: the route's.
        loop_filter: the route's; gives each publisher's messages the number of their source.
    """

    def __init__(self, context: Context, route: SendingRoute, ledger: RouteLedger, loop_filter: LoopFilter) -> None:
        self._context = context
        self._route = route
        self._ledger = ledger
        self._loop_filter = loop_filter
        self._max_rate = route.proposal.max_rate
        self._throttle = Throttle(self._max_rate)
        self._latest_later = LatestLater(context.loop, self._throttle, self._send_latched, lambda: route.paused)
        self._later: asyncio.TimerHandle | None = None
        self._outbox = Outbox(route.transport, route.proposal, ledger, route.notices.message_error, route.age)

    def limit(self, max_rate: float) -> None:
        """Let so many Hz pass from now on; 0: all."""
        if max_rate != self._max_rate:
            self._max_rate = max_rate
            self._throttle.limit(max_rate)

    def resume(self) -> None:
        """Let pass what has become due while the route was paused."""
        self._latest_later.resume()

    def clear_later(self) -> int:
        """Let none of the latched messages pass that wait for the limit; how many they were."""
        return self._latest_later.clear()

    def clear(self) -> int:
        """Remove what is queued; how many messages that was."""
        if self._later is not None:
            self._later.cancel()
            self._later = None
        self._route.thinning.busy(False, self._context.now())
        return self._outbox.clear()

    def waits(self, now: float) -> float:
        """Return how long (s) messages have waited for the channel at `now` (s); messages held back do not count."""
        return 0.0 if self._route.thinning.holds else self._outbox.waits(now)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        """Take messages from ROS, oldest first."""
        if self._route.peek_slot.wanted:
            self._show(batch[-1])
        self._ledger.offered += len(batch)
        passes, pack, flags = self._throttle.passes, self._outbox.pack, self._loop_filter.table.flags
        passed = [each for each in batch if passes(each.stamp)]
        self._ledger.throttled += len(batch) - len(passed)
        kept = self._route.thinning.keep(passed, self._context.now())
        self._ledger.drop(THINNED, len(passed) - len(kept))
        messages = [pack(each.payload, each.stamp, flags[each.gid]) for each in kept]
        if (arming := self._route.arming).required:
            messages = [arming.pack(message, each.lease) for message, each in zip(messages, kept, strict=True)]
        self._send(messages)

    def offer_latched(self, new: int, samples: Sequence[Sample]) -> None:
        """Take messages of a latched topic."""
        if self._route.peek_slot.wanted and samples:
            self._show(samples[-1].message)
        self._ledger.offered += new
        admitted, left_out = self._latest_later.admit(samples)
        self._ledger.throttled += left_out
        self._route.thinning.latched(len(admitted))
        self._send_latched(admitted)

    def _show(self, message: RawMessage) -> None:
        shifted = self._route.age.is_on or self._route.peer.stamp_shift
        time_ns = message.stamp - self._context.stamps.shift if shifted else message.stamp
        self._route.peek_slot.put(peeked(self._route, message.payload, time_ns), self._context.now())

    def _send_latched(self, samples: Sequence[Sample]) -> None:
        for publisher, group in groupby(samples, key=lambda sample: sample.header.publisher):
            messages, depth = [], 0
            for header, (payload, stamp, gid, *_), replayed in group:
                depth = header.depth
                if not self._route.age.is_young(stamp):
                    self._route.age.expired(Cause.PUBLISHER_STAMPS_OLD if replayed else Cause.LINK_SLOW, 1)
                    self._ledger.expired += 1
                    continue
                flags = self._loop_filter.table.flags.get(gid)
                if flags is None:  # it has turned out, while the message waited, that it would go in a loop
                    self._ledger.drop("would loop", 1)
                    continue
                content, _, flags = self._outbox.pack(payload, stamp, flags)
                messages.append((header.pack() + content, stamp, flags | HISTORY))
            self._send(messages, publisher, depth)

    def _send(self, messages: Sequence[Message], publisher: bytes = b"", depth: int = 0) -> None:
        """Send messages, or have them wait; of a latched topic, those of one publisher that keeps `depth` of them."""
        if not self._route.connected:
            self._ledger.drop("link lost", len(messages))
            return
        channel, thinning = self._route.channel, self._route.thinning
        if messages and channel is not None:
            size = sum([len(message[0]) for message in messages])
            self._route.count(len(messages), size)
            fitting = self._outbox.fitting(messages, size)
            if len(fitting) < len(messages):
                thinning.left_out(len(messages) - len(fitting))
                messages, size = fitting, sum([len(message[0]) for message in fitting])
            if not messages:
                return
            thinning.packed(len(messages), size)
            holds, now = thinning.holds, self._context.now()
            if not holds and self._outbox.pass_on(messages, size, channel):
                thinning.busy(channel.congested, now)
                return
            pace, profile = Pace.STOPPED if holds else pace_of(channel), self._route.peer.profile
            limits = self._outbox.limits(self._route.qos, depth, pace, now, profile)
            self._outbox.add(messages, now, publisher, limits)
            self.flush()

    def flush(self) -> None:
        """Send what waits while the path takes it."""
        channel, thinning = self._route.channel, self._route.thinning
        if channel is None:
            return
        now = self._context.now()
        self._outbox.flush(thinning.over(channel, now))
        held = thinning.wait(now)
        thinning.busy(channel.congested or (not held and bool(self._outbox)), now)
        if held and self._outbox and self._later is None:
            self._later = self._context.loop.call_later(min(held, _SHARED_ANEW), self._flush_later)

    def _flush_later(self) -> None:
        self._later = None
        self.flush()
