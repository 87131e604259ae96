"""Where a route's messages went: the ledger as the sending side keeps it, with the receiver's counts taken in.

The receiver's counts are another process's word. They are brought within what was sent here, so whatever they say, no
part of the ledger is negative and all parts add up.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Ledger

if TYPE_CHECKING:
    from rsb_bridge.wire.records import ReceivedReport, SentReport

_OVERDUE_AFTER = 2.0
_MOST_CAUSES = 32
"""Of drops, each with a count of its own; a report has no room for more (PROTOCOL.md, 3)."""
_OTHER = "other"
THROTTLED = "throttled"
"""The receiver left these out, for the rate that it allows."""
_LARGEST = 2**53
"""The largest count that is kept or sent; anything beyond it is a mistake."""


@dataclass(frozen=True, slots=True)
class _Counted:
    """What the receiver counted of one opening, within what was sent.

    Attributes:
        plausible: the receiver's figures could be right, and none was changed.
        whole: messages that arrived whole.
        delivered: of those, published.
        dropped: of those, by cause.
        expired: given up incomplete.
        incomplete: that wait for fragments.
        newest: the highest message number seen.
    """

    plausible: bool
    whole: int
    delivered: int
    dropped: dict[str, int]
    expired: int
    incomplete: int
    newest: int

    @property
    def settled(self) -> int:
        """Messages whose end is known."""
        return self.delivered + self.expired + sum(self.dropped.values())


def _within(report: ReceivedReport, sent: int) -> _Counted:
    """A report's counts, each limited to what is left of `sent` by those before it."""
    plausible, left = True, sent

    def take(count: int) -> int:
        nonlocal plausible, left
        taken = _limited(count, 0, left)
        plausible = plausible and taken == count
        left -= taken
        return taken

    delivered = take(report.delivered)
    dropped = {cause: take(count) for cause, count in report.dropped.items()}
    expired = take(report.expired)
    incomplete = take(report.incomplete)
    known_whole = delivered + sum(dropped.values())
    whole = _limited(report.received, known_whole, known_whole + left)
    newest = _limited(report.newest, 0, sent)
    plausible = plausible and (whole, newest) == (report.received, report.newest)
    return _Counted(plausible, whole, delivered, dropped, expired, incomplete, newest)


def _limited(count: int, lowest: int, highest: int) -> int:
    return max(lowest, min(count, highest))


@dataclass(slots=True)
class _Opening:
    """The messages sent from one opening of the route to its end.

    Attributes:
        route_id: of the opening; the receiver counts by it.
        instance: of the peer's process that counts; ids are used again by the next one.
        sent: messages given to the channel.
        counted: what the receiver last reported.
        overdue: of those sent, how many had more than 2 s to arrive before that was counted.
        lost_as: the cause of what never arrived.
        marks: when (s) how many were sent, the oldest first.
    """

    route_id: int = 0
    instance: str = ""
    sent: int = 0
    counted: _Counted | None = None
    overdue: int = 0
    lost_as: str = "link lost"
    marks: deque[tuple[float, int]] = field(default_factory=deque)


class RouteLedger:
    """Counts since the route was made.

    The receiver counts each opening anew. What it counted after its last report on an opening comes with the next one's
    `Ready` (PROTOCOL.md, 3); until then those messages are in flight, and only what it never saw is lost.

    Attributes:
        offered: messages taken from ROS.
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
        self._opening = _Opening()
        self._unsettled: _Opening | None = None

    @property
    def sent_now(self) -> int:
        """Messages given to the channel in the present opening."""
        return self._opening.sent

    @property
    def received_now(self) -> int:
        """Messages of the present opening that arrived, as the receiver last said."""
        return self._opening.counted.whole if self._opening.counted else 0

    @property
    def delivered_now(self) -> int:
        """Messages of the present opening that were published, as the receiver last said."""
        return self._opening.counted.delivered if self._opening.counted else 0

    @property
    def reported_now(self) -> int:
        """Messages of the present opening that the receiver has seen, given up, or seen newer ones of."""
        counted = self._opening.counted
        return max(counted.newest, counted.whole + counted.expired) if counted else 0

    def drop(self, cause: str, count: int) -> None:
        """Count messages dropped here."""
        if count:
            self.dropped[cause] += count

    def sent(self, count: int) -> None:
        """Count messages given to the channel."""
        self._opening.sent += count

    def opened(self, route_id: int, instance: str) -> None:
        """A new opening begins.

        Args:
            route_id: of the opening.
            instance: of the peer's process on the other side of it.
        """
        self.closed()
        self._opening = _Opening(route_id, instance)

    def closed(self) -> None:
        """The opening is over."""
        if self._opening.sent:
            self.settle(None, "")
            self._unsettled = self._opening
        self._opening = _Opening()

    def disarmed(self) -> None:
        """What has not arrived in the present opening is not to be published any more."""
        self._opening.lost_as = "disarmed"

    def reported(self, report: ReceivedReport, now: float, delay: float = 0.0) -> bool:
        """Take what the receiver counted in the present opening.

        Args:
            report: of the receiver.
            now: s.
            delay: s that a message and the report on it take; what is under way for so long is not lost.

        Returns:
            Whether its figures could be right; those that could not are limited to what was sent.
        """
        opening = self._opening
        opening.counted = _within(report, opening.sent)
        opening.marks.append((now, opening.sent))
        while now - opening.marks[0][0] >= _OVERDUE_AFTER + delay:
            opening.overdue = opening.marks.popleft()[1]
        return opening.counted.plausible

    def settle(self, final: ReceivedReport | None, instance: str) -> bool:
        """Close the account of the last opening in which anything was sent.

        Args:
            final: what the receiver counted in the last opening in which it got anything; None: it knows of none.
            instance: of the peer's process that says so. Where it is not the one that the opening was with, or the
                report is of another opening, the last report of that opening itself counts.

        Returns:
            Whether the figures could be right.
        """
        opening, self._unsettled = self._unsettled, None
        if opening is None:
            return True
        counted, plausible = opening.counted, True
        if final is not None and (final.route, instance) == (opening.route_id, opening.instance):
            counted = _within(final, opening.sent)
            plausible = counted.plausible
        lost = opening.sent
        if counted is not None:
            self._delivered += counted.delivered
            self._expired += counted.expired
            self.dropped.update(counted.dropped)
            lost -= counted.settled
        self.drop(opening.lost_as, lost)
        self.dropped = _folded(self.dropped)
        return plausible

    def ledger(self, lost_in_dds: int, *, numbered: bool) -> Ledger:
        """The balance.

        Args:
            lost_in_dds: beyond those in `lost_in_dds`.
            numbered: whether the channel numbers its messages and may lose them.
        """
        delivered, expired, dropped = self._delivered, self._expired, self.dropped.copy()
        for opening in (self._opening, self._unsettled):
            if opening is not None and opening.counted is not None:
                delivered += opening.counted.delivered
                expired += opening.counted.expired
                if opening.counted.dropped:
                    dropped.update(opening.counted.dropped)
        if numbered and (lost := self._lost()):
            dropped["lost on the way"] += lost
        throttled = self.throttled + dropped.pop(THROTTLED, 0)
        accounted = delivered + expired + throttled + dropped.total()
        return Ledger(
            offered=self.offered,
            delivered=delivered,
            throttled=throttled,
            expired=expired,
            in_flight=self.offered - accounted,
            dropped=dict(_folded(dropped)),
            lost_in_dds=min(self.lost_in_dds + lost_in_dds, _LARGEST),
        )

    def _lost(self) -> int:
        """Messages of the present opening that the receiver has seen newer ones of, or that are long overdue."""
        counted = self._opening.counted
        if counted is None:
            return 0
        passed = max(counted.newest, self._opening.overdue)
        return max(0, passed - counted.whole - counted.expired - counted.incomplete)


def reported_ledger(report: SentReport) -> Ledger | None:
    """The sender's ledger as it reports it; None: its figures cannot be right."""
    parts = (report.delivered, report.throttled, report.expired, report.in_flight, *report.dropped.values())
    if sum(parts) != report.offered or not all(0 <= part <= _LARGEST for part in (*parts, report.lost_in_dds)):
        return None
    return Ledger(
        offered=report.offered,
        delivered=report.delivered,
        throttled=report.throttled,
        expired=report.expired,
        in_flight=report.in_flight,
        dropped=report.dropped,
        lost_in_dds=report.lost_in_dds,
    )


def _folded(dropped: Counter[str]) -> Counter[str]:
    """At most `_MOST_CAUSES` causes; the rarest are counted together."""
    if len(dropped) <= _MOST_CAUSES:
        return dropped
    folded = Counter(dict(dropped.most_common(_MOST_CAUSES - 1)))
    folded[_OTHER] += dropped.total() - folded.total()
    return folded
