"""A volatile topic on the receiving side: what DDS holds for slow subscribers is bounded over the whole link.

DDS keeps each message until every reliable subscription has acknowledged it, up to the publisher's depth. A program
that is stopped acknowledges nothing until DDS gives it up, 20 s later. The memory of a message is used again for others
of the same publisher, and never shrinks; it is freed with the publisher.

After a process was frozen, its messages come in a burst, faster than subscriptions acknowledge them. A publisher that
keeps few messages overwrites some that a reliable subscription has missed and requests again. So without a chosen depth
it keeps many messages, unless a subscription leaves them unacknowledged for long.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.ros_interface import Publisher
    from rsb_bridge.wire.framing import Budget

FREE = 1 << 16
"""Bytes that each publisher may hold uncounted, so that topics of small messages go on whatever the others hold."""
BURST_DEPTH = 2000
"""Messages that a publisher keeps at first if nobody has chosen a depth."""
_BURST_BYTES = 1 << 20
"""Bytes kept for a burst from which on DDS is asked more often for acknowledgements."""
_BURST_TIME = 2.0
"""Seconds for which more bytes may be kept before a publisher that keeps few messages replaces this one."""
_MATCHED_WITHIN = 2.0
"""Seconds that subscriptions have to find the new publisher before it takes over: what is published before is lost to
them."""
_MESSAGE_COST = 256  # bytes
_ASKS_AGAIN_AFTER = 0.01
"""s, while subscribers take nothing: to ask DDS takes 100 µs then."""


class SlowSubscriberError(Exception):
    """DDS would hold too much for subscribers that do not take their messages."""

    def __init__(self, limit: int) -> None:
        super().__init__(
            "a subscriber does not take its messages, and this topic would hold more memory for it than is left for "
            f"the link's others, of {limit:,} bytes: restart the subscriber, or have it ask for best_effort or a "
            "smaller depth"
        )


class VolatileTopic:
    """A publisher whose memory counts against its link's budget. It belongs to the I/O loop.

    Args:
        publisher: of a volatile topic.
        depth: messages that it keeps at most.
        budget: of the publisher's link; one topic takes no more of it than it leaves to the others.
        now: the clock that all timers use, in s.
        renew: replaces this publisher by one of another depth, or None.
        lasting_depth: messages that it keeps once a subscriber is slow, or None if always `depth`.
    """

    def __init__(
        self,
        publisher: Publisher,
        depth: int,
        budget: Budget,
        now: Callable[[], float],
        renew: Callable[[int], Publisher] | None = None,
        *,
        lasting_depth: int | None = None,
    ) -> None:
        self._publisher = publisher
        self._depth = depth
        self._budget = budget
        self._now = now
        self._renew = renew
        self._lasting_depth = depth if lasting_depth is None else lasting_depth
        self._unacknowledged_since: float | None = None
        self._successor: Publisher | None = None
        self._successor_since = 0.0
        self._waiting: deque[int] = deque()  # sizes of the memory of messages that may not be acknowledged yet
        self._free: list[int] = []  # of memory that DDS uses next
        self._held = self._charged = self._held_when_asked = 0
        self._asks_at = float("-inf")

    @property
    def subscriber_count(self) -> int:
        """Subscriptions of other nodes that match now."""
        return self._publisher.subscriber_count

    def publish(self, content: bytes, look: Callable[[], None] | None = None) -> None:
        """Publish a message.

        Args:
            content: of the message.
            look: called right before DDS gets the message, which it does not get if this raises anything; or None.

        Raises:
            RosError: the middleware refused it.
            SlowSubscriberError: it would take too much memory.
        """
        size = len(content) + _MESSAGE_COST
        growth, deep = size - self._memory(), self._depth > self._lasting_depth
        full = deep and growth > 0 and self._held + growth > max(_BURST_BYTES, self._lasting_depth * size)
        if full or self._held + growth > self._held_when_asked + FREE:
            self._recycle()
        since = self._unacknowledged_since
        if self._successor is not None:
            self._look_at_successor()
        elif full and since is not None and self._renew is not None and self._now() - since >= _BURST_TIME:
            self._successor, self._successor_since = self._renew(self._lasting_depth), self._now()
        try:
            self._take(size, self._memory())
        except SlowSubscriberError:
            if self._renew is None or (not deep and (self._waiting or not self._free)):
                raise
            self._begin_anew(self._renew)
            self._take(size, 0)
        if look is not None:
            try:
                look()
            except Exception:
                self._free.append(self._waiting.pop())  # for the next message
                raise
        self._publisher.publish(content)

    def close(self) -> None:
        """Close the publisher, which frees its memory. May be called twice."""
        self._publisher.close()
        self._drop_successor()
        self._forget_memory()

    def _look_at_successor(self) -> None:
        """Replace the publisher once the subscriptions have found the new one, unless they have caught up."""
        assert self._successor is not None
        self._recycle()
        if self._unacknowledged_since is None:
            self._drop_successor()
        elif (
            self._successor.subscriber_count >= self._publisher.subscriber_count
            or self._now() - self._successor_since >= _MATCHED_WITHIN
        ):
            assert self._renew is not None
            self._begin_anew(self._renew)

    def _drop_successor(self) -> None:
        if self._successor is not None:
            self._successor.close()
            self._successor = None

    def _begin_anew(self, renew: Callable[[int], Publisher]) -> None:
        """Replace the publisher to free its memory, which is in pieces too small, or kept for a slow subscriber."""
        successor, self._successor = self._successor, None
        former, self._publisher = self._publisher, successor or renew(self._lasting_depth)
        self._depth, self._unacknowledged_since = self._lasting_depth, None
        former.close()
        self._forget_memory()

    def _forget_memory(self) -> None:
        self._budget.give(self._charged)
        self._held = self._charged = self._held_when_asked = 0
        self._waiting.clear()
        self._free.clear()

    def _memory(self) -> int:
        """Size of the memory that DDS uses for the next message, as far as it is large enough."""
        if len(self._waiting) >= self._depth:
            return self._waiting[0]
        return self._free[-1] if self._free else 0

    def _recycle(self) -> None:
        """Take note of it where everything has been acknowledged."""
        now = self._now()
        if now < self._asks_at:
            return
        if self._publisher.acknowledged:
            self._free.extend(self._waiting)
            self._waiting.clear()
            self._held_when_asked = self._held
            self._unacknowledged_since = None
        else:
            if self._unacknowledged_since is None:
                self._unacknowledged_since = now
            self._asks_at = now + _ASKS_AGAIN_AFTER

    def _take(self, size: int, memory: int) -> None:
        growth = max(0, size - memory)
        charge = max(0, self._held + growth - FREE) - self._charged
        if charge > 0 and not self._charge(charge):
            raise SlowSubscriberError(self._budget.limit)
        self._waiting.append(memory + growth)
        if len(self._waiting) > self._depth:
            self._waiting.popleft()
        elif self._free:
            self._free.pop()
        self._held += growth

    def _charge(self, size: int) -> bool:
        """Count more memory; False: the link's others would not be left as much as this topic has."""
        if self._charged + size > self._budget.limit - self._budget.held - size:
            return False
        self._charged += size
        return self._budget.take(size)
