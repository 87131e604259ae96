"""The rate that a topic usually has, learned from its messages. Nothing here reads a clock."""

from __future__ import annotations

from collections import deque
from math import sqrt

_SAMPLES, _ENOUGH = 20, 15
"""Samples that are judged: at the most, and at the least."""
_JUDGED_OVER = 3.0
"""Messages, and s: a rate is judged over the longer of both (`rsb_bridge.telemetry.meters`, `watches`)."""
_RHYTHM_SAMPLES, _RHYTHM_STEADY = 5, 0.1
"""Samples that show a rhythm before its rate can be learned, and how steady they have to be."""
_STEADY = 0.15
"""Standard deviation, as a share of the rate, that the rate over so long may have; watches call less than 0.7 slow."""
_LONGEST_GAP = 60.0
"""s; a topic with longer ones has no usual rate."""
_QUIET_PERIODS, _QUIET = 5.0, 3.0
"""Periods and s without a message after which an outage has begun."""
_CHANGED = 0.15
"""A change of the rate beyond this share of it is not noise."""
_LOWER_FOR = 600.0
"""s that a lower rate must last until it is the usual one."""


class UsualRate:
    """Learns a rate from messages that come regularly. An outage teaches nothing.

    A sample is what came in one tick: how many messages, and how long they and the gaps before them took. From their
    spread follows the coefficient of variation of a single gap, and from that how steady the rate is over the time that
    it is judged by. Messages that come at random or in bursts have no usual rate: their silence means nothing.

    A higher rate is learned within seconds. A lower one counts as slow first, and is learned after ten minutes.

    Attributes:
        rate: Hz, or None if it is not known yet or there is none.
        regular: whether messages came at a rhythm, even if its rate is not known yet.
    """

    __slots__ = ("_irregular", "_last", "_lower_for", "_samples", "_ticked", "rate", "regular")

    def __init__(self) -> None:
        self.rate: float | None = None
        self.regular = False
        self._samples: deque[tuple[int, float]] = deque(maxlen=_SAMPLES)  # gaps, and the s they took together
        self._last: float | None = None
        self._ticked = 0.0
        self._irregular = 0
        self._lower_for = 0.0

    def add(self, messages: int, last: float | None, now: float) -> None:
        """Take how many messages came since the last call.

        Args:
            messages: how many.
            last: s, when the last one came; None: none ever did.
            now: s.
        """
        began, self._ticked = self._ticked, now
        if not messages or last is None:
            return
        previous, self._last = self._last, last
        if previous is None or began - previous > self._longest_gap():
            return  # the first messages, or the first after an outage
        gaps, seconds = messages, last - previous
        quiet = began - previous
        if gaps > 1 and quiet > 1.0:  # a long gap, and short ones after it
            self._samples.append((1, quiet))
            gaps, seconds = gaps - 1, seconds - quiet
        self._samples.append((gaps, seconds))
        self._learn(last - previous)
        self.regular = self.rate is not None or self._regular_rate(_RHYTHM_SAMPLES, _RHYTHM_STEADY) is not None

    def skip(self, now: float) -> None:
        """Learn nothing from what came since the last call, at `now` (s), and keep the rate.

        The samples before are dropped: trouble begins a little before it is noticed.
        """
        self._ticked = now
        self._last = None
        self._samples.clear()
        self._lower_for = 0.0

    def _longest_gap(self) -> float:
        return _LONGEST_GAP if self.rate is None else max(_QUIET, _QUIET_PERIODS / self.rate)

    def _learn(self, seconds: float) -> None:
        rate = self._regular_rate(_ENOUGH, _STEADY)
        if rate is None:
            self._irregular += 1
            if self._irregular > _SAMPLES:  # and not for one outlier among the samples
                self.rate = None
            return
        self._irregular = 0
        if self.rate is None or rate > self.rate * (1 + _CHANGED):
            self.rate = rate
        elif rate >= self.rate * (1 - _CHANGED):
            self.rate += 0.1 * (rate - self.rate)
        else:
            self._lower_for += seconds
            if self._lower_for >= _LOWER_FOR:
                self.rate = rate
            else:
                return
        self._lower_for = 0.0

    def _regular_rate(self, enough: int, steady: float) -> float | None:
        """Return the rate of the last samples, or None if they are fewer than `enough` or not as `steady`."""
        if len(self._samples) < enough:
            return None
        gaps = sum([gaps for gaps, _ in self._samples])
        period = sum([seconds for _, seconds in self._samples]) / gaps
        if period <= 0.0:
            return None
        variance = sum([(seconds - gaps * period) ** 2 / gaps for gaps, seconds in self._samples])
        variation = sqrt(variance / (len(self._samples) - 1)) / period  # of a single gap
        spread = variation / sqrt(max(_JUDGED_OVER, _JUDGED_OVER / period))
        return 1 / period if spread <= steady else None
