"""A machine's clocks that a test moves."""

from __future__ import annotations

from rsb_bridge.model.clock import Clock

EPOCH = 1_700_000_040.0
"""s; the beginning of a minute."""


class HandClock(Clock):
    """Stands until it is moved.

    Attributes:
        wall: s since the epoch.
        up: s since the machine started.
    """

    def __init__(self) -> None:
        self.wall = EPOCH
        self.up = 1000.0

    def time_ns(self) -> int:
        return int(self.wall * 1e9)

    def steady(self) -> float:
        return self.up

    def go(self, seconds: float) -> None:
        self.wall += seconds
        self.up += seconds
