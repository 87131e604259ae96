"""The machine's clocks, as one object, so that a simulation can bring another."""

from __future__ import annotations

import time


class Clock:
    """The wall clock, which may be set at any time: for time stamps; and one to measure how long."""

    def time_ns(self) -> int:
        """The time now, in nanoseconds since the epoch."""
        return time.time_ns()

    def steady(self) -> float:
        """Seconds on a clock that nobody sets, and that goes on while the machine sleeps."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)
