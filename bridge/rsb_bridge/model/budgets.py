"""Limits on the work and memory that peers and strangers cause, and waits between attempts."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random


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
        self._left = min(self._burst, self._left + (now - self._at) * self._per_second)
        self._at = now
        return self._left

    def spend(self, amount: float, now: float) -> None:
        """Take `amount` tokens, even if there are fewer: the balance then becomes negative."""
        self._left = self.left(now) - amount

    def take(self, amount: float, now: float) -> bool:
        """Take `amount` tokens and return True, or take none and return False if there are fewer."""
        if amount > self.left(now):
            return False
        self._left -= amount
        return True


LIMIT = 16 * 1024 * 1024  # bytes that all strangers of an engine may use together
CONNECTION = 16 * 1024  # bytes counted for a connection: its 4 KiB buffer and the records about it


class Strangers:
    """The budget of all strangers of an engine, over all transports. Used on any thread.

    Attributes:
        turned_away: connections closed and samples dropped so far: the budget was spent, or they were too long.
    """

    def __init__(self, limit: int = LIMIT) -> None:
        self.turned_away = 0
        self._limit = limit
        self.used = 0
        self._counting = threading.Lock()

    def take(self, size: int) -> bool:
        """Count some bytes, unless the budget is spent. Return whether they are counted."""
        with self._counting:
            if self.used + size > self._limit:
                self.turned_away += 1
                return False
            self.used += size
            return True

    def turn_away(self) -> None:
        """Count something that was dropped unread."""
        with self._counting:
            self.turned_away += 1

    def give(self, size: int) -> None:
        with self._counting:
            self.used -= size


class Backoff:
    """Gives the delay before each next attempt: it doubles up to `longest`, and stays there however many follow.

    Args:
        first: the first delay, in seconds.
        longest: the longest, in seconds; jitter comes on top.
        random: varies each delay, so that clients that fail together do not retry together; None for no jitter.
        jitter: the largest variation, as a share of the delay.
    """

    def __init__(self, first: float, longest: float, random: Random | None = None, jitter: float = 0.2) -> None:
        self._first = self._next = first
        self._longest = longest
        self._random = random
        self._jitter = jitter

    def next(self, at_most: float = math.inf) -> float:
        """Return the delay (s) before the next attempt.

        Args:
            at_most: upper limit of the delay this time.
        """
        delay = min(self._next, at_most)
        self._next = min(2 * self._next, self._longest)
        if self._random is None:
            return delay
        return delay * self._random.uniform(1 - self._jitter, 1 + self._jitter)

    def reset(self) -> None:
        self._next = self._first
