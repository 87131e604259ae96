"""How much of something a peer may have this side do: so much at once, then so much a second."""

from __future__ import annotations


class TokenBucket:
    """Holds at most `burst`, and gets `per_second` more each second (ITU-T I.371, the leaky bucket as a meter).

    Times are s, of a clock that nobody sets.
    """

    __slots__ = ("_at", "_burst", "_left", "_per_second")

    def __init__(self, burst: float, per_second: float, now: float) -> None:
        self._burst = burst
        self._per_second = per_second
        self._left = burst
        self._at = now

    def left(self, now: float) -> float:
        """How much may be taken."""
        self._left = min(self._burst, self._left + (now - self._at) * self._per_second)
        self._at = now
        return self._left

    def take(self, amount: float, now: float) -> bool:
        """Use up `amount`; False: there is not so much, and none was taken."""
        if amount > self.left(now):
            return False
        self._left -= amount
        return True
