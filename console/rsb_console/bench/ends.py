"""What a benchmark sends through: the seam between what is measured and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from rsb_console.bench.results import Many, Run, Side


class BenchError(Exception):
    """What is to be measured cannot be; the message says why, and what to do."""


class StoppedError(Exception):
    """The peer, or the leave that it gives, ends the benchmark; the message says how. What was measured stands."""


class Ends(Protocol):
    """The two ends of one way for messages."""

    def send(self, rate: float, seconds: float, size: int) -> Run:
        """Send messages for a while, wait until no more comes, and say what came.

        Raises:
            BenchError: it cannot be done.
            StoppedError: nothing more may be sent.
        """
        ...

    def most(self, size: int, /) -> float:
        """The highest rate (Hz) that may be tried with messages of a size."""
        ...

    def wire(self, rate: float, seconds: float, size: int) -> Run | None:
        """As `send`, with the bytes on the wire, which may cost processor time; None: they cannot be seen."""
        ...

    def sides(self, idle: float) -> tuple[Side, Side]:
        """The sending and the receiving bridge as they are now.

        Args:
            idle: s for which nothing is sent, to see what they use then; 0: that is not measured.
        """
        ...


@dataclass(frozen=True, slots=True)
class Way:
    """One transport in one direction, as the client sees it."""

    transport: str
    direction: str


class Place(Protocol):
    """Where a benchmark is done: on this machine, or over a running bridge's link."""

    @property
    def ways(self) -> list[Way]:
        """What is measured there, in order."""
        ...

    def baseline(self, sizes: list[int]) -> AbstractContextManager[Ends] | None:
        """No bridge, to compare with; None: there is no such thing."""
        ...

    def open(self, way: Way, sizes: list[int]) -> AbstractContextManager[Ends]:
        """Set one up.

        Raises:
            BenchError: it cannot be done.
            StoppedError: it may not be done.
        """
        ...

    def many(self, count: int) -> Many | None:
        """What so many topics cost; None: that is not measured here."""
        ...
