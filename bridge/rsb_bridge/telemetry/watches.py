"""Whether a flow of messages is as it should be: each watch is called once a second, and changes its mind slowly."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

# Of slow topics.
# Shares of the expected rate: below the one a topic gets slow, above the other it no longer is. The lower one is two
# standard deviations below the least steady rate that can be learned (`meters._STEADY`). The other lies apart from it,
# so that a rate about one of them does not flap.
_SLOW_BELOW, FAST_ABOVE = 0.7, 0.85
_SLOW_AFTER, _FAST_AFTER = 5, 3  # s in a row; not measured. A minute would be late news, one second a late message
_SLOWEST = 0.3  # Hz; the rate of a topic that should have less than that is too uncertain to call it slow

# Of stopped topics.
# Periods and s without a message: the longer of both. tests/telemetry/test_regularity.py has publishers at random and
# in bursts, none of which may be called stopped.
_STOPPED_PERIODS, _STOPPED_AFTER = 5.0, 2.0
_PAUSES = 2.0  # times as long as it has paused before, that a topic may pause. A round figure
_LONGEST_LEARNED = 600.0  # s of a pause that count: an outage ends, too, and would hide the next one for twice as long

# Of losses.
LATELY = 10  # s over which losses are counted. Their causes are compared, so all of them are counted for as long
# Shares of the messages, and messages: from the one on a topic loses messages, below the other it no longer does. Two,
# so that a loss about one of them does not flap.
LOSSY_ABOVE, _WHOLE_BELOW, _LEAST_LOST = 0.05, 0.02, 3
# Times as long as between the last two losses in a row for which they count: a topic that ended owes nothing. A round
# figure.
_ROW_LASTS = 2.0
_FEW_FOR = 10  # ticks in a row with fewer losses than make a fault, after which a topic has recovered: as `LATELY`
# Ticks in which messages arrive and none is lost, after which a topic recovers, and has recovered. Round figures.
_LOSSLESS_TICKS, _RECOVERED_TICKS = 2, 4
# Losses that the arrived messages would have had at the share before, so that their absence is not chance: independent
# ones would be absent in one case of 20 (e^-3).
_EXPECTED_LOSSES = 3.0
# Causes of drops that are meant, or that the link's own state explains.
_NO_LOSS = frozenset({"already published", "link lost", "outage", "would loop", "expired", "disarmed"})


class SlowWatch:
    """Watches whether a topic is slower than expected.

    Attributes:
        since: s, when it became slow, or None.
    """

    __slots__ = ("_other", "since")

    def __init__(self) -> None:
        self.since: float | None = None
        self._other = 0

    def judge(self, rate: float, expected: float, now: float) -> None:
        """Judge the rate of the last seconds, in Hz as the expected one, at `now` (s)."""
        if expected < _SLOWEST:
            self.reset()
            return
        slow = self.since is not None
        changes = rate >= FAST_ABOVE * expected if slow else rate < _SLOW_BELOW * expected
        self._other = self._other + 1 if changes else 0
        if self._other >= (_FAST_AFTER if slow else _SLOW_AFTER):
            self.since = None if slow else now
            self._other = 0

    def reset(self) -> None:
        """Start over: messages do not flow now, so their rate means nothing."""
        self.since = None
        self._other = 0


class StopWatch:
    """Watches whether a topic's publishers have stopped.

    Publishers that have paused and resumed are expected to do so again, for up to twice as long, at most 20 min. A new
    one has as long for its first message as the others have for their next.

    Attributes:
        since: s, when the last message came before they stopped, or None.
        quiet: whether the silence is longer than the rate explains, even if it is a usual pause.
        new: the publishers that have come since the last message.
        next_change: time (s) from which the silence may be judged otherwise, without a message.
    """

    __slots__ = ("_came_at", "_longest_pause", "_publishers", "new", "next_change", "quiet", "since")

    def __init__(self) -> None:
        self.since: float | None = None
        self.quiet = False
        self.next_change = inf
        self.new: frozenset[bytes] = frozenset()
        self._came_at = float("-inf")
        self._publishers: frozenset[bytes] | None = None
        self._longest_pause = 0.0

    def judge(
        self, last: float, expected: float, now: float, publishers: frozenset[bytes], *, promised: bool = False
    ) -> None:
        """Judge the silence.

        Args:
            last: s, when the last message came.
            promised: an operator expects that rate, so that pauses are faults.
        """
        if self.since is not None and last > self.since:
            if publishers == self._publishers:  # else the publisher died, and was started again
                self._longest_pause = max(self._longest_pause, min(last - self.since, _LONGEST_LEARNED))
            self.since = None
        if last > self._came_at:
            self.new = frozenset()
        known = publishers if self._publishers is None else self._publishers | self.new
        if publishers - known:
            self.new |= publishers - known
            self._came_at = now
        # While the topic has stopped, the publishers from before stay: the message that ends this tells by them whether
        # they have paused, or others have taken over.
        if self.since is None and publishers != self._publishers:
            self._publishers, self._longest_pause = publishers, 0.0
        waited = now - max(last, self._came_at)
        longest, paused = max(_STOPPED_AFTER, _STOPPED_PERIODS / expected), _PAUSES * self._longest_pause
        self.quiet = waited > longest
        if self.quiet and self.since is None and (promised or waited > paused):
            self.since = last
        self.next_change = now
        if self.quiet:
            self.next_change = inf if self.since is not None else now + paused - waited

    def reset(self) -> None:
        """Start over: messages cannot flow now."""
        self.since, self.quiet, self.next_change = None, False, inf


@dataclass(frozen=True, slots=True)
class Loss:
    """Messages lost in the last seconds.

    Attributes:
        of: number of messages that were delivered or lost.
        cause: of most of the losses, as in the ledger.
        since: s, when it began; if all of them were lost, of the last one before that arrived.
        recovering: whether fewer are lost now than make a fault.
    """

    lost: int
    of: int
    cause: str
    since: float
    recovering: bool = False

    @property
    def share(self) -> float:
        """0 to 1."""
        return self.lost / self.of


class _LostInARow:
    """The messages that were lost since the last one arrived.

    Attributes:
        lost: their number by cause.
    """

    __slots__ = ("_at", "lost")

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._at: list[float] = []  # times (s) of the last two

    def add(self, lost: Mapping[str, int], now: float) -> None:
        if any(lost.values()):
            self.lost.update(lost)
            self._at = [*self._at[-1:], now]

    def counts(self, now: float) -> bool:
        """Whether the losses repeat: the last gap is no longer than the one before."""
        if self.lost.total() < _LEAST_LOST:
            return False
        apart = self._at[-1] - self._at[-2] if len(self._at) > 1 else 0.0
        return now - self._at[-1] <= max(LATELY, _ROW_LASTS * apart)

    def clear(self) -> None:
        self.lost.clear()
        self._at.clear()


class LossWatch:
    """Watches whether messages are lost between the two sides.

    Attributes:
        loss: the present loss, or None if it is negligible.
    """

    __slots__ = ("_arrived_at", "_few", "_lossless", "_marks", "_row", "_since_loss", "loss")

    def __init__(self) -> None:
        self.loss: Loss | None = None
        self._few = 0  # ticks in a row with fewer losses than make a fault
        self._lossless = 0  # ticks with messages since the last loss
        self._since_loss = 0  # messages that have arrived since then
        self._row = _LostInARow()
        self._arrived_at: float | None = None
        self._marks: deque[tuple[float, int, Mapping[str, int]]] = deque()

    def judge(self, delivered: int, lost: Mapping[str, int], now: float) -> None:
        """Judge a ledger's counts so far.

        Args:
            delivered: messages that arrived and were published.
            lost: messages that did not, by cause.
        """
        if lost:  # seldom
            lost = {cause: count for cause, count in lost.items() if cause not in _NO_LOSS}
        if self._marks and delivered < self._marks[-1][1]:
            self.reset()  # the counts have begun again
        self._marks.append((now, delivered, lost))
        # One mark from before the window stays, to count from; and the last two, which are compared even if ticks come
        # late.
        while len(self._marks) > 2 and now - self._marks[1][0] >= LATELY:
            self._marks.popleft()
        self._count_since_loss(now)
        if self.loss is not None and self._lossless >= _RECOVERED_TICKS and self._not_chance(self.loss):
            self.reset()  # the losses in the window belong to the fault that is over
            self._marks.append((now, delivered, lost))
            return
        _, delivered_before, lost_before = self._marks[0]
        if lost == lost_before and self.loss is None and not self._row.lost:  # nearly always
            self._few += 1
            return
        new = Counter(
            {cause: gained for cause, count in lost.items() if (gained := count - lost_before.get(cause, 0)) > 0}
        )
        total = new.total()
        settled = total + delivered - delivered_before
        if total < _LEAST_LOST and self._row.counts(now):  # rare messages, none of which arrives
            new = self._row.lost
            settled = total = new.total()
        share = total / settled if settled else 0.0
        self._few = self._few + 1 if share < LOSSY_ABOVE else 0
        if self._few >= _FEW_FOR:
            self.loss = None
        elif share >= (_WHOLE_BELOW if self.loss else LOSSY_ABOVE) and total >= (1 if self.loss else _LEAST_LOST):
            ((cause, _),) = new.most_common(1)
            recovering = self._few > 0
            if self.loss is not None:
                recovering |= self._lossless >= _LOSSLESS_TICKS and self._not_chance(self.loss)
                # Another cause would be a new fault, for losses that are over.
                cause = self.loss.cause if recovering else cause
            since = self.loss.since if self.loss else now
            if total >= settled and self._arrived_at is not None:
                since = max(since, self._arrived_at)
            self.loss = Loss(total, settled, cause, since, recovering)
        # While nothing at all settles, a loss of everything is no news and goes on.
        elif settled or now - self._marks[0][0] >= LATELY:
            self.loss = None

    @property
    def is_calm(self) -> bool:
        """Whether none was lost in the last seconds, nor since the last one that arrived."""
        marks = self._marks
        return self.loss is None and not self._row.lost and (not marks or marks[0][2] == marks[-1][2])

    def _count_since_loss(self, now: float) -> None:
        if len(self._marks) < 2:
            return
        (_, delivered_before, lost_before), (_, delivered, lost) = self._marks[-2], self._marks[-1]
        if delivered > delivered_before:
            self._arrived_at = now
            self._row.clear()
        elif lost:
            # A count falls if a message arrives after all that had been given up.
            self._row.add({cause: max(0, count - lost_before.get(cause, 0)) for cause, count in lost.items()}, now)
        if lost != lost_before and any(count > lost_before.get(cause, 0) for cause, count in lost.items()):
            self._lossless = self._since_loss = 0
        elif delivered > delivered_before:
            self._lossless += 1
            self._since_loss += delivered - delivered_before

    def _not_chance(self, loss: Loss) -> bool:
        """Whether so many messages have arrived since the last loss that the losses are probably over."""
        # Never more than 60 messages: at the 2 % to which a loss may fall, it would be 150.
        return self._since_loss * max(loss.share, LOSSY_ABOVE) >= _EXPECTED_LOSSES

    def reset(self) -> None:
        self.loss = None
        self._few = self._lossless = self._since_loss = 0
        self._row.clear()
        self._marks.clear()
