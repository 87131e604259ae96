"""The pace of late messages: hundreds that have waited for a link arrive together when it is back.

A subscription keeps ten messages by default. If they arrive faster than its node takes them, it loses the oldest, even
though DDS has acknowledged them. So late messages are published a few at a time.
"""

from __future__ import annotations

from rsb_bridge.model.budgets import TokenBucket

LATE = 0.2
"""s that a message took, from which on it is one of these. A link that is always slower is not held up by the pace."""
AT_ONCE, EVERY = 5, 0.01
"""Messages, half the default depth of a subscription, and s until the next: a node takes one in 0.1 to 1 ms. A timer
that fires late publishes twice as many, or a busy machine would never catch up."""
_ROUNDED = 1e-6


class CatchUp:
    """The pace of one topic, which is at least twice its rate: else it would never catch up.

    Args:
        now: s.
    """

    def __init__(self, now: float) -> None:
        self._rate = AT_ONCE / EVERY
        self._bucket = TokenBucket(2 * AT_ONCE, self._rate, now)

    def allowed(self, count: int, now: float, own_rate: float) -> int:
        """Return how many of `count` late messages of a topic may be published at `now` (s); its rate is in Hz."""
        rate = max(AT_ONCE / EVERY, 2 * own_rate)
        if rate > 1.5 * self._rate or rate < self._rate / 1.5:
            self._rate = rate
            self._bucket = TokenBucket(2 * rate * EVERY, rate, now)
        allowed = min(count, int(self._bucket.left(now) + _ROUNDED))
        self._bucket.spend(allowed, now)
        return allowed
