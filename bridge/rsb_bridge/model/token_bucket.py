"""A rate limit with a burst, for what a peer makes this side do."""

from __future__ import annotations


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
