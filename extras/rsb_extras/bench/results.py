"""The results of a benchmark as plain data, and the ends that it measures between."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias

import msgspec

from rsb_bridge.model.text import escape_json
from rsb_extras.demo.processes import ProcessError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

Limit: TypeAlias = Literal["loss", "sender", "leave", "time"]
"""End of a search for the highest rate: a loss, the sender's limit, the peer's limits, or the end of the time."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of messages of one size.

    Attributes:
        size: bytes of payload of each message.
        rate: Hz that the sender reached.
        p50: median latency in ms.
        p99: 99th percentile of the latency in ms.
        p999: 99.9th percentile of the latency in ms.
        sides: processor time in seconds of the sending and the receiving bridge.
        wire: bytes that the sending bridge handed to its sockets, or None if unknown.
        topic: its topic in the recordings, or an empty string if it is in none.
    """

    size: int
    sent: int
    received: int
    rate: float
    p50: float
    p99: float
    p999: float = 0.0
    sides: tuple[float, float] = (0.0, 0.0)
    wire: int | None = None
    topic: str = ""

    @property
    def lossless(self) -> bool:
        return self.received >= self.sent

    @property
    def wire_per_byte(self) -> float | None:
        """Bytes on the wire for each byte of payload."""
        return self.wire / (self.size * self.sent) if self.wire and self.sent else None


@dataclass(frozen=True, slots=True)
class Point:
    """The figures of one transport for messages of one size in one direction.

    Attributes:
        transport: ``tcp``, ``udp`` or ``bluetooth``; in developers' comparisons, any name.
        direction: direction as the client sees it.
        size: bytes of payload.
        gentle: the run at a low rate, for the latency.
        base: latency (p50, p99, p99.9 in ms) without a bridge, or None if it was not measured.
        best: run at the highest rate without loss, or None if every run had losses.
        limit: reason why no higher rate was found.
        full: run at a rate that is too high, or None.
        paced: runs at fixed rates up to that of `best`, for the latencies.
    """

    transport: str
    direction: str
    size: int
    gentle: Run
    base: tuple[float, float, float] | None
    best: Run | None
    limit: Limit
    full: Run | None = None
    paced: tuple[Run, ...] = ()

    @property
    def runs(self) -> list[Run]:
        return [run for run in (self.gentle, self.best, self.full, *self.paced) if run is not None]

    @property
    def added(self) -> tuple[float, float, float]:
        """Latency in ms that the bridge adds, or the whole latency without a comparison."""
        base = self.base or (0.0, 0.0, 0.0)
        ours = (self.gentle.p50, self.gentle.p99, self.gentle.p999)
        return ours[0] - base[0], ours[1] - base[1], ours[2] - base[2]


@dataclass(frozen=True, slots=True)
class Side:
    """One bridge process.

    Attributes:
        listening: seconds from its start until it listens, or None if not measured.
        first: seconds from its start until the first message was through, or None if not measured.
        idle: % of a core while nothing crosses, or None if not measured.
        memory: MB at the end of the benchmark.
    """

    memory: float
    idle: float | None = None
    listening: float | None = None
    first: float | None = None


@dataclass(frozen=True, slots=True)
class Many:
    """Many topics at once, each at 1 Hz.

    Attributes:
        opened: seconds from the start of the client's bridge until all topics carry messages.
        memory: MB of the sending and the receiving bridge.
        cpu: % of a core of the sending and the receiving bridge.
    """

    count: int
    opened: float
    memory: tuple[float, float]
    cpu: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Load:
    """A topic that an operator wants to bridge.

    Attributes:
        size: bytes of a message.
        transport: transport that carries it, or an empty string for any.
        direction: direction as the client sees it, or an empty string for any.
    """

    topic: str
    size: float
    rate: float
    transport: str = ""
    direction: str = ""


@dataclass(frozen=True, slots=True)
class Judged:
    """The verdict on a topic: whether a link carries it.

    Attributes:
        transport: transport for which it was judged.
        share: the topic's rate as a share of the highest rate of such messages, from 0.
        verdict: ``carried``, ``barely``, ``not``, or ``unknown`` if no high enough rate was tried.
        at_most: whether the share is only an upper bound, because time or the peer's limits ended the search early.
    """

    load: Load
    transport: str
    share: float
    verdict: Literal["carried", "barely", "not", "unknown"]
    at_most: bool = False


@dataclass(slots=True)
class BenchReport:
    """All results. It is filled while the benchmark runs, so that an interrupted one keeps its results so far.

    Attributes:
        version: version of this format.
        over: the measured link, in words.
        machine: processor and cores.
        points: figures by transport, direction and size.
        sides: the sending and the receiving bridge, by transport.
        many: figures with many topics.
        judged: verdicts on the session's topics, or on usual ones.
        notes: parts that were not measured or not recorded, with reasons.
        recordings: paths of the talker's and the listener's recording, or empty if there are none.
        ended: ``complete``, ``interrupted``, ``time``, or ``stopped`` by the peer or its limits.
    """

    over: str
    machine: str
    version: int = 1
    points: list[Point] = field(default_factory=list)
    sides: dict[str, tuple[Side, Side]] = field(default_factory=dict)
    many: list[Many] = field(default_factory=list)
    judged: list[Judged] = field(default_factory=list)
    verdict: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)
    ended: Literal["complete", "interrupted", "time", "stopped"] = "complete"


def as_json(report: BenchReport) -> str:
    """Format a report as one line of JSON."""
    return escape_json(msgspec.json.encode(report).decode())


class BenchError(ProcessError):
    """A benchmark that cannot be run; the message gives the reason and the remedy."""


class StoppedError(Exception):
    """The peer, or its limits, ended a benchmark; the message has the reason. Results so far are kept."""


class BenchEnds(Protocol):
    """The two ends between which messages are measured."""

    def send(self, rate: float, seconds: float, size: int, part: str = "") -> Run:
        """Send messages for a while, wait until no more come, and return the counts.

        Args:
            part: what the run is for, if a recording is to have it: a word of its topic there.

        Raises:
            BenchError: the run fails.
            StoppedError: nothing more may be sent.
        """

    def most(self, size: int, /) -> float:
        """Return the highest rate (Hz) that may be tried with messages of a size."""

    def wire(self, rate: float, seconds: float, size: int) -> Run | None:
        """Do as `send` and count the bytes on the wire, at some cost in time; None if they cannot be counted."""

    def sides(self, idle: float) -> tuple[Side, Side]:
        """Return the present figures of the sending and the receiving bridge.

        Args:
            idle: seconds without messages to measure their idle use, or 0 to skip that.
        """


@dataclass(frozen=True, slots=True)
class Way:
    """One transport in one direction, as the client sees it."""

    transport: str
    direction: str


class BenchPlace(Protocol):
    """The place of a benchmark: this machine, or a running bridge's link."""

    @property
    def ways(self) -> list[Way]:
        """Return the transports and directions to measure, in order."""

    def baseline(self, sizes: list[int]) -> AbstractContextManager[BenchEnds] | None:
        """Open the ends without a bridge for comparison, or return None if that is impossible."""

    def open(self, way: Way, sizes: list[int]) -> AbstractContextManager[BenchEnds]:
        """Set up the ends for one transport and direction.

        Raises:
            BenchError: it cannot be done.
            StoppedError: it may not be done.
        """

    def many(self, count: int) -> Many | None:
        """Measure the cost of `count` topics, or return None if this place cannot."""
