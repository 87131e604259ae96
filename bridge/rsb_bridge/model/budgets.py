"""A rate limit with a burst, for what a peer makes this side do."""

from __future__ import annotations

import threading


class TokenBucket:
    """Holds up to `burst` tokens, and gains `per_second` tokens each second (ITU-T I.371, the leaky bucket as a meter).

    Times are in seconds, of a monotonic clock.
    """

    __slots__ = ("_at", "_burst", "_left", "_per_second")

    def __init__(self, burst: float, per_second: float, now: float) -> None:
        self._burst = burst
        self._per_second = per_second
        self._left = burst
        self._at = now

    def left(self, now: float) -> float:
        """The tokens left."""
        self._left = min(self._burst, self._left + (now - self._at) * self._per_second)
        self._at = now
        return self._left

    def spend(self, amount: float, now: float) -> None:
        """Take `amount` tokens, even if there are fewer: the bucket then owes the rest."""
        self._left = self.left(now) - amount

    def take(self, amount: float, now: float) -> bool:
        """Take `amount` tokens; False: there are fewer, and none was taken."""
        if amount > self.left(now):
            return False
        self._left -= amount
        return True


LIMIT = 16 * 1024 * 1024
"""Bytes of all strangers of an engine together."""
CONNECTION = 16 * 1024
"""Bytes counted for a connection: its 4 KiB, and what keeps track of it."""


class Strangers:
    """The budget of all strangers of an engine, over all transports. Used on any thread.

    Attributes:
        turned_away: connections closed and samples dropped so far: the budget was spent, or they were too long.
    """

    def __init__(self, limit: int = LIMIT) -> None:
        self.turned_away = 0
        self._limit = limit
        self._used = 0
        self._counting = threading.Lock()

    @property
    def used(self) -> int:
        """Bytes counted now."""
        return self._used

    def take(self, size: int) -> bool:
        """Count some bytes, unless the budget is spent. Return whether they are counted."""
        with self._counting:
            if self._used + size > self._limit:
                self.turned_away += 1
                return False
            self._used += size
            return True

    def turn_away(self) -> None:
        """Count something that was dropped unread."""
        with self._counting:
            self.turned_away += 1

    def give(self, size: int) -> None:
        """Give bytes back."""
        with self._counting:
            self._used -= size
