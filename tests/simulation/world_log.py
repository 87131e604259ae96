"""The log of a world: its last lines, to explain a failure, and counts of everything."""

from __future__ import annotations

import zlib
from collections import Counter, deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.simulation.loop import SimulatedLoop


_REMEMBERED = 300


class WorldLog:
    """Lines and counts.

    Attributes:
        digest: of all lines, so that two runs can be compared.
    """

    def __init__(self, loop: SimulatedLoop) -> None:
        self.faults: Counter[str] = Counter()
        self.commands: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.lines: deque[str] = deque(maxlen=_REMEMBERED)
        self.digest = 0
        self._loop = loop

    def tell(self, what: str) -> None:
        line = f"{self.stamp()} {what}"
        self.lines.append(line)
        self.digest = zlib.crc32(line.encode(), self.digest)

    def stamp(self) -> str:
        minutes, seconds = divmod(self._loop.time(), 60)
        hours, minutes = divmod(int(minutes), 60)
        return f"day {hours // 24} {hours % 24:02}:{minutes:02}:{seconds:06.3f}"

    def fault(self, name: str) -> None:
        self.faults[name] += 1

    def summary(self) -> str:
        return "\n".join(
            f"{counts.total():,} {what}: {', '.join(f'{count} {name}' for name, count in sorted(counts.items()))}"
            for what, counts in (("faults", self.faults), ("commands", self.commands))
        )
