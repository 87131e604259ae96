"""Rings the terminal's bell when a fault begins."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rsb_bridge.model.faults import ChangeKind, FaultWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.faults import FaultChange
    from rsb_bridge.model.snapshot import Snapshot

RINGS_EVERY = 10.0
"""s between two rings, at least."""


class Bell:
    """Rings when a fault of the shown engine begins. Earlier faults do not ring.

    Args:
        ring: rings once.
        is_on: whether it rings at first.
        clock: gives s on a clock that nobody sets.

    Attributes:
        is_on: whether it rings now.
    """

    def __init__(self, ring: Callable[[], None], *, is_on: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self.is_on = is_on
        self._ring = ring
        self._clock = clock
        self._rang_at = float("-inf")
        self._engine: EngineApi | None = None
        self._watch: FaultWatch | None = None

    def look(self, engine: EngineApi | None, snapshot: Snapshot) -> None:
        """Look for new faults. Called at each refresh; costs nothing while the bell is off."""
        now = self._clock()
        if engine is None or not self.is_on or not snapshot.running:
            self._watch = None
        elif self._watch is None or engine is not self._engine:
            self._engine, self._watch = engine, FaultWatch()
            self._watch.assume(snapshot, now)
        else:
            begun = [change for change in self._watch.look(snapshot, now) if rings_for(change)]
            if begun and now - self._rang_at >= RINGS_EVERY:
                self._rang_at = now
                self._ring()


def rings_for(change: FaultChange) -> bool:
    """Whether a change is worth a ring: a fault has begun that no operator has acknowledged."""
    return change.kind is ChangeKind.BEGUN and change.subject.acknowledged is None
