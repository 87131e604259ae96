"""The results of a benchmark as plain data, and the ends that it measures between."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias

import msgspec

from rsb_bridge.model.text import escape_json
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

Limit: TypeAlias = Literal["loss", "sender", "leave", "time"]
"""Why a search for the highest rate ended: more is lost, the sender or the peer's leave has no more, time is up."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of messages of one size.

    Attributes:
        size: bytes of payload of each.
        sent: messages.
        received: messages.
        rate: Hz that the sender reached.
        p50: ms, of the latency, likewise those below.
        p99: ms.
        p999: ms.
        sides: s of processor time that the sending and the receiving bridge used.
        wire: bytes that the sending bridge handed to its sockets, or that is not known.
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

    @property
    def lossless(self) -> bool:
        return self.received >= self.sent

    @property
    def cpu(self) -> float:
        """Processor time (s) of what is between, all of it."""
        return sum(self.sides)

    @property
    def cpu_per_message(self) -> float:
        """µs."""
        return self.cpu / self.sent * 1e6

    @property
    def delivered(self) -> float:
        """Messages a second that came."""
        return self.rate * self.received / self.sent if self.sent else 0.0

    @property
    def wire_per_byte(self) -> float | None:
        """Bytes on the wire for each byte of payload."""
        return self.wire / (self.size * self.sent) if self.wire and self.sent else None


@dataclass(frozen=True, slots=True)
class Point:
    """What one transport does with messages of one size, in one direction.

    Attributes:
        transport: ``tcp``, ``udp`` or ``bluetooth``; of developers' comparisons, any name.
        direction: as the client sees it.
        size: bytes of payload.
        gentle: the run at a low rate, for the latency.
        base: the latency (p50, p99, p99.9 in ms) without a bridge; None: there is none to compare with.
        best: the run at the highest rate at which nothing was lost; None: none was found.
        limit: why no higher rate was found.
        full: the run at a rate that is too high; None: there was none.
    """

    transport: str
    direction: str
    size: int
    gentle: Run
    base: tuple[float, float, float] | None
    best: Run | None
    limit: Limit
    full: Run | None = None

    @property
    def added(self) -> tuple[float, float, float]:
        """What the bridge adds to the latency (ms): all of it where there is nothing to compare with."""
        base = self.base or (0.0, 0.0, 0.0)
        ours = (self.gentle.p50, self.gentle.p99, self.gentle.p999)
        return ours[0] - base[0], ours[1] - base[1], ours[2] - base[2]


@dataclass(frozen=True, slots=True)
class Side:
    """One bridge process.

    Attributes:
        listening: s from its start until it listens; None: not measured.
        first: s from its start until the first message was through; None: not measured.
        idle: % of a core while nothing crosses; None: not measured.
        memory: MB, after everything.
    """

    memory: float
    idle: float | None = None
    listening: float | None = None
    first: float | None = None


@dataclass(frozen=True, slots=True)
class Many:
    """Many topics at once, each at 1 Hz.

    Attributes:
        count: of topics.
        opened: s from the start of the client's bridge until all of them carry messages.
        memory: MB of the sending and the receiving bridge.
        cpu: % of a core, likewise.
    """

    count: int
    opened: float
    memory: tuple[float, float]
    cpu: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Load:
    """A topic that somebody wants to bridge.

    Attributes:
        topic: its name.
        size: bytes of a message.
        rate: Hz.
        transport: that carries it; empty: any.
        direction: as the client sees it; empty: any.
    """

    topic: str
    size: float
    rate: float
    transport: str = ""
    direction: str = ""


@dataclass(frozen=True, slots=True)
class Judged:
    """Whether a link carries a topic.

    Attributes:
        load: the topic.
        transport: by which it was judged.
        share: of what the link carries of such messages at most, from 0.
        verdict: ``carried``, ``barely``, ``not``, or ``unknown``: no rate that is high enough was tried.
        at_most: the share may be smaller, because the time or the peer's leave ended the search for a higher rate.
    """

    load: Load
    transport: str
    share: float
    verdict: Literal["carried", "barely", "not", "unknown"]
    at_most: bool = False


@dataclass(slots=True)
class Report:
    """All that was measured. It is filled while the benchmark runs, so that an interrupted one has what there was.

    Attributes:
        version: of this form.
        over: what was measured, in words.
        machine: processor, cores and Python.
        points: by transport, direction and size.
        sides: by transport, the sending and the receiving bridge.
        many: with many topics.
        judged: the session's topics, or usual ones.
        verdict: in words.
        notes: what was not measured, and why.
        ended: ``complete``, ``interrupted``, ``time`` or ``stopped``: by the peer or its leave.
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
    ended: Literal["complete", "interrupted", "time", "stopped"] = "complete"


def as_json(report: Report) -> str:
    """A report as one line of JSON."""
    return escape_json(msgspec.json.encode(report).decode())


def from_json(text: str) -> Report:
    """The inverse of `as_json`.

    Raises:
        msgspec.ValidationError: it is no report.
    """
    return msgspec.json.decode(text, type=Report)


class BenchProblem(Wording):
    """Reasons why a benchmark cannot be run, or ends."""

    NO_ANSWER = "a bridge on this machine does not answer: {problem}"
    SILENT = "the bridge has not answered for {seconds:.0f} s"
    NO_SERVER = "the server of the benchmark does not start"
    NOTHING_ARRIVES = "nothing gets through: is ROS set up, and are both domains free of what filters it?"
    NOT_OPEN = "{count} topics are not open within {seconds:.0f} s"
    NO_ROS = "no ROS here: source its setup file, or install rsb-console[ros]"
    NO_ROUTER = "the Zenoh router does not start: pip install 'rsb-console[zenoh]'"
    NO_PORT = "no port is free"
    PROCESS_ENDED = "{name} has ended by itself"
    ROBOTS_ENDED = "a process of robots has ended by itself"
    ROBOTS_LATE = "{late} of {count} robots are not ready within {seconds:.0f} s: {name}"


class BenchError(Exception):
    """A benchmark that cannot be run; the message gives the reason and the remedy."""


class StoppedError(Exception):
    """A benchmark that the peer, or its permission, has ended; the message says how. Results so far are kept."""


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
