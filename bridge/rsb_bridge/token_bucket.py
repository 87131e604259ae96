"""How much of something a peer may have this side do: so much at once, then so much a second."""

from __future__ import annotations


class TokenBucket:
    """Holds at most `burst`, and gets `per_second` more each second (ITU-T I.371, the leaky bucket as a meter).

    Attributes:
        left: what may be taken at once, as of the last `take`.
    """

    __slots__ = ("_at", "_burst", "_per_second", "left")

    def __init__(self, burst: float, per_second: float, now: float) -> None:
        self._burst = burst
        self._per_second = per_second
        self.left = float(burst)
        self._at = now

    def take(self, amount: float, now: float) -> bool:
        """Use up `amount` at `now` (s, of a clock that nobody sets); False: there is not so much, none was taken."""
        self.left = min(self._burst, self.left + (now - self._at) * self._per_second)
        self._at = now
        if amount > self.left:
            return False
        self.left -= amount
        return True
