"""The time line's clock: like the wall clock, but nobody sets it while nobody is told."""

from __future__ import annotations

_SET_BY = 2.0
"""s by which the wall clock must jump to count as set."""


class Axis:
    """Times in s since the epoch that go on evenly, as long as `advance` reports no jump.

    A machine without a battery for its clock starts with an old time, and is set right later. Until then, time goes on
    from `floor`, so that nothing seems to happen before what happened earlier.

    Args:
        steady: s on a clock that nobody sets and that goes on while the machine sleeps.
        wall: s since the epoch.
        floor: the time of what is remembered last.

    Attributes:
        now: the time.
        jump: s by which the clock was set, as noticed by the last `advance`; 0: it was not.
    """

    def __init__(self, steady: float, wall: float, floor: float = 0.0) -> None:
        self.now = max(wall, floor)
        self.jump = 0.0
        self._steady = steady
        self._offset = wall - steady

    def advance(self, steady: float, wall: float) -> float:
        """Move on to the present time.

        Args:
            steady: as in the constructor, likewise the other.
            wall: likewise.

        Returns:
            s that have passed.
        """
        passed = steady - self._steady
        self._steady = steady
        self.now += passed
        offset = wall - steady
        self.jump = offset - self._offset if abs(offset - self._offset) > _SET_BY else 0.0
        if self.jump:
            self._offset = offset
        return passed

    def set(self, wall: float, earliest: float) -> float:
        """After a jump: go on from the wall clock's time, but from no earlier one.

        Returns:
            s by which the axis moved.
        """
        before, self.now = self.now, max(wall, earliest)
        return self.now - before

    def of_wall(self, moment: float) -> float:
        """A recent time of the wall clock, on this axis."""
        return moment + self.now - (self._steady + self._offset)
