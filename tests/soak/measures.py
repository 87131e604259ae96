"""Samples of a process over its life: memory, descriptors, threads."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

_PAGE_KB = os.sysconf("SC_PAGE_SIZE") / 1024
_LONGEST_WARM_UP = 180.0
_CALM_AT_LEAST = 6
"""Calm moments in a life before its growth is judged."""


class Sample(NamedTuple):
    """At one moment.

    Attributes:
        resident: kB of memory.
    """

    time: float
    resident: float
    descriptors: int
    threads: int


def sample(pid: int, now: float) -> Sample | None:
    folder = Path(f"/proc/{pid}")
    try:
        pages = int((folder / "statm").read_text().split()[1])
        descriptors, threads = (len(os.listdir(folder / what)) for what in ("fd", "task"))  # noqa: PTH208 — half the time
    except (FileNotFoundError, ProcessLookupError):
        return None
    return Sample(now, pages * _PAGE_KB, descriptors, threads) if threads else None


@dataclass
class Life:
    """One process from its start to its end.

    Attributes:
        calm: those taken while all was well.
    """

    program: str
    pid: int
    samples: list[Sample] = field(default_factory=list)
    calm: list[Sample] = field(default_factory=list)

    def measure(self, now: float, *, calm: bool) -> None:
        taken = sample(self.pid, now)
        if taken is not None:
            (self.calm if calm else self.samples).append(taken)

    @property
    def seconds(self) -> float:
        return self.samples[-1].time - self.samples[0].time if self.samples else 0.0

    @property
    def warm(self) -> list[Sample]:
        """The samples after the warm-up: its first quarter, three minutes at most."""
        if not self.samples:
            return []
        begins = self.samples[0].time + min(_LONGEST_WARM_UP, self.seconds / 4)
        return [each for each in self.samples if each.time >= begins]

    @property
    def warm_minutes(self) -> float:
        """Return the length (min) of the warm part."""
        warm = self.warm
        return (warm[-1].time - warm[0].time) / 60 if warm else 0.0

    @property
    def slope(self) -> float:
        return 60 * slope([(each.time, each.resident) for each in self.warm])

    def growth(self, what: str) -> int:
        """By how much `descriptors` or `threads` grew: the least of the last third of the calm moments, beyond the most
        of the first third; 0 or less: not at all."""
        counts = [int(getattr(each, what)) for each in self.calm]
        if len(counts) < _CALM_AT_LEAST:
            return 0
        third = len(counts) // 3
        return min(counts[-third:]) - max(counts[:third])


def slope(points: list[tuple[float, float]]) -> float:
    if not points:
        return 0.0
    mean_x, mean_y = (sum(values) / len(points) for values in zip(*points, strict=True))
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    return sum((x - mean_x) * (y - mean_y) for x, y in points) / spread if spread else 0.0
