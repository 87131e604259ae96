"""The history of the last 24 hours as immutable data, outages, tracks and gaps, and the command that asks for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from rsb_bridge.feature_api import Command, Event, Right

KEPT_FOR = 86400.0
"""s that are remembered."""
OUTAGES_AT_ONCE = 2000
"""Outages in one answer, the newest."""
ACTIONS_AT_ONCE = 500
"""Events in one answer, the newest."""
RATES_AT_ONCE = 48
"""Rates of one topic in one answer."""
LINK: Final = "link"
"""The kind of a link itself. For the kinds of routes see `rsb_bridge.model.session.Kind`."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A time in which a link or a route was not fine.

    Attributes:
        start: s since the epoch.
        seconds: its length, on a clock that nobody sets.
        topic: its name on this side, or empty for the link itself.
        outgoing: whether this side sends the topic.
        state: the worst `rsb_bridge.model.snapshot.State` in this time.
        cause: the first reason in words, and the last one if it differs.
        cut_off: whether the end is unknown, because the bridge stopped or the machine slept before.
        with_link: whether a topic was out because its link was out.
        kind: `LINK`, or the route's `rsb_bridge.model.session.Kind`.
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
        """Link, kind, topic and direction."""
        return self.link, self.kind, self.topic, self.outgoing


@dataclass(frozen=True, slots=True)
class Track:
    """A link's or a route's times, outages and rates in a span.

    Attributes:
        link: as in `Outage`.
        topic: as in `Outage`.
        outgoing: as in `Outage`.
        up: s in which it was fine.
        out: s in which it was not. The rest of the span was not recorded, or it was paused on purpose, or it waited.
        rates: mean rate in each part of the span, oldest first, or None if unknown: of a topic in Hz, of other routes
            in calls/s, of a link in bytes/s in both directions together.
        waiting: s before the first message without a fault, which count neither as up nor as out.
        waits_for: the reason why it waits now, or empty.
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
        """Link, kind, topic and direction."""
        return self.link, self.kind, self.topic, self.outgoing

    @property
    def up_ratio(self) -> float | None:
        """Share of the time in which it was fine, or None if it was never recorded as up or out."""
        known = self.up + self.out
        return self.up / known if known else None


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without a record, because the bridge did not run or the machine slept.

    Attributes:
        start: s since the epoch.
    """

    start: float
    seconds: float


@dataclass(frozen=True, slots=True)
class HistoryReport:
    """The history of a bridge in a span of time.

    Attributes:
        time: the end of the span, s since the epoch.
        running: whether the bridge still runs; if not, the report comes from its files.
        tracks: of each link and each route: first a link, then its routes.
        outages: the newest `OUTAGES_AT_ONCE`, oldest first.
        actions: events of operators and of the whole bridge, the newest `ACTIONS_AT_ONCE`, oldest first.
        outages_left_out: number of older outages.
        actions_left_out: number of older actions.
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
        """Recorded seconds of the span."""
        return max(0.0, self.span - sum(gap.seconds for gap in self.gaps))

    def of_link(self, link: str) -> HistoryReport:
        """Return the part about one link and about the bridge as a whole."""
        return replace(
            self,
            name=f"{link} at {self.name}",
            tracks=tuple(each for each in self.tracks if each.link == link),
            outages=tuple(each for each in self.outages if each.link == link),
            actions=tuple(each for each in self.actions if each.link in ("", link)),
        )


class ReportHistory(Command[HistoryReport], frozen=True, tag="history"):
    """Report the outages, rates and operators' commands of the last so many s, 24 h at most.

    Attributes:
        link: the link to report on, or an empty string for all.
    """

    right = Right.LOOK
    refreshes = False
    is_of_links = True
    seconds: float
    link: str = ""
