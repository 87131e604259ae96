"""What a link carries, and how that is known."""

from __future__ import annotations

from enum import StrEnum

import msgspec


class CapacitySource(StrEnum):
    """How a capacity is known, the best first."""

    BENCH = "bench"
    """A bench over this link has measured it."""
    FULL = "full"
    """So much crossed while more waited to be sent."""
    SEEN = "seen"
    """So much has crossed; it may carry more."""


class Capacity(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """What a link carries in one direction.

    Attributes:
        bytes_per_second: on the wire.
        source: a `CapacitySource`.
        at: s since the epoch, when that was.
    """

    bytes_per_second: float
    source: str
    at: float

    def age(self, now: float) -> float:
        """S since it was measured, at `now` (s since the epoch)."""
        return max(0.0, now - self.at)


LASTS = 600.0
"""s after which what was measured gives way to what is seen: a robot moves, and its network with it."""


def newer(known: Capacity | None, found: Capacity) -> Capacity:
    """Which of two counts: what a bench or a full link says, while it is recent; of what was only seen, the highest."""
    if known is None or found.source != CapacitySource.SEEN:
        return found
    recent = found.at - known.at < LASTS
    return known if recent and known.bytes_per_second >= found.bytes_per_second else found
