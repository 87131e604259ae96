"""The clock for the stamps that measure messages' ages: a wall clock that is never set."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Clock:
    """A wall clock for time stamps, which may be set at any time, and a steady clock for durations."""

    def time_ns(self) -> int:
        """Return the time in nanoseconds since the epoch."""
        return time.time_ns()

    steady: Callable[[], float] = staticmethod(partial(time.clock_gettime, time.CLOCK_BOOTTIME))
    """Return the seconds of a clock that is never set and continues while the machine sleeps. It costs no call of
    Python, because it is asked for each message."""


_STEP, _DRIFT, _MOST = 20_000_000, 1e-4, 50_000_000
"""ns by which the wall clock may be off since the last check, ns a ns since then, and ns at the most: beyond it, it was
set."""
_SAME = 1_000_000  # ns; smaller changes of the shift are ignored
_READ_WITHIN = 1_000_000  # longest time in ns between the readings of the two clocks
_TRIES = 10  # on a busy machine, this thread may lose the processor between the readings; the last try counts as it is
_UNSURE_FOR = 10_000_000_000
"""ns after the wall clock was set in which wall stamps are not trusted: older stamps may still come, if the thread that
takes from ROS is held up."""


class StampClock:
    """The wall clock at the start of this process, which goes on with the time since the machine was booted.

    So a wall clock that is set, on either side, changes no age. Stamps of the wall clock, as the middleware gives them,
    are converted by adding `shift`.

    Attributes:
        shift: ns, this clock minus the wall clock.
        steps: number of times that the wall clock was set.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        # With a base of 0, the shift is the steady clock minus the wall clock.
        self._base = 0
        self._base = -self._measure()[0]
        self._looked = self.now()
        self._stepped: int | None = None
        self.shift = 0
        self.steps = 0

    def now(self) -> int:
        """Return the time in ns since the epoch."""
        return self._base + int(self._clock.steady() * 1e9)

    def compare(self) -> None:
        """Compare it with the wall clock. To be called once a second, and before wall stamps are converted."""
        shift, now = self._measure()
        change = abs(shift - self.shift)
        # It is within the error of reading two clocks (`_READ_WITHIN`), and would only make ages jump.
        if change < _SAME:
            self._looked = now
            return
        if change > min(_STEP + _DRIFT * (now - self._looked), _MOST):
            self._stepped = now
            self.steps += 1
        self.shift, self._looked = shift, now

    @property
    def is_sure(self) -> bool:
        """Whether wall stamps can be converted: the wall clock was not set a moment ago."""
        return self._stepped is None or self.now() - self._stepped >= _UNSURE_FOR

    def _measure(self) -> tuple[int, int]:
        """Read both clocks at nearly the same moment; return the shift and the time."""
        shift = now = 0
        for _ in range(_TRIES):
            before = self.now()
            wall = self._clock.time_ns()
            now = self.now()
            shift = now - wall
            if now - before < _READ_WITHIN:
                break
        return shift, now


def shifted(stamp: int, shift: int) -> int:
    """Return a wall stamp (ns) by another clock. One from before that clock was set may be before its epoch: then 0."""
    return max(0, stamp + shift)
