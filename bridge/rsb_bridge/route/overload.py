"""Distinguishes a steady overload from a link that stalls for a moment.

With ``qos: auto`` a reliable topic keeps messages for some seconds, so that a link that stalls loses none. In a steady
overload the link delivers, and yet the queue gets longer and older. Then every message would arrive late, so the queue
keeps only new ones.
"""

from __future__ import annotations

_LOOKS_EVERY = 1.0
WAITS = 1.0
"""s that an overloaded topic's queue keeps a message, unless it is the only one."""


class Overload:
    """Overload of one topic.

    Attributes:
        lasts: whether more is published than the channel delivers.
    """

    def __init__(self) -> None:
        self.lasts = False
        self._before: tuple[float, float, int] | None = None  # when (s), the oldest message's age (s), the length

    def look(self, now: float, oldest_since: float | None, length: int, *, moves: bool) -> None:
        """Judge the queue. Called whenever a message is queued.

        Args:
            now: s.
            oldest_since: when (s) the oldest message was queued, or None if the queue is empty.
            length: messages in the queue.
            moves: whether the channel delivers.
        """
        if oldest_since is None:
            self.lasts, self._before = False, None
            return
        age = now - oldest_since
        if not moves:
            self._before = None
        elif self._before is None:
            self._before = (now, age, length)
        elif now - self._before[0] >= _LOOKS_EVERY:
            _, age_before, length_before = self._before
            self.lasts = self.lasts or (age >= WAITS and age >= age_before and length >= length_before)
            self._before = (now, age, length)

    def over(self) -> None:
        """End the overload: the queue is empty."""
        self.lasts, self._before = False, None
