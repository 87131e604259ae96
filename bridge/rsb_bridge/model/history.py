"""What the engine remembers of the last 24 hours: immutable data, as an answer to a question."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rsb_bridge.model.snapshot import Event  # noqa: TC001 -- these types must be known where an answer is decoded

KEPT_FOR = 86400.0
"""s that are remembered."""
OUTAGES_AT_ONCE = 2000
"""Outages in one answer, the newest."""
ACTIONS_AT_ONCE = 500
"""Events in one answer, the newest."""
RATES_AT_ONCE = 48
"""Rates of one topic in one answer."""
LINK: Final = "link"
"""The kind of a link itself; the others are those of `rsb_bridge.model.session.Kind`."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A time in which a link, or a topic or whatever else a route carries, was not fine.

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
        kind: what it is: `LINK`, or what the topic is, a `rsb_bridge.model.session.Kind`.
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
    kind: str = "topic"

    @property
    def subject(self) -> tuple[str, str, str, bool]:
        """Tells whose it is: link, kind, topic and direction."""
        return self.link, self.kind, self.topic, self.outgoing


@dataclass(frozen=True, slots=True)
class Track:
    """How a link or a topic did, or a service and the like.

    Attributes:
        link: as in `Outage`, likewise the next two.
        topic: likewise.
        outgoing: likewise.
        up: s in which it was fine.
        out: s in which it was not. What is missing to the whole span is not known, or it was paused on purpose, or
            waited.
        outages: how many.
        rates: mean rate in each part of the span, oldest first: a topic's in Hz, in calls/s of what is called, a
            link's in bytes/s, both ways together. None: not known.
        waiting: s in which no message had come yet, and no fault was known: neither up nor out.
        waits_for: what it waits for now, in words; empty: it does not wait.
        kind: as in `Outage`.
    """

    link: str
    topic: str
    outgoing: bool
    up: float
    out: float
    outages: int
    rates: tuple[float | None, ...] = ()
    waiting: float = 0.0
    waits_for: str = ""
    kind: str = "topic"

    @property
    def subject(self) -> tuple[str, str, str, bool]:
        """As `Outage.subject`."""
        return self.link, self.kind, self.topic, self.outgoing

    @property
    def up_ratio(self) -> float | None:
        """The part of the time in which it was fine; None: it was neither fine nor out at any time that is known."""
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
