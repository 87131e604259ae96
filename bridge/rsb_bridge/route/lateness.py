"""Decides whether a topic's messages are late, and words the verdict.

The receiving half measures how long messages take by the other side's clock, less the uncertainty of that clock. The
sending half needs no other clock: it knows how long messages have waited in its queue, and how long ago it sent the
oldest message that the receiver has not reported. So it notices lateness even if nothing arrives.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict

if TYPE_CHECKING:
    from rsb_bridge.model.capacity import Fullness

# Numbers without a source are round figures: nothing was measured.

# Of the watch.
_TICKS = 2  # that have to agree before a topic becomes late, or is no longer late: one bad second is no fault
_CLEARLY = 2.0  # times the bound: beyond that, one tick is enough, unless a clock that was set may explain it
_OVER = 0.8  # times the bound: below that, a late topic is on time again
# s without a message after which the last delay is outdated, or times the last gap between messages if that is longer,
# and s at the most: a topic with a message every 10 s must not be fine in between.
_REMEMBERED, _REMEMBERED_GAPS, _LONGEST_REMEMBERED = 5.0, 2.0, 60.0
_SAME = 0.15  # share by which a delay changes before the shown figure does, or the screens would change each second
_USUAL = 0.1  # weight of a new delay in the usual one
_USUAL_AFTER = 5  # delays in time that follow one before it is learned: trouble begins earlier than it is noticed

# Of the receiver's reports.
REPORTED_LATELY = 2.5  # s for which a reported delay counts: one report may be late or lost
_REPORTED_EVERY = 1.0  # s (`link.link.RouteReports`)
_LONGEST_DELAY = 3600.0  # s; a longer delay counts as a mistake, as in `telemetry.meters`
_LONGEST_UNDER_WAY = 60.0  # s; a message that takes longer counts as lost
_MOST_MARKS = 600  # of ten minutes without a report. The age is that of the oldest mark

WAY, QUEUE = "way", "queue"
"""Where messages are held up: on the way, or in the sender's own queue."""


class Late(NamedTuple):
    """A delay that is too long.

    Attributes:
        usual: s that they usually take, or None if that is unknown.
        where: `WAY` or `QUEUE`, or empty if that is unknown.
        full: the rates of a full link, or None if the link is not full.
        was_full: whether the link was full since then, so that what waited still arrives.
        undecided: whether it is not known yet if the link is full.
    """

    seconds: float
    usual: float | None
    where: str
    full: Fullness | None
    since: float
    was_full: bool = False
    undecided: bool = False


class LateWatch:
    """Decides once a second whether messages are late, with hysteresis.

    Attributes:
        since: s, when they became late, or None if they are not.
        seconds: the delay that is shown.
        usual: s that messages usually take, or None if that is unknown.
        bound: s that they might take when they were judged last, or 0 for no limit.
    """

    def __init__(self) -> None:
        self.since: float | None = None
        self.seconds = 0.0
        self.usual: float | None = None
        self.bound = 0.0
        self._good: deque[float] = deque()  # delays to learn from
        self._other = 0
        self._first = 0.0
        self._seen_at: float | None = None
        self._gap = 0.0  # s, between the last two delays

    def judge(
        self,
        delay: float | None,
        uncertainty: float,
        bound: float,
        now: float,
        measured: float | None = None,
        *,
        own: float = 0.0,
        learns: bool = True,
    ) -> None:
        """Judge a delay.

        Args:
            delay: s, or None if no message has come since the last tick.
            uncertainty: s by which `delay` may be too long.
            bound: s that a message may take, or 0 for no limit.
            measured: s that messages take, from which the usual delay is learned, or None without a figure.
            learns: whether the link and the topic are as usual.
            own: the part of `delay` that this side knows without the other one's clock, which may just have been set.
        """
        self.bound = bound
        if not bound:
            self.reset()
            return
        if delay is None:
            remembered = max(_REMEMBERED, min(_REMEMBERED_GAPS * self._gap, _LONGEST_REMEMBERED))
            if self.since is not None and self._seen_at is not None and now - self._seen_at >= remembered:
                self.reset()
            return
        self._gap = 0.0 if self._seen_at is None else now - self._seen_at
        self._seen_at = now
        late = self.since is not None
        over = delay - uncertainty > (_OVER * bound if late else bound)
        if over and abs(delay - self.seconds) > _SAME * self.seconds:
            self.seconds = delay
        if over or late or not learns:
            self._good.clear()
        elif measured is not None:
            self._good.append(measured)
            if len(self._good) > _USUAL_AFTER:
                good = self._good.popleft()
                self.usual = good if self.usual is None else self.usual + _USUAL * (good - self.usual)
        if over == late:
            self._other = 0
            return
        if not self._other:
            self._first = now
        self._other += 1
        if self._other >= _TICKS or (over and own > _CLEARLY * bound):
            self._other = 0
            self.since = None if late else self._first
            self.seconds = 0.0 if late else delay

    @property
    def is_decided(self) -> bool:
        """Whether messages are not late, nor was the last one."""
        return self.since is None and not self._other

    def reset(self) -> None:
        """Start again, but keep the usual delay."""
        self.since = None
        self.seconds = 0.0
        self._good.clear()
        self._other = 0
        self._seen_at = None


class SendersDelay:
    """The sending half's knowledge of how long messages take in one opening.

    Attributes:
        reported: s that they took by the receiver's last report, or None before the first.
        least: s that they take at least now, or 0 while nothing flows.
    """

    def __init__(self) -> None:
        self.reported: float | None = None
        self.least = 0.0
        self._reported_at = 0.0
        self._marks: deque[tuple[float, int]] = deque()
        self._looked: tuple[float, int] | None = None

    def receive(self, seconds: float, now: float) -> None:
        """Take a delay that the receiver reports."""
        if math.isfinite(seconds) and abs(seconds) <= _LONGEST_DELAY:
            self.reported, self._reported_at = seconds, now

    def is_outdated(self, now: float) -> bool:
        """Whether no reported delay counts any more."""
        return now - self._reported_at > REPORTED_LATELY

    def with_report(self, report_delay: float) -> float:
        """Return the estimated s that a message and its report take together."""
        # A message takes at least as long as a ping, even before the first report.
        return min(max(0.0, self.reported or 0.0, report_delay) + report_delay, _LONGEST_UNDER_WAY)

    def unreported(self, sent: int, accounted: int, now: float) -> float:
        """Begin the look of each second: return about how old the oldest message is that the receiver has not reported.

        Args:
            sent: messages of this opening.
            accounted: messages that the receiver has reported, arrived or lost.
        """
        self.least = 0.0
        marks, (at, before) = self._marks, self._looked or (now, 0)
        self._looked = now, sent
        if marks and marks[-1][1] > sent:
            marks.clear()  # a new opening counts from 0
        while marks and marks[0][1] <= accounted:
            marks.popleft()
        if sent > accounted and (not marks or marks[-1][1] < sent) and len(marks) < _MOST_MARKS:
            new = max(1, sent - before)
            marks.append((now - (now - at) * (new - 1) / new, sent))  # about when the first of the new ones was sent
        return now - marks[0][0] if marks else 0.0

    def measure(self, own: float, uncertainty: float, now: float) -> float | None:
        """Return the latest reported delay, or None, and note how long messages take at least.

        Args:
            own: s that they take at least, as this side knows without the other one's clock.
            uncertainty: s by which reported delays may be too long.
        """
        measured = None if self.is_outdated(now) else self.reported
        self.least = max(own, (measured or 0.0) - uncertainty)
        return measured


def delay_of_sender(unreported: float, report_delay: float) -> float:
    """Return the least s that messages take, from the age of the oldest unreported one."""
    return max(0.0, unreported - _REPORTED_EVERY - report_delay)


def late_verdict(late: Late) -> Verdict:
    """Return the verdict on a late topic."""
    usually = "" if late.usual is None or late.usual >= late.seconds else f", usually {seconds_text(late.usual)}"
    text = f"{seconds_text(late.seconds)} late{usually}: {_why(late)}"
    return Verdict(State.LATE, Cause.LATE, text, late.since)


def _why(late: Late) -> str:
    if late.full is not None:
        return f"the link is full ({late.full.share}): set max_rate, compression: zstd or priority"
    if late.was_full:
        return "the link was full, and what waited still arrives"
    if late.where == QUEUE:
        return "queued at the sender: set max_rate or priority"
    if late.undecided:
        return "held up on the way"
    if late.where == WAY:
        return "held up on the way: check network and receiver"
    return "held up on the way or by the sender: check both"


def seconds_text(seconds: float) -> str:
    """Format a delay: ``3 ms``, ``1.4 s``, ``12 s``, ``3 min``."""
    if seconds < 0.1:
        return f"{seconds * 1e3:.0f} ms" if seconds >= 1e-3 else "under 1 ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
