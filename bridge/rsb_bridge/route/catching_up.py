"""Messages that have waited for a link, once it is back: what is left of them, and the pace of their publication.

Hundreds of them arrive together. A subscription keeps ten messages by default. If they arrive faster than its node
takes them, it loses the oldest, even though DDS has acknowledged them. So late messages are published a few at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import TokenBucket

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Ledger

LATE = 0.2
"""s that a message took, from which on it is one of these. A link that is always slower is not held up by the pace."""
AT_ONCE, EVERY = 5, 0.01
"""Messages, half the default depth of a subscription, and s until the next: a node takes one in 0.1 to 1 ms. A timer
that fires late publishes twice as many, or a busy machine would never catch up."""
_ROUNDED = 1e-6

_STUCK_AFTER = 10.0  # s in which the backlog gets no shorter: the link carries less than is published. A round figure


class Backlog:
    """The messages that waited for a link, and those behind them, until the receiving side has reported them.

    Attributes:
        exists: whether the link is away, or not all of them are settled.
        left: how many are not settled, once the link is back, or 0 before.
        dropped_before: messages dropped in earlier outages.
    """

    def __init__(self) -> None:
        self.exists = False
        self.left = self.dropped_before = 0
        self._until = 0  # messages offered: the newest that belongs to it
        self._least = 0  # `left` so far
        self._shrank_at = 0.0

    def begin(self, dropped: int) -> None:
        """Begin: the link is away, and so many messages were dropped in earlier outages."""
        self.exists, self.dropped_before = True, dropped
        self.left = self._least = 0

    def end(self) -> None:
        self.exists = False

    def judge(self, ledger: Ledger, now: float) -> None:
        """Judge what is left at `now` (s), as the link is back. Called once a second."""
        if ledger.waiting or not self.left:  # what comes now waits behind them
            self._until = ledger.offered
        self.left = max(0, self._until - (ledger.offered - ledger.open))
        if not self._least or self.left < self._least:
            self._least, self._shrank_at = self.left, now
        self.exists = self.left > 0 and now - self._shrank_at < _STUCK_AFTER


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
