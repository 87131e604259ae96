"""The rate that a topic usually has, learned from its messages. Nothing here reads a clock."""

from __future__ import annotations

from collections import deque
from statistics import median

_MESSAGES = 3
"""In one sample at the least: fewer say nothing about a rate."""
_SAMPLES = 9
_ENOUGH = 5
_SPREAD = 0.35
"""How far a sample may be from the usual one, as a share of it. One of few messages may be off by a message more."""
_REGULAR = 0.7
"""Share of the samples that must be near their median."""
_LONGEST_SAMPLE = 60.0
"""s; a topic that takes longer for three messages has no usual rate."""
_QUIET_PERIODS, _QUIET = 5.0, 3.0
"""Periods and s without a message after which an outage has begun."""
_CHANGED = 0.15
"""A change of the rate beyond this share of it is not noise."""
_LOWER_FOR = 600.0
"""s that a lower rate must last until it is the usual one."""


class UsualRate:
    """Learns a rate from what comes each second. An outage teaches nothing.

    A higher rate is learned within seconds. A lower one counts as slow first, and is learned after ten minutes.

    Attributes:
        rate: Hz; None: it is not known yet, or there is none.
    """

    __slots__ = ("_lower_for", "_messages", "_out", "_quiet", "_samples", "_seconds", "rate")

    def __init__(self) -> None:
        self.rate: float | None = None
        self._samples: deque[tuple[int, float]] = deque(maxlen=_SAMPLES)  # messages, and the s they took
        self._messages = 0
        self._seconds = 0.0
        self._quiet = 0.0
        self._out = True
        self._lower_for = 0.0

    def add(self, messages: int, seconds: float) -> None:
        """Take how many messages came in the last `seconds`."""
        self._quiet = 0.0 if messages else self._quiet + seconds
        if self._quiet > self._longest_quiet():
            self._out = True
            self._messages, self._seconds = 0, 0.0
        elif self._out:  # the first messages after an outage, which came in a part of that time only
            self._out = not messages
        else:
            self._messages += messages
            self._seconds += seconds
            if self._messages >= _MESSAGES:
                self._samples.append((self._messages, self._seconds))
                self._learn(self._seconds)
                self._messages, self._seconds = 0, 0.0

    def _longest_quiet(self) -> float:
        if self.rate is None:
            return _LONGEST_SAMPLE
        return max(_QUIET, _QUIET_PERIODS / self.rate)

    def _learn(self, seconds: float) -> None:
        rate = self._regular_rate()
        if rate is None:
            return
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

    def _regular_rate(self) -> float | None:
        """The rate of the last samples, if most of them agree."""
        if len(self._samples) < _ENOUGH:
            return None
        middle = median(messages / seconds for messages, seconds in self._samples)
        near = [
            (messages, seconds)
            for messages, seconds in self._samples
            if abs(messages / seconds - middle) <= middle * max(_SPREAD, 1.5 / messages)
        ]
        if len(near) < _REGULAR * len(self._samples):
            return None
        return sum(messages for messages, _ in near) / sum(seconds for _, seconds in near)
