"""The wall clock, as one object, so that a simulation can bring another."""

from __future__ import annotations

import time


class Clock:
    """The machine's wall clock. It may be set at any time: use it for time stamps, never to measure how long."""

    def time_ns(self) -> int:
        """The time now, in nanoseconds since the epoch."""
        return time.time_ns()
