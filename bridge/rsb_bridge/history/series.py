"""One link's or topic's figures of each minute of the last 24 hours, in seven bytes a minute."""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING

from rsb_bridge.model.history import KEPT_FOR

if TYPE_CHECKING:
    from collections.abc import Iterator

MINUTE = 60.0
MINUTES = round(KEPT_FOR / MINUTE)
_TRIMMED_AT = MINUTES + 60
"""Minutes that are kept before the oldest go: not each minute, because that moves all of them."""
_STEPS = 4
"""Parts of a second in which a minute's times are kept: 0.25 s fits 60 s into a byte."""
_UNKNOWN = math.nan


class Series:
    """Rates, and how long it was fine, not fine, or waiting, minute by minute.

    A minute's number is its time divided by 60 s.

    Attributes:
        first: number of the first minute kept.
    """

    def __init__(self) -> None:
        self.first = 0
        self._rates = array("f")
        self._up = bytearray()
        self._out = bytearray()
        self._waiting = bytearray()

    def __len__(self) -> int:
        return len(self._rates)

    @property
    def end(self) -> int:
        """Number of the minute after the last one."""
        return self.first + len(self)

    def add(self, minute: int, rate: float, up: float, out: float, waiting: float) -> None:
        """Append a minute's figures, or add to those of the last one if it is the same.

        Args:
            minute: its number; not before the last one's.
            rate: mean over the time that is known of it.
            up: s in which it was fine.
            out: s in which it was not.
            waiting: s in which it waited for its first message.
        """
        if len(self) and minute == self.end - 1:  # the machine slept, or the clock was set, within it
            self._rates[-1] = rate if math.isnan(self._rates[-1]) else (self._rates[-1] + rate) / 2
            for kept, seconds in zip(self._times, (up, out, waiting), strict=True):
                kept[-1] = min(255, kept[-1] + round(seconds * _STEPS))
            return
        if not len(self) or minute - self.end >= MINUTES:
            self._cut(len(self))
            self.first = minute
        self._insert(len(self), minute - self.end)
        self._rates.append(rate)
        for kept, seconds in zip(self._times, (up, out, waiting), strict=True):
            kept.append(min(255, round(seconds * _STEPS)))
        if len(self) > _TRIMMED_AT:
            self._cut(len(self) - MINUTES)

    @property
    def _times(self) -> tuple[bytearray, bytearray, bytearray]:
        return self._up, self._out, self._waiting

    def times(self, start: int, end: int) -> tuple[float, float, float]:
        """Seconds up, out, and waiting, in the minutes from `start` to before `end`."""
        begin, stop = max(0, start - self.first), max(0, end - self.first)
        up, out, waiting = (sum(kept[begin:stop]) / _STEPS for kept in self._times)
        return up, out, waiting

    def rates(self, start: int, end: int, parts: int) -> Iterator[float | None]:
        """The mean rate in each of `parts` parts of the minutes from `start` to before `end`; None: not known."""
        for part in range(parts):
            begin = start + (end - start) * part // parts - self.first
            stop = start + (end - start) * (part + 1) // parts - self.first
            known = [rate for rate in self._rates[max(0, begin) : max(0, stop)] if not math.isnan(rate)]
            yield round(math.fsum(known) / len(known), 3) if known else None

    def move(self, since: int, minutes: int) -> None:
        """Move what is from minute `since` on, because the clock was set.

        Args:
            since: number of a minute.
            minutes: how far; below 0 towards the past, over what was there.
        """
        at = max(0, min(len(self), since - self.first))
        if at == 0:
            self.first += minutes
        elif minutes > 0:
            if minutes >= MINUTES:
                self._cut(at)
                self.first = since + minutes
            else:
                self._insert(at, minutes)
                self._cut(max(0, len(self) - MINUTES))
        else:
            for figures in (self._rates, *self._times):
                del figures[max(0, at + minutes) : at]
            self.first += min(0, at + minutes)

    def dump(self) -> tuple[int, bytes, bytes, bytes, bytes]:
        """All of it, for `load`."""
        return self.first, self._rates.tobytes(), bytes(self._up), bytes(self._out), bytes(self._waiting)

    @classmethod
    def load(cls, first: int, rates: bytes, up: bytes, out: bytes, waiting: bytes) -> Series:
        """The inverse of `dump`.

        Raises:
            ValueError: the parts do not belong together, or there are too many minutes.
        """
        series = cls()
        series.first = first
        series._rates.frombytes(rates)
        series._up, series._out, series._waiting = bytearray(up), bytearray(out), bytearray(waiting)
        if not len(series) == len(up) == len(out) == len(waiting) <= _TRIMMED_AT:
            raise ValueError(f"{len(series)} rates, {len(up)}, {len(out)} and {len(waiting)} times")
        return series

    def _insert(self, at: int, minutes: int) -> None:
        """Put minutes in of which nothing is known."""
        self._rates[at:at] = array("f", [_UNKNOWN]) * minutes
        for kept in self._times:
            kept[at:at] = bytes(minutes)

    def _cut(self, minutes: int) -> None:
        """Forget the oldest minutes."""
        for figures in (self._rates, *self._times):
            del figures[:minutes]
        self.first += minutes
