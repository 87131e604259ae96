"""Tells a topic that is steadily given more than its link carries from one whose link has stalled for a moment.

With ``qos: auto`` the messages of a reliable topic wait for some seconds, so that a link that stalls loses none. Where
the link moves, and yet the queue only gets longer and older, they would all arrive late from then on: there only new
ones are worth to wait.
"""

from __future__ import annotations

_LOOKS_EVERY = 1.0
WAITS = 1.0
"""s that a message of such a topic waits at most, if others do."""


class Overload:
    """One topic's.

    Attributes:
        lasts: whether it is given more than crosses.
    """

    def __init__(self) -> None:
        self.lasts = False
        self._before: tuple[float, float, int] | None = None  # when (s), the oldest message's age (s), the length

    def look(self, now: float, oldest_since: float | None, length: int, *, moves: bool) -> None:
        """Look at the queue at `now` (s), as often as it is used while the channel is congested.

        Args:
            now: s.
            oldest_since: when (s) the oldest message began to wait; None: none waits.
            length: messages that wait.
            moves: whether anything arrives on the other side.
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
        """Nothing waits any more."""
        self.lasts, self._before = False, None
