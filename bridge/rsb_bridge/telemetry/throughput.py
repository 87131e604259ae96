"""How much a link carries in one direction, by what has arrived. Nothing here reads a clock."""

from __future__ import annotations

from collections import deque

from rsb_bridge.model.capacity import Capacity, CapacitySource, newer

_WINDOW = 4
"""Looks that a throughput is taken over, about 1 s each."""
_ENOUGH = 3
"""Looks that say what a link carries."""


class Throughput:
    """One direction of a link.

    Attributes:
        capacity: what it is known to carry; None: nothing yet.
    """

    def __init__(self) -> None:
        self.capacity: Capacity | None = None
        self._looked: float | None = None
        self._full = False
        self._window: deque[tuple[float, float]] = deque(maxlen=_WINDOW)

    def look(self, arrived: float, now: float, at: float, *, full: bool) -> float:
        """Take what has arrived since the last look, about a second ago.

        Args:
            arrived: bytes.
            now: s.
            at: s since the epoch, now.
            full: more waited to be sent all the time.

        Returns:
            Bytes/s, over the last seconds for which that is as it is now.
        """
        began, self._looked = self._looked, now
        if began is None or now <= began:
            return 0.0
        if full != self._full:
            self._full = full
            self._window.clear()
        self._window.append((max(0.0, arrived), now - began))
        rate = sum(size for size, _ in self._window) / sum(seconds for _, seconds in self._window)
        if len(self._window) >= _ENOUGH and rate:
            source = CapacitySource.FULL if full else CapacitySource.SEEN
            self.capacity = newer(self.capacity, Capacity(rate, source, at))
        return rate

    def disconnected(self) -> None:
        """What arrives from now on comes by another connection."""
        self._looked, self._full = None, False
        self._window.clear()

    def measured(self, capacity: Capacity) -> None:
        """A bench says what it carries."""
        self.capacity = newer(self.capacity, capacity)
