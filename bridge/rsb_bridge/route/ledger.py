"""Where a route's messages went: the ledger as the sending side keeps it, with the receiver's counts taken in."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Ledger

if TYPE_CHECKING:
    from rsb_bridge.wire.records import ReceivedReport

_OVERDUE_AFTER = 2.0


@dataclass(slots=True)
class _Opening:
    """The messages sent from one opening of the route to its end.

    Attributes:
        route_id: names it; the other side counts by it.
        sent: to the path.
        report: what the receiver last counted.
        overdue: of those sent, how many had more than 2 s to arrive before that was counted.
        marks: when (s) how many were sent, the oldest first.
    """

    route_id: int
    sent: int = 0
    report: ReceivedReport | None = None
    overdue: int = 0
    marks: deque[tuple[float, int]] = field(default_factory=deque)


class RouteLedger:
    """Counts since the route was made.

    The receiver counts each opening anew. What it counted after its last report on an opening comes with the next one's
    `Ready` (PROTOCOL.md, 3); until then those messages are in flight, and only what it never saw is lost.

    Attributes:
        offered: taken from ROS.
        throttled: left out for the route's highest rate.
        dropped: here, by cause.
        lost_in_dds: lost before they could be taken.
    """

    def __init__(self) -> None:
        self.offered = 0
        self.throttled = 0
        self.dropped: Counter[str] = Counter()
        self.lost_in_dds = 0
        self._delivered = 0
        self._expired = 0
        self._opening = _Opening(0)
        self._unsettled: _Opening | None = None

    @property
    def report(self) -> ReceivedReport | None:
        """What the receiver last said of the present opening."""
        return self._opening.report

    @property
    def sent_now(self) -> int:
        """Messages given to the path in the present opening."""
        return self._opening.sent

    @property
    def overdue(self) -> int:
        """Messages of the present opening that have arrived by the receiver's last report or never will."""
        return self._opening.overdue

    def drop(self, cause: str, count: int) -> None:
        """Count messages dropped here."""
        if count:
            self.dropped[cause] += count

    def sent(self, count: int) -> None:
        """Count messages given to the path."""
        self._opening.sent += count

    def opened(self, route_id: int) -> None:
        """A new opening begins."""
        self._opening = _Opening(route_id)

    def closed(self) -> None:
        """The opening is over."""
        if self._opening.sent:
            self._unsettled = self._opening
        self._opening = _Opening(0)

    def reported(self, report: ReceivedReport, now: float) -> None:
        """The receiver says, at `now` (s), what it counted in the present opening."""
        opening = self._opening
        opening.report = report
        opening.marks.append((now, opening.sent))
        while now - opening.marks[0][0] >= _OVERDUE_AFTER:
            opening.overdue = opening.marks.popleft()[1]

    def settle(self, final: ReceivedReport | None) -> None:
        """The receiver says what it counted in the last opening in which it got anything; None: it knows of none."""
        opening, self._unsettled = self._unsettled, None
        if opening is None:
            return
        report = final if final is not None and final.route == opening.route_id else opening.report
        lost = opening.sent
        if report is not None:
            self._delivered += report.delivered
            self._expired += report.expired
            self.dropped.update(report.dropped)
            lost -= report.delivered + report.expired + sum(report.dropped.values())
        self.drop("link lost", lost)

    def ledger(self, lost_in_dds: int, passed: int) -> Ledger:
        """The balance.

        Args:
            lost_in_dds: beyond those in `lost_in_dds`.
            passed: messages of the present opening that have arrived by now or never will.
        """
        delivered, expired, dropped = self._delivered, self._expired, Counter(self.dropped)
        for opening in (self._opening, self._unsettled):
            if opening is not None and opening.report is not None:
                delivered += opening.report.delivered
                expired += opening.report.expired
                dropped.update(opening.report.dropped)
        if (report := self._opening.report) is not None:
            lost = passed - report.received - report.expired - report.incomplete
            if lost > 0:
                dropped["lost on the way"] += lost
        accounted = delivered + expired + self.throttled + dropped.total()
        return Ledger(
            offered=self.offered,
            delivered=delivered,
            throttled=self.throttled,
            expired=expired,
            in_flight=max(0, self.offered - accounted),
            dropped=dict(dropped),
            lost_in_dds=self.lost_in_dds + lost_in_dds,
        )
