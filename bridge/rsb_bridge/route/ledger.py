"""The ledger of a route's messages, which the sending side keeps and the receiver's counts complete.

The receiver's counts may be wrong. They are limited to the messages sent here, so that no part of the ledger is
negative and all parts add up.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.snapshot import Ledger
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.route.age import EXPIRED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.wire.records import ReceivedCounts, SentCounts

_OVERDUE_AFTER = 2.0
"""s after which an unreported message counts as lost, if its channel may lose any. Reports come each second, so that a
loss shows after 3 s."""
_MOST_CAUSES = 32
"""Causes of drops with a count of their own, as many as a report has room for (PROTOCOL.md, 3)."""
_OTHER = "other"
OUTAGE, KEEP_FULL = "outage", "keep full"
"""Left out of a queue: older than the topic promises to keep for a link that is away; beyond the bytes of `keep`."""
REPLACED = "replaced"
"""Left out of the queue of what may move a robot, as a newer message came before the link took it."""
THROTTLED = "throttled"
"""The receiver left these out, for the rate that it allows."""
CAUSES = {
    Refused.DISARMED: "disarmed",
    Refused.UNHEARD: "disarmed",
    Refused.TOO_OLD: EXPIRED,
    Refused.TOO_FAST: THROTTLED,
}
"""The causes under which messages count that a gate keeps back (`rsb_bridge.route.gates`)."""
INCOMPLETE = "incomplete"
"""The receiver gave these up because parts of them did not come."""
LOSSES: dict[str, tuple[Cause, str]] = {
    "queue full": (
        Cause.QUEUE_FULL,
        "more is published than the link carries: set max_rate, compression: zstd or priority",
    ),
    REPLACED: (
        Cause.QUEUE_FULL,
        "newer ones came before the link took them: set max_rate, compression: zstd or priority",
    ),
    "keep full": (
        Cause.QUEUE_FULL,
        "more waits for the link than there is room for: give its keep more megabytes",
    ),
    "too large": (
        Cause.TOO_LARGE,
        "they are larger than its transport carries",
    ),
    "publish failed": (Cause.NOT_PUBLISHED, "the receiving side cannot publish them; its log says why"),
    "latched full": (Cause.NOT_PUBLISHED, "the receiving side keeps no more latched messages for this link"),
    "slow subscriber": (Cause.NOT_PUBLISHED, "a subscriber there does not take its messages: restart it"),
    "malformed": (Cause.NOT_PUBLISHED, "they are malformed: see what publishes them"),
    "not changed": (
        Cause.NOT_PUBLISHED,
        "they cannot be changed as the receiving side's session asks: its log says why",
    ),
    "too complex": (Cause.NOT_PUBLISHED, "they have more strings and sequences than are checked there: send less"),
    "expands too much": (Cause.NOT_PUBLISHED, "they expand too much there: send less, or without compression"),
}
"""Of losses by their causes in the ledger: the cause in the verdict, and the explanation with the remedy."""
LOSS_CAUSES = frozenset({Cause.LOSSY, *(cause for cause, _ in LOSSES.values())})
_ON_THE_WAY, _LINK_LOST = "lost on the way", "link lost"
_LARGEST = 2**53
"""The largest count that is kept or sent; anything beyond it is a mistake."""


@dataclass(frozen=True, slots=True)
class _Counted:
    """The receiver's counts of one opening, limited to the messages sent.

    Attributes:
        plausible: whether the receiver's figures could be right, so that none was changed.
        whole: messages that arrived whole.
        delivered: whole messages that were published.
        dropped: whole messages that were dropped, by cause.
        expired: messages given up incomplete.
        incomplete: messages that wait for fragments.
        newest: the highest message number seen.
        settled: messages that were delivered, dropped or given up.
    """

    plausible: bool
    whole: int
    delivered: int
    dropped: dict[str, int]
    expired: int
    incomplete: int
    newest: int
    settled: int

    def lost(self, overdue: int = 0) -> int:
        """Return how many numbered messages are lost: newer ones arrived, or they are among the first `overdue`."""
        return max(0, max(self.newest, overdue) - self.whole - self.expired - self.incomplete)


def _within(report: ReceivedCounts, sent: int) -> _Counted:
    """Return a report's counts, each limited to `sent` minus the counts before it."""
    parts = report.delivered, *report.dropped.values(), report.expired, report.incomplete
    rest = sent - sum(parts)
    known_whole = report.delivered + sum(report.dropped.values())
    if min(parts) >= 0 and known_whole <= report.received <= known_whole + rest and 0 <= report.newest <= sent:
        return _Counted(
            True, report.received, report.delivered, report.dropped, report.expired, report.incomplete, report.newest,
            known_whole + report.expired,
        )  # fmt: skip
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
    known_whole = delivered + (sum(dropped.values()) if dropped else 0)
    whole = _limited(report.received, known_whole, known_whole + left)
    newest = _limited(report.newest, 0, sent)
    plausible = plausible and (whole, newest) == (report.received, report.newest)
    return _Counted(plausible, whole, delivered, dropped, expired, incomplete, newest, known_whole + expired)


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
        overdue: of numbered ones, how many had more than 2 s to arrive before that was counted.
        lost_as: the cause of what never arrived.
        marks: when (s) how many were sent, the oldest first.
        final: whether the receiver has counted all that it will: it has left with a goodbye.
    """

    route_id: int = 0
    instance: str = ""
    sent: int = 0
    counted: _Counted | None = None
    overdue: int = 0
    lost_as: str = _LINK_LOST
    final: bool = False
    marks: deque[tuple[float, int]] = field(default_factory=deque)


class RouteLedger:
    """Counts since the route was made.

    The receiver counts each opening from 0. Its counts after the last report on an opening come with the next opening's
    `Ready` (PROTOCOL.md, 3). Until then those messages are in flight; only messages that it never saw are lost.

    If the process that counted an opening has ended without a goodbye, the messages after its last report are
    `unknown`: neither delivered nor lost.

    Attributes:
        lossy: whether the channel may lose any message for good. Otherwise they are lost with the link.
        offered: messages taken from ROS.
        throttled: left out for the route's highest rate.
        expired: dropped here, because they were too old.
        unknown: sent to a process that ended before it reported whether they arrived.
        again: of `offered`, a latched topic's messages that were offered in an earlier opening, too.
        known_there: a latched topic's messages that were not offered: the peer has them from an earlier process.
    """

    def __init__(self) -> None:
        self.lossy = False
        self.offered = 0
        self.throttled = 0
        self.dropped: Counter[str] = Counter()
        self.unknown = self.again = self.known_there = 0
        self.expired = 0
        self._delivered = 0
        self._opening = _Opening()
        self._unsettled: _Opening | None = None

    @property
    def _missing_as(self) -> str:
        return _ON_THE_WAY if self.lossy else _LINK_LOST

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
        """Messages of the present opening that the receiver has seen, given up or skipped."""
        counted = self._opening.counted
        return max(counted.newest, counted.whole + counted.expired) if counted else 0

    def setbacks(self, untaken: Mapping[str, int]) -> tuple[int, ...]:
        """Return figures of which some grow with each message that does not arrive; `untaken` is as of `ledger`."""
        own = (
            self.throttled, self.expired, self.unknown, self.again, *self.dropped.values(), untaken[Untaken.LOST],
        )  # fmt: skip
        if (counted := self._opening.counted) is None:
            return own
        lost = counted.lost(self._opening.overdue) if self.lossy else 0
        return *own, *counted.dropped.values(), counted.expired, counted.incomplete, counted.plausible, lost

    def drop(self, cause: str, count: int) -> None:
        """Count messages dropped here."""
        if count:
            self.dropped[cause] += count

    def lose(self, cause: str, count: int) -> None:
        """Count messages dropped here before they were counted as offered."""
        self.offered += count
        self.drop(cause, count)

    def sent(self, count: int) -> None:
        """Count messages given to the channel."""
        self._opening.sent += count

    def opened(self, route_id: int, instance: str) -> None:
        """Begin a new opening.

        Args:
            instance: of the peer's process on the other side of it.
        """
        self.closed()
        self._opening = _Opening(route_id, instance)

    def closed(self) -> None:
        """End the opening."""
        # An opening without messages does not close the account of the one before, whose counts may still come.
        if self._opening.sent:
            # If an earlier one still waits for its counts, they will not come: a receiver keeps one opening's counts.
            self.settle(None, "")
            self._unsettled = self._opening
        self._opening = _Opening()

    def receiver_left(self) -> None:
        """Take the last report for final: the receiver sends it before its goodbye."""
        self._opening.final = True

    def disarmed(self) -> None:
        """Count messages of the present opening that have not arrived as disarmed: the receiver drops them."""
        self._opening.lost_as = "disarmed"

    def reported(self, report: ReceivedCounts, now: float, delay: float = 0.0) -> bool:
        """Take what the receiver counted in the present opening.

        Args:
            delay: s that a message and its report take together; a younger message is not lost.

        Returns:
            Whether its figures are possible; impossible ones are limited to the messages sent.
        """
        opening = self._opening
        opening.counted = _within(report, opening.sent)
        if self.lossy:
            opening.marks.append((now, opening.sent))
            # This ends at the mark that was just added, at the latest.
            while now - opening.marks[0][0] >= _OVERDUE_AFTER + delay:
                opening.overdue = opening.marks.popleft()[1]
        return opening.counted.plausible

    def settle(self, final: ReceivedCounts | None, instance: str) -> bool:
        """Close the account of the last opening in which anything was sent.

        Args:
            final: the receiver's counts of the last opening in which it got anything, or None.
            instance: of the peer's process. If the opening was with another process, what that process did not report
                is unknown. If `final` is of another opening, the last report of the opening itself counts, and the rest
                is lost.

        Returns:
            Whether the figures are possible.
        """
        opening, self._unsettled = self._unsettled, None
        if opening is None:
            return True
        counted, plausible = opening.counted, True
        same_process = instance == opening.instance
        if final is not None and same_process and final.route == opening.route_id:
            counted = _within(final, opening.sent)
            plausible = counted.plausible
        elif final is None and counted is not None and counted.whole:
            same_process = False  # the receiver has forgotten its counts
        left = opening.sent
        if counted is not None:
            self._delivered += counted.delivered
            self.dropped.update(counted.dropped)
            self.drop(INCOMPLETE, counted.expired)
            overtaken = counted.lost(opening.overdue)
            self.drop(self._missing_as, overtaken)
            left -= counted.settled + overtaken
        if same_process or opening.final:
            self.drop(opening.lost_as, left)
        else:
            self.unknown += left
        # The receiver names the causes, and must not make the table grow with each opening.
        self.dropped = _folded(self.dropped)
        return plausible

    def ledger(self, untaken: Mapping[str, int]) -> Ledger:
        """Return the balance; `untaken` has the messages that were not taken from ROS, by `Untaken`."""
        delivered, dropped = self._delivered, dict(self.dropped)  # a Counter takes ten times as long

        def drop(cause: str, count: int) -> None:
            dropped[cause] = dropped.get(cause, 0) + count

        in_flight = 0
        for opening in (self._opening, self._unsettled):
            if opening is None:
                continue
            in_flight += opening.sent
            if opening.counted is not None:
                delivered += opening.counted.delivered
                if opening.counted.expired:
                    drop(INCOMPLETE, opening.counted.expired)
                for cause, count in opening.counted.dropped.items():
                    drop(cause, count)
                if lost := opening.counted.lost(opening.overdue):
                    drop(self._missing_as, lost)
                in_flight -= opening.counted.settled + lost
        # The receiver lists these among its drops; here they have parts of their own.
        throttled = self.throttled + dropped.pop(THROTTLED, 0)
        expired = self.expired + dropped.pop(EXPIRED, 0)
        accounted = delivered + expired + throttled + self.unknown + sum(dropped.values())
        return Ledger(
            offered=self.offered,
            delivered=delivered,
            throttled=throttled,
            expired=expired,
            waiting=self.offered - accounted - in_flight,
            in_flight=in_flight,
            dropped=dropped if len(dropped) <= _MOST_CAUSES else dict(_folded(Counter(dropped))),
            unknown=self.unknown,
            lost_in_dds=untaken.get(Untaken.LOST, 0),
            missed_while_down=untaken.get(Untaken.MISSED, 0),
            unsubscribed=untaken.get(Untaken.UNSUBSCRIBED, 0) + self.known_there,
            again=self.again,
        )


def reported_ledger(report: SentCounts, now: float) -> Ledger | None:
    """Return the ledger that a sender reports at `now` (s since the epoch), or None if its figures are impossible."""
    known = (report.delivered, report.throttled, report.expired, *report.dropped.values())
    parts = (*known, report.unknown, report.waiting, report.in_flight)
    figures = (*parts, report.lost_in_dds, report.missed_while_down, report.unsubscribed, report.again)
    if sum(parts) != report.offered or min(figures) < 0 or max(figures) > _LARGEST:
        return None
    return Ledger(
        offered=report.offered,
        delivered=report.delivered,
        throttled=report.throttled,
        expired=report.expired,
        waiting=report.waiting,
        waiting_since=now - report.waited if 0 < report.waited < _LARGEST else None,
        in_flight=report.in_flight,
        dropped=report.dropped,
        unknown=report.unknown,
        lost_in_dds=report.lost_in_dds,
        missed_while_down=report.missed_while_down,
        unsubscribed=report.unsubscribed,
        again=report.again,
    )


def _folded(dropped: Counter[str]) -> Counter[str]:
    """At most `_MOST_CAUSES` causes; the rarest are counted together."""
    if len(dropped) <= _MOST_CAUSES:
        return dropped
    folded = Counter(dict(dropped.most_common(_MOST_CAUSES - 1)))
    folded[_OTHER] += dropped.total() - folded.total()
    return folded
