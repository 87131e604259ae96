"""What the engine remembers of the last 24 hours: immutable data, as an answer to a question."""

from __future__ import annotations

from dataclasses import dataclass

from rsb_bridge.model.snapshot import Event  # noqa: TC001 -- these types must be known where an answer is decoded

KEPT_FOR = 86400.0
"""s that are remembered."""
OUTAGES_AT_ONCE = 2000
"""Outages in one answer, the newest."""
ACTIONS_AT_ONCE = 500
"""Events in one answer, the newest."""
RATES_AT_ONCE = 48
"""Rates of one topic in one answer."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A time in which a link or a topic was not fine.

    Attributes:
        start: s since the epoch.
        seconds: how long; on a clock that nobody sets.
        link: the peer's name.
        topic: its name on this side; empty: the link itself.
        outgoing: True: this side sends the topic.
        state: the worst `rsb_bridge.model.snapshot.State` that it was in.
        cause: why, in words: the first ones, and the last ones if they say something else.
        ongoing: it has not ended yet.
        cut_off: the bridge stopped, or the machine slept, before it ended: the end is not known.
        with_link: a topic that was out because its link was.
    """

    start: float
    seconds: float
    link: str
    topic: str
    outgoing: bool
    state: str
    cause: str
    ongoing: bool = False
    cut_off: bool = False
    with_link: bool = False


@dataclass(frozen=True, slots=True)
class Track:
    """How a link or a topic did.

    Attributes:
        link: as in `Outage`, likewise the next two.
        topic: likewise.
        outgoing: likewise.
        up: s in which it was fine.
        out: s in which it was not. What is missing to the whole span is not known, or it was paused on purpose.
        outages: how many.
        rates: mean rate in each part of the span, oldest first: a topic's in Hz, a link's in bytes/s, both ways
            together. None: not known.
    """

    link: str
    topic: str
    outgoing: bool
    up: float
    out: float
    outages: int
    rates: tuple[float | None, ...] = ()

    @property
    def up_ratio(self) -> float | None:
        """The part of the time in which it was fine; None: it is not known of any time."""
        known = self.up + self.out
        return self.up / known if known else None


@dataclass(frozen=True, slots=True)
class Gap:
    """A time of which nothing is known: the bridge did not run, or the machine slept.

    Attributes:
        start: s since the epoch.
        seconds: how long.
    """

    start: float
    seconds: float


@dataclass(frozen=True, slots=True)
class HistoryReport:
    """What happened in a span of time.

    Attributes:
        name: of the session.
        role: ``client`` or ``server``.
        time: the end of the span, s since the epoch.
        span: how long it is, s.
        running: whether the bridge still runs; else this comes from its files.
        tracks: of each link and each topic: first a link, then its topics.
        outages: by their start; the newest ones, if there are more.
        actions: what operators did, and what concerns the whole bridge, oldest first; likewise.
        gaps: oldest first.
        outages_left_out: how many more there were.
        actions_left_out: how many more there were.
    """

    name: str
    role: str
    time: float
    span: float
    running: bool
    tracks: tuple[Track, ...] = ()
    outages: tuple[Outage, ...] = ()
    actions: tuple[Event, ...] = ()
    gaps: tuple[Gap, ...] = ()
    outages_left_out: int = 0
    actions_left_out: int = 0

    @property
    def start(self) -> float:
        """The beginning of the span, s since the epoch."""
        return self.time - self.span

    @property
    def watched(self) -> float:
        """Seconds of the span of which something is known."""
        return max(0.0, self.span - sum(gap.seconds for gap in self.gaps))
