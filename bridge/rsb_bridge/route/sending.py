"""What becomes of a sending half's messages from ROS until its channel takes them: throttled, packed and queued."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.receipts import Pace, pace_of
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.peeking import Peekable, peeked
from rsb_bridge.route.thinning import THINNED, LatestLater, Thinning, Throttle
from rsb_bridge.route.topic_outbox import Outbox
from rsb_bridge.wire.framing import HISTORY, Message

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.context import Context
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
