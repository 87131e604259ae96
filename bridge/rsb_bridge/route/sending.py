"""The path of outgoing messages: from ROS, through limits and the queue, to the channel (`OutgoingPath`)."""

from __future__ import annotations

import math
from collections import Counter, deque
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import zstandard

from rsb_bridge.model.by_hand import END_NONE
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import AUTO_DEPTH, AUTO_SECONDS, QUEUE_BYTES
from rsb_bridge.route.beat import Beats
from rsb_bridge.route.gates import NO_SAMPLE, chained, compose_when_switched, sending_gates, sifting
from rsb_bridge.route.ledger import CAUSES, KEEP_FULL, OUTAGE, REPLACED
from rsb_bridge.route.peeking import peeked
from rsb_bridge.route.rate_limit import LastLater, LatestLater, Throttle
from rsb_bridge.route.route import promised_keep, route_weight
from rsb_bridge.telemetry.meters import Smoothed
from rsb_bridge.wire.framing import CONTENT_LIMIT, HISTORY, MESSAGE_LIMIT, ZSTD, Budget, Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.scheduler import SendingChannel
    from rsb_bridge.model.keep import Keep
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.catching_up import Backlog
    from rsb_bridge.route.gates import Sieve
    from rsb_bridge.route.history_depth import Histories, Sample
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.topic_flow import TopicFlow
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import Propose

# Of an overload. Where these were measured: bench/README.md, *Constants of a topic's queue*.
_LOOKS_EVERY = 1.0  # s at least between the two looks at a queue that it takes
STANDS_STILL = 0.3  # s without a receipt after which the link stands still
_WAITS = 1.0  # s that an overloaded topic's queue keeps a message, unless it is the only one
_FRESH = 0.1  # the same for a live topic whose turns are not enough: what waits ahead only makes each one late
_LASTS = 10.0  # s of overload after drops in spite of turns: longer than a tunnel of 2 kB/s keeps its window closed

_SLOW_QUEUE_BYTES = 64 * 1024  # best effort on a slow transport: a second or two, later it would be stale
_BATCH = 16
_ZSTD_LEVEL = 3  # packs a map to 0.14 of its size in 2.4 ns a byte (bench/README.md)
_PUBLISHER = attrgetter("header.publisher")

USE_TCP = "use protocol: tcp"
"""The remedy for messages that are lost on the way."""


class QueueLimits(NamedTuple):
    """The limits of a queue. Beyond them the oldest messages are dropped, but one message may always wait."""

    depth: int  # messages of one publisher, or 0 for any number
    younger_than: float  # s; younger messages may wait even beyond the depth
    size: int
    older_than: float = math.inf  # s; older messages do not wait even within the depth


class SendQueue:
    """A first-in, first-out queue that is bounded in messages and bytes.

    Args:
        held: counts the bytes in all queues of a link, also beyond its limit.

    Attributes:
        waiting: each message, its publisher, and when (s) it was added; oldest first.
        size: bytes of these.
    """

    def __init__(self, held: Budget) -> None:
        self.waiting: deque[tuple[Message, bytes, float]] = deque()
        self.size = 0
        self._held = held
        self._counts: Counter[bytes] | None = None
        """Messages of each publisher, from the first limit on them until the queue is empty: else nobody asks."""

    def __len__(self) -> int:
        return len(self.waiting)

    @property
    def oldest_since(self) -> float | None:
        """When (s) the oldest message was added, or None without any."""
        return self.waiting[0][2] if self.waiting else None

    @property
    def publishers(self) -> set[bytes]:
        return {publisher for _, publisher, _ in self.waiting}

    def charge(self, held: Budget) -> None:
        """Count its bytes in another budget from now on."""
        if held is not self._held:
            self._held.held -= self.size
            self._held = held
            held.held += self.size

    def room(self) -> int:
        """Return the bytes that it may have so that its budget is kept."""
        return max(0, self.size + self._held.limit - self._held.held)

    def add(self, messages: Sequence[Message], now: float, publisher: bytes) -> None:
        self.waiting.extend([(message, publisher, now) for message in messages])
        self._grow(sum([len(message[0]) for message in messages]))
        if self._counts is not None:
            self._counts[publisher] += len(messages)

    def trim(self, limits: QueueLimits, now: float, publisher: bytes) -> tuple[int, int]:
        """Drop what is beyond the limits after messages of a publisher were added.

        Returns:
            How many messages were dropped by number and age, and how many by size.
        """
        before = len(self.waiting)
        if limits.depth:
            if self._counts is None:
                self._counts = Counter([each[1] for each in self.waiting])
            while self._counts[publisher] > limits.depth:
                index = next(at for at, each in enumerate(self.waiting) if each[1] == publisher)
                if now - self.waiting[index][2] < limits.younger_than:
                    break
                self._forget(*self.waiting[index])
                del self.waiting[index]
        latest = now - limits.older_than
        # One message may always wait, however large or old, or it could never be sent.
        while len(self.waiting) > 1 and self.waiting[0][2] < latest:
            self._forget(*self.waiting.popleft())
        old = before - len(self.waiting)
        while len(self.waiting) > 1 and self.size > limits.size:
            self._forget(*self.waiting.popleft())
        return old, before - old - len(self.waiting)

    def take(self, most: int, size: int) -> list[Message]:
        """Remove the oldest messages: at most `most`, and no further one once they have `size` bytes."""
        queue = self.waiting
        taken: list[Message] = []
        taken_size = 0
        while queue and len(taken) < most and taken_size < size:
            message, publisher, _ = queue.popleft()
            taken.append(message)
            taken_size += len(message[0])
            if self._counts is not None:
                self._uncount(self._counts, publisher)
        self._grow(-taken_size)
        if not queue:
            self._counts = None
        return taken

    def clear(self) -> int:
        """Remove all messages; return how many they were."""
        count = len(self.waiting)
        self.waiting.clear()
        self._grow(-self.size)
        self._counts = None
        return count

    def _grow(self, size: int) -> None:
        self.size += size
        self._held.held += size

    def _forget(self, message: Message, publisher: bytes, _: float) -> None:
        self._grow(-len(message[0]))
        if self._counts is not None:
            self._uncount(self._counts, publisher)

    @staticmethod
    def _uncount(counts: Counter[bytes], publisher: bytes) -> None:
        counts[publisher] -= 1
        if not counts[publisher]:
            del counts[publisher]


class Overload:
    """A steady overload of one topic, as distinguished from a link that stalls for a moment.

    With ``qos: auto`` a reliable topic keeps messages for some seconds, so that a link that stalls loses none. In a
    steady overload the topic has its turns, and yet its queue gets longer and older, or drops messages again. Then
    every message would arrive late, so the queue keeps only new ones.
    """

    def __init__(self) -> None:
        self._grows = False
        self._turned = False  # since the last look
        self._before: tuple[float, float, int] | None = None  # when (s), the oldest message's age (s), the length
        self._turned_since_drop = False
        self._dropped_at = self._shown_at = -math.inf

    def lasts(self, now: float) -> bool:
        """Whether more is published than the channel delivers, at `now` (s)."""
        return self._grows or now - self._shown_at < _LASTS

    def turn(self) -> None:
        self._turned = self._turned_since_drop = True

    def dropped(self, now: float) -> None:
        if self._turned_since_drop and now - self._dropped_at < _LASTS:
            self._shown_at = now
        self._turned_since_drop, self._dropped_at = False, now

    def judge(self, now: float, oldest_since: float | None, length: int, still: float = 0.0) -> None:
        """Judge the queue. Called whenever a message is queued.

        Args:
            oldest_since: when (s) the oldest message was queued, or None if the queue is empty.
            still: s without a receipt on the link.
        """
        if oldest_since is None:
            self.reset()
            return
        age = now - oldest_since
        # A link that stands still says nothing about its speed. And a queue that is young now may have got old at one
        # stroke by the next look, while it stood still.
        if self._before is None or not self._turned or still > STANDS_STILL or age < _WAITS:
            self._before, self._turned = (now, age, length), False
        elif now - self._before[0] >= _LOOKS_EVERY:
            _, age_before, length_before = self._before
            self._grows = self._grows or (age >= age_before and length >= length_before)
            self._before, self._turned = (now, age, length), False

    def reset(self) -> None:
        """End the overload: the queue is empty."""
        self._grows, self._before, self._turned = False, None, False


def remedy_for_size(transport: Transport, proposal: Propose) -> str:
    """Return what an operator can do about messages that are too large for a route."""
    if transport.largest_message < MESSAGE_LIMIT:
        return USE_TCP
    return "publish smaller ones" if proposal.compression == "zstd" else "set compression: zstd"


class Outbox:
    """The queue before a route's channel, which counts what it drops in the ledger.

    Attributes:
        largest: bytes of the longest message that the transport carries.
        leaving: asked of messages right before the channel gets them.
        queue: the messages that wait.
    """

    def __init__(self, flow: TopicFlow, ledger: RouteLedger, backlog: Backlog) -> None:
        self.leaving: Sieve[Message] | None = None
        self._flow, self._carried = flow, flow.carried
        self._route = route = flow.route
        self._automatic = route.proposal.qos is None
        self._ledger = ledger
        self._backlog = backlog
        self.largest = route.transport.largest_message
        self.queue = SendQueue(route.peer.budget.waiting)
        self._keep: Keep | None = None
        self._overload = Overload()
        self._limits = QueueLimits(0, 0.0, 0)  # by which messages were last added

    def compose(self) -> None:
        """Take the present promise of `keep`."""
        route, budget = self._route, self._route.peer.budget
        keep = self._keep = promised_keep(route)
        if keep is None:
            self.queue.charge(budget.waiting)
        # A peer alone must not have this side keep more than the links' topics share.
        elif keep.own_bytes is not None and (route.proposed_here or route.listed):
            self.queue.charge(Budget(keep.own_bytes))
        else:
            self.queue.charge(budget.keep)

    def pass_on(self, messages: Sequence[Message], size: int, channel: SendingChannel) -> bool:
        """Send messages of `size` bytes together past the empty queue, or return False: they have to wait in it."""
        # Only if nothing waits, or it would overtake that; and no more than one turn of the scheduler.
        if self.queue.waiting or len(messages) > _BATCH or not channel.takes(size):
            return False
        if self.leaving is not None:
            messages = self.leaving(messages)
        if messages:
            self._ledger.sent(len(messages))
            channel.send(messages)
        return True

    def add(self, messages: Sequence[Message], now: float, publisher: bytes, limits: QueueLimits) -> None:
        """Have messages of one publisher wait, at `now` (s), within the limits."""
        self.queue.add(messages, now, publisher)
        self._limits = limits
        self._trim(now, publisher)

    def submit(
        self, messages: Sequence[Message], now: float, publisher: bytes, channel: SendingChannel, depth: int
    ) -> None:
        """Send messages of one publisher, and have those wait that the channel does not take.

        Args:
            depth: as of `limits`.
        """
        limits = self.limits(channel, depth, now)
        # What comes at once has not waited: of several commands none is left out while the channel takes them.
        if self._route.age.only_newest and not self.queue.waiting:
            self.queue.add(messages, now, publisher)
            self.flush(channel, now)
            messages = ()
        self.add(messages, now, publisher, limits)
        self.flush(channel, now)

    def resume(self, now: float) -> None:
        """Drop kept messages that have grown too old by `now` (s), also of silent publishers."""
        if self._keep is not None:
            for publisher in self.queue.publishers:
                self._trim(now, publisher)

    def _trim(self, now: float, publisher: bytes) -> None:
        old, beyond = self.queue.trim(self._limits, now, publisher)
        if not (old or beyond):
            return
        if self._keep is not None:
            self._ledger.drop(OUTAGE, old)
            self._ledger.drop(KEEP_FULL, beyond)
        elif self._backlog.exists or self._is_silent(now):
            self._ledger.drop(OUTAGE, old + beyond)
        elif self._route.age.only_newest:
            self._ledger.drop(REPLACED, old + beyond)
        else:
            self._ledger.drop("queue full", old + beyond)
            self._overload.dropped(now)

    def _is_silent(self, now: float) -> bool:
        """Whether the link carries nothing at `now` (s), though it takes seconds until its connection is given up."""
        keepalive, channel = self._route.peer.keepalive, self._carried.channel
        # Neither a full link nor a slow one is without receipts and all other bytes for so long.
        still = 0.0 if channel is None else min(channel.still(now), keepalive.quiet)
        return keepalive.in_doubt or still > STANDS_STILL

    def flush(self, channel: SendingChannel, now: float) -> None:
        """Send while the channel takes messages, at `now` (s)."""
        queue = self.queue
        if self._limits.older_than < math.inf:
            self._trim(now, b"")  # its publisher may be silent since
        while queue.waiting and not channel.congested:
            self._overload.turn()
            batch: Sequence[Message] = queue.take(_BATCH, channel.batch_bytes)
            if self.leaving is not None:
                batch = self.leaving(batch)
            if batch:
                self._ledger.sent(len(batch))
                channel.send(batch)
        if queue.waiting:
            channel.ask()
        else:
            self._overload.reset()

    def __len__(self) -> int:
        return len(self.queue)

    def waits(self, now: float) -> float:
        """Return how long (s) the oldest message has waited at `now` (s), or 0 if none waits."""
        oldest = self.queue.oldest_since
        return 0.0 if oldest is None else now - oldest

    def clear(self) -> int:
        """Remove all messages; return how many they were."""
        self._overload.reset()
        return self.queue.clear()

    def limits(self, channel: SendingChannel, depth: int, now: float) -> QueueLimits:
        """Return the queue's limits at `now` (s). While the channel takes messages, only the age of best effort counts.

        Args:
            depth: messages that the publisher of a latched topic keeps, or 0.
        """
        route, size = self._route, QUEUE_BYTES + self.largest
        if not route.peer.linked:
            # All topics of a link that is away may wait for minutes, and share one limit.
            size = min(size, self.queue.room())
        # A command is a state: after a stall, a robot would follow all the old ones before the present one.
        if route.age.only_newest or (
            route.arming.required and self._flow.end.of(self._carried.type_name) not in ("", END_NONE)
        ):
            return QueueLimits(1, 0.0, size)
        self._overload.judge(now, self.queue.oldest_since, len(self.queue), channel.still(now))
        qos, profile = self._flow.qos, route.peer.profile
        if self._keep is not None:
            number = 0 if qos is None or qos.history == "keep_all" else max(depth, qos.depth or AUTO_DEPTH)
            return QueueLimits(number, self._keep.seconds, self.queue.room())
        best_effort = qos is not None and qos.reliability == "best_effort"
        if best_effort:
            size = profile.queue_bytes or (_SLOW_QUEUE_BYTES if route.transport.slow else size)
        if best_effort and self._automatic and qos is not None and not qos.latched:
            return QueueLimits(0, 0.0, size, _FRESH if channel.behind(now) else _WAITS)
        if qos is None or qos.history == "keep_all" or channel.free:
            return QueueLimits(0, 0.0, size)
        automatic = self._automatic and not best_effort
        # A latched topic keeps its depth, because late joiners get its history.
        if automatic and self._overload.lasts(now) and not qos.latched:
            return QueueLimits(1, _WAITS, size)
        kept_for = AUTO_SECONDS if profile.patience is None else profile.patience
        return QueueLimits(max(depth, qos.depth or AUTO_DEPTH), kept_for if automatic else 0.0, size)

    def fitting(self, messages: Sequence[Message]) -> list[Message]:
        """Return the messages that the transport carries; count the others, and tell operators."""
        fitting = []
        for message in messages:
            if (size := len(message[0])) <= self.largest:
                fitting.append(message)
                continue
            self._ledger.drop("too large", 1)
            transport = self._route.transport
            sizes = f"{size / 1e6:,.1f} MB, more than {transport.name} carries ({self.largest / 1e6:.1f})"
            remedy = remedy_for_size(transport, self._route.proposal)
            self._route.notices.message_error(EventCode.ROUTE_TOO_LARGE, f"a message has {sizes}: {remedy}")
        return fitting


# Of what a topic wants to send.
_PER_MESSAGE = 60  # bytes on the wire besides a message's content: header, seal, and a part of the packets' headers
_SIZE_FADES = 0.8  # part of the earlier messages that counts a second later for the average size: of about five


class TrafficMeter:
    """Measures what one sending half wants to send.

    Attributes:
        offered: messages that the topic wanted to send since the last look, within its own rate limit.
        messages: packed lately; older ones count less.
        bytes: of these.
    """

    def __init__(self, now: float) -> None:
        self.offered = 0
        self.messages = self.bytes = 0.0
        self._size = 0.0
        self._wanted = Smoothed(now)

    @property
    def still(self) -> bool:
        """Whether nothing was offered lately."""
        return not (self.offered or self._wanted.rate)

    def rested(self, until: float) -> None:
        """Take over that nothing was offered until `until` (s)."""
        self._wanted.add(0.0, until)

    def measure(self, now: float) -> float:
        """Return the bytes/s that the topic has wanted to send since the last call. Called once a second."""
        if self.messages:
            self._size = _PER_MESSAGE + self.bytes / self.messages
        self._wanted.add(self.offered, now)
        self.messages *= _SIZE_FADES
        self.bytes *= _SIZE_FADES
        self.offered = 0
        return self._wanted.rate * self._size


class OutgoingPath:
    """The path of one route's messages from ROS to its channel, in the order of its methods.

    `rsb_bridge.route.gates.sending_gates` lists what may keep a message back, in the order in which it is asked here.

    Args:
        loop_filter: of the route; numbers the source of each publisher's messages.

    Attributes:
        traffic: the messages that the topic wants to send.
        unpause: sends the latched messages that have become due while the route was paused.
        histories: of a latched topic's publishers in the present opening, or None for a volatile topic.
        gates: all that are on.
        queue: the messages that wait for the channel.
    """

    def __init__(self, flow: TopicFlow, ledger: RouteLedger, loop_filter: LoopFilter, backlog: Backlog) -> None:
        self.histories: Histories | None = None
        self._flow, self._carried = flow, flow.carried
        self._route = route = flow.route
        self._context = context = route.context
        self.ledger, self.loop_filter, self.backlog = ledger, loop_filter, backlog
        self.traffic = TrafficMeter(context.now())
        self._throttle = Throttle(route.limit.rate)
        self._latest_later = LatestLater(context.loop, self._throttle, self._send_latched, route.pausing)
        self.unpause = self._latest_later.resume
        self._last_later = LastLater(context.loop, self._throttle, self._pass_last)
        self._outbox = Outbox(flow, ledger, backlog)
        self.queue = self._outbox.queue.waiting
        self._compressor = zstandard.ZstdCompressor(_ZSTD_LEVEL) if route.proposal.compression == "zstd" else None
        compose_when_switched(route, self.compose)

    def compose(self) -> None:
        """Choose the gates that are on."""
        if (rate := self._route.limit.rate) != self._throttle.rate:
            # Only on a change: `limit` restarts the beat, and gates are composed for other reasons, too.
            self._last_later.flush()
            self._throttle.limit(rate)
        self._route.weight = route_weight(self._route.proposal, armed=self._route.arming.required)
        beat = self._context.shared(Beats).join(self._route, self._flow, self._throttle, self.compose)
        self.gates = gates = sending_gates(
            self._flow, self.ledger, self._throttle, self._last_later, self.loop_filter, self._outbox.fitting, beat
        )
        self._batch = chained(gates.batch)
        self._arriving = sifting(*gates.arriving)
        self._kept = sifting(*gates.kept)
        self._packed = sifting(*gates.packed)
        self._sourced = sifting(*gates.sourced) if gates.sourced else None
        self._outbox.leaving = sifting(*gates.leaving) if gates.leaving else None
        self._outbox.compose()
        self._stamped = self._route.age.stamped if self._route.age.is_on else None
        asked = gates.batch or gates.sourced or gates.leaving or self._flow.drivers.are_watched
        self._is_plain = not (asked or self._stamped or self._compressor or self._route.arming.required)

    # --- from ROS

    def offer(self, batch: Sequence[RawMessage]) -> None:
        """Take messages from ROS, oldest first."""
        if self._route.idle:
            self._route.wake()
        publisher = batch[0].gid
        source = self.loop_filter.table.flags.get(publisher) if self._is_plain else None
        if source is None or self.histories is not None or self._flow.peek_slot.wanted or self._context.stamps.shift:
            self._offer_asked(batch)
            return
        # Nothing is asked of a plain topic's messages but their source. Nearly all topics are plain, and nearly all
        # messages of a turn come alone.
        messages: list[Message] = []
        size = 0
        for payload, stamp, gid, _, _, _ in batch:
            if gid != publisher:
                self._offer_asked(batch)
                return
            messages.append((payload, stamp, source))
            size += len(payload)
        self.ledger.offered += len(batch)
        self.traffic.offered += len(batch)
        self._send(messages, size, publisher)

    def _offer_asked(self, batch: Sequence[RawMessage]) -> None:
        """Take messages of which more than their source is asked."""
        if self._batch is not None and (why := self._batch(NO_SAMPLE, self._context.now())) is not None:
            self.ledger.lose(CAUSES[why], len(batch))
            return
        if self._stamped is not None:
            batch = self._stamped(batch)
        elif shift := self._context.stamps.shift:
            batch = [each._replace(stamp=shifted(each.stamp, shift)) for each in batch]
        self.receive(self._arriving(batch))

    def too_late(self, batch: Sequence[RawMessage]) -> None:
        """Drop messages that come after their opening."""
        self._route.wake()
        self.ledger.lose("link lost", len(batch))

    # --- of a volatile topic

    def receive(self, batch: Sequence[RawMessage]) -> None:
        """Receive messages that do not loop, oldest first."""
        if self.histories is not None:
            taken, ledger = self.histories.receive(batch), self.ledger
            ledger.offered += taken.new
            ledger.again += taken.again
            ledger.known_there += taken.known
            return
        if not batch:
            return
        if self._flow.peek_slot.wanted:
            self._show(batch)
        self.ledger.offered += len(batch)
        if self._sourced is not None:
            batch = self._sourced(batch)
        self._send_volatile(batch)

    def _pass_last(self, message: RawMessage) -> None:
        """Send a message that the rate limit has left out, as none has followed it."""
        route, now = self._route, self._context.now()
        stopped = self._batch is not None and self._batch(NO_SAMPLE, now) is not None
        # Its publisher may have moved behind another bridge meanwhile.
        if route.pausing.paused or stopped or message.gid not in self.loop_filter.table.flags:
            self.ledger.throttled += 1
        else:
            self._send_volatile((message,))

    def _send_volatile(self, batch: Sequence[RawMessage]) -> None:
        if not batch:
            return
        route = self._route
        self.traffic.offered += len(batch)
        sources, arming = self.loop_filter.table.flags, route.arming
        # Asked once for the batch: nearly all topics are plain, and their messages save two calls.
        plain = self._compressor is None and not arming.required
        messages: list[Message] = []
        size = 0
        publisher = batch[0].gid
        for payload, stamp, gid, _, lease, _ in batch:
            if gid != publisher:  # a queue counts each one's messages
                self._send(messages, size, publisher)
                messages, size, publisher = [], 0, gid
            message = payload, stamp, sources[gid]
            if not plain:
                message = arming.pack(self._compressed(message), lease)
            messages.append(message)
            size += len(message[0])
        self._send(messages, size, publisher)

    def _show(self, messages: Sequence[RawMessage]) -> None:
        slot, newest = self._flow.peek_slot, messages[-1]
        if slot.tap is not None:
            now = self._context.wall_ns()
            for payload, _, gid, number, _, source in messages:
                slot.tap(payload, now, source or now, gid, number)
        if slot.is_awaited:
            time_ns = newest.stamp - self._context.stamps.shift
            slot.put(peeked(self._flow, newest.payload, time_ns), self._context.now())

    def _compressed(self, message: Message) -> Message:
        """Return a message as it is sent: compressed if both sides agreed on that and it gets smaller.

        The receiver unpacks no more than `CONTENT_LIMIT`; a longer message stays as it is, and is dropped here.
        """
        payload, stamp, flags = message
        if self._compressor is not None and len(payload) <= CONTENT_LIMIT:
            smaller = self._compressor.compress(payload)
            if len(smaller) < len(payload):
                return smaller, stamp, flags | ZSTD
        return message

    # --- of a latched topic

    def emit(self, samples: Sequence[Sample]) -> None:
        """Take messages of a latched topic whose histories are known by now: they just came, or waited for these."""
        if self._flow.peek_slot.wanted and samples:
            self._show([each.message for each in samples])
        admitted, left_out = self._latest_later.admit(samples)
        self.ledger.throttled += left_out
        self.traffic.offered += len(admitted)
        self._send_latched(admitted)

    def _send_latched(self, samples: Sequence[Sample]) -> None:
        samples = self._kept(samples)
        sources = self.loop_filter.table.flags
        for publisher, group in groupby(samples, _PUBLISHER):
            messages: list[Message] = []
            size = depth = 0
            for header, (payload, stamp, gid, *_), _ in group:
                depth = header.depth
                content, _, flags = self._compressed((payload, stamp, sources[gid]))
                messages.append((header.pack() + content, stamp, flags | HISTORY))
                size += len(messages[-1][0])
            self._send(messages, size, publisher, depth)

    # --- to the channel

    def _send(self, messages: Sequence[Message], size: int, publisher: bytes, depth: int = 0) -> None:
        """Send messages of a publisher, or let them wait.

        Args:
            messages: as they are sent, oldest first.
            depth: of a latched topic, messages that the publisher keeps.
        """
        route, traffic, outbox = self._route, self.traffic, self._outbox
        channel = self._carried.channel
        if channel is None or not channel.ready or not route.life.accepted:
            self.ledger.drop("link lost", len(messages))
            return
        if not messages:
            return
        now = self._context.now()
        self._flow.count(len(messages), size, now)
        if size > outbox.largest:  # else each one fits
            fitting = self._packed(messages)
            # They ask nothing of the link. If they counted, a late topic would make it seem full.
            traffic.offered -= len(messages) - len(fitting)
            messages = fitting
            size = sum([len(message[0]) for message in messages])
            if not messages:
                return
        traffic.messages += len(messages)
        traffic.bytes += size
        if outbox.pass_on(messages, size, channel):
            return
        outbox.submit(messages, now, publisher, channel, depth)

    def flush(self) -> None:
        if (channel := self._carried.channel) is not None:
            self._outbox.flush(channel, self._context.now())

    # --- switches

    def resume(self) -> None:
        """Go on, as the link is back."""
        self._outbox.resume(self._context.now())

    def clear_later(self) -> int:
        """Drop the messages that wait for the rate limit, and return their number."""
        return self._latest_later.clear() + self._last_later.follow(None)

    def clear(self) -> int:
        """Drop the queued messages, and the volatile one that waits for the rate limit, and return their number."""
        return self._outbox.clear() + self._last_later.follow(None)

    def waits(self, now: float) -> float:
        """Return how long (s) messages have waited for the channel at `now` (s)."""
        return self._outbox.waits(now)
