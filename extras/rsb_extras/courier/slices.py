"""Slices of pieces, so small and so few under way that topics beside them hardly wait.

A route of low priority alone does not do that: while it always has something to send, the link is full, and what is in
transit delays all. So a fetch sends as LEDBAT does (RFC 6817): more while slices arrive as fast as ever, less as soon
as they queue. Measured by `rsb_extras.courier.tests.fetch_cost`: docs/courier-figures.md.
"""

from __future__ import annotations

import struct
from collections import deque
from enum import Enum, auto
from typing import NamedTuple

from rsb_extras.courier.pieces import LIMIT, PIECE, PieceError, PieceProblem

SLICE_HEAD = struct.Struct("<IIII")
"""Of a slice: run, number of the piece, bytes of the piece before it, bytes of the piece."""
_LEAST, _FIRST = 2 << 10, 4 << 10  # bytes
_TINY = 128
"""Bytes of the smallest slice beside topics on a thin line, 0.05 s at 5 kB/s with its overhead. With 256, topics wait
0.04 s longer, for 4 % more of a fetch."""
_SLOW, _FASTER = 0.2, 0.1
"""s that the smallest slice takes where smaller ones are tried, and by how much these have to come faster."""
_TRIED = 8
"""Slices of which the fastest counts for that: with 0.2 s of jitter, it is 0.1 s late in one of 256 cases."""
_GROWS, _SHRINKS = 1.25, 0.7  # round figures
_VARIES_OVER, _VARIES_MOST = 16, 0.035
"""How many of the smallest slices have the mean delay that counts for the line's own, and how much (s) of it is taken
off a single slice at most. A radio with 0.1 s of jitter is no full line; with more, topics beside a fetch would wait
for as long."""
_UNSTEADY, _STEADY = 0.1, 0.07
"""s of that mean, beyond which a single slice says nothing, until it is less again: 0.2 s of jitter have 0.1 s, and a
line of 1 Mbit/s that topics and a fetch fill has 0.07 s."""
_TOGETHER, _GROW_TOGETHER = 16, 2
"""Slices of an unsteady line that are judged together, and the factor by which they grow then. Their mean varies by a
quarter of what one does: 0.02 s with 0.2 s of jitter each way."""
_PATIENCE, _MOST_PATIENCE = 2, 16
"""Times `_TOGETHER` of the smallest slices before larger ones are tried: at first, and once that was in vain several
times. A line that topics nearly fill may look unsteady, and larger slices there delay them."""
_BASE_FOR = 60.0
"""s for which the fastest slice counts at least: a way may get longer."""


class _Floor(Enum):
    """The size below which slices beside topics do not go.

    A line that is only long has slices come late, too: they come no faster if they are tiny, and carry the less.
    """

    USUAL, TINY, LONG = auto(), auto(), auto()


class _Bounds(NamedTuple):
    """How much a fetch may have in transit.

    Attributes:
        least: bytes of a slice.
        under_way: slices.
        more_below, less_above: s that a slice takes more than the fastest lately, for larger or smaller ones.
    """

    least: int
    under_way: int
    more_below: float
    less_above: float


_ALONE = _Bounds(_LEAST, 2, 0.05, 0.1)
"""One slice is on the line while the answer to the other one comes back; RFC 6817 has 0.1 s as the most."""
_BESIDE = _Bounds(_LEAST, 2, 0.03, 0.06)
_BESIDE_ON_THIN = _Bounds(_LEAST, 1, 0.02, 0.04)
_BESIDE_ON_THINNEST = _BESIDE_ON_THIN._replace(least=_TINY)
_THIN = 8 << 10
"""Bytes of a slice, below which a line is so thin that a second one under way only waits. A round figure: at 1 Mbit/s
they have 2 to 6 KiB."""


class Pace:
    """The size of slices that does not delay others.

    Attributes:
        has_others: whether topics have passed lately, that would wait behind slices.
    """

    def __init__(self) -> None:
        self.size = _FIRST
        self.has_others = False
        self._sent: deque[tuple[float, int]] = deque()
        self._heard = 0
        self._fastest = self._fastest_before = float("inf")
        self._since: float | None = None
        self._varies = 0.0  # s that a small slice takes longer than the fastest: by others, and by a radio's moods
        self._floor = _Floor.USUAL
        self._is_unsteady = False
        self._together: list[float] = []  # s beyond the fastest of slices that are judged together
        self._patience = _PATIENCE
        self._resume = 0  # bytes of slices that go on once it is known again how much the line varies
        self._tried: list[float] = []  # s of slices of the floor
        self._usual = 0.0  # s of the fastest of the usual floor, once smaller ones are tried

    @property
    def is_open(self) -> bool:
        """Whether a further slice may be sent."""
        return len(self._sent) < self._bounds.under_way

    @property
    def _bounds(self) -> _Bounds:
        if not self.has_others:
            return _ALONE
        if self.size >= _THIN:
            return _BESIDE
        return _BESIDE_ON_THINNEST if self._floor is _Floor.TINY else _BESIDE_ON_THIN

    def sent(self, now: float) -> None:
        self._sent.append((now, self.size))

    def heard(self, count: int, now: float) -> None:
        """Take in that so many slices have arrived in all, at `now` (s)."""
        while self._sent and self._heard < count:
            self._heard += 1
            sent, size = self._sent.popleft()
            if self.has_others and not self._resume:
                self._find_floor(size, now - sent)
            self._judge(now - sent, now)

    def _find_floor(self, size: int, seconds: float) -> None:
        if size >= _THIN:  # the line is another one by now
            self._floor, self._tried = _Floor.USUAL, []
        elif self._floor is not _Floor.LONG and size <= max(self._bounds.least, 2 * _TINY):
            self._tried.append(seconds)
        if len(self._tried) < _TRIED:
            return
        fastest, self._tried = min(self._tried), []
        if self._floor is _Floor.USUAL and fastest > _SLOW:
            self._floor, self._usual, self.size = _Floor.TINY, fastest, _TINY
        elif self._floor is _Floor.TINY and fastest > self._usual - _FASTER:
            self._floor, self.size = _Floor.LONG, _LEAST

    def _judge(self, seconds: float, now: float) -> None:
        if self._since is None or now - self._since > _BASE_FOR:
            self._since, self._fastest_before, self._fastest = now, self._fastest, float("inf")
            if self._floor is _Floor.TINY and self.has_others:
                self.size = _TINY  # else the fastest would be a larger one each time: its own size makes it slow there
            elif self._is_unsteady and self._floor is not _Floor.TINY:
                self._resume, self.size = self.size, _LEAST  # how much the line varies by itself is measured anew
                self._together.clear()
        self._fastest = min(self._fastest, seconds)
        over = seconds - min(self._fastest, self._fastest_before)
        if self.size == _LEAST:
            self._varies += (over - self._varies) / _VARIES_OVER
            self._is_unsteady = self._varies > (_STEADY if self._is_unsteady else _UNSTEADY)
        if self._is_unsteady and self._floor is not _Floor.TINY:
            self._together.append(over)
            self._judge_together()
        else:
            self._together.clear()
            self._resume = 0  # a size of before the line became steady, which it may not carry now
            self._resize(over - min(self._varies, _VARIES_MOST), _GROWS)

    def _judge_together(self) -> None:
        """Judge by the mean of several slices, next to that of the smallest ones: only what their size adds counts."""
        count, total = len(self._together), sum(self._together)
        if self.size == _LEAST:
            if count >= (1 if self._resume else self._patience) * _TOGETHER:
                self.size, self._resume = max(self._resume, _GROW_TOGETHER * _LEAST), 0
                self._together.clear()
        elif count == _TOGETHER or total > _TOGETHER * (self._varies + self._bounds.less_above):  # late already
            self._resize(total / _TOGETHER - self._varies, _GROW_TOGETHER)
            self._together.clear()
            if self.size == _LEAST:
                self._patience = min(2 * self._patience, _MOST_PATIENCE)
            elif self.size >= _THIN:
                self._patience = _PATIENCE

    def _resize(self, over: float, grows: float) -> None:
        bounds = self._bounds
        if over < bounds.more_below:
            self.size = min(int(self.size * grows), PIECE)
        elif over > bounds.less_above:
            self.size = int(self.size * _SHRINKS)
        self.size = max(self.size, bounds.least)


class SliceJoiner:
    """Makes pieces of slices.

    Attributes:
        number: of the piece that comes next, from 1.
    """

    def __init__(self) -> None:
        self.number = 1
        self._piece = bytearray()

    def add(self, number: int, offset: int, size: int, part: bytes) -> bytes | None:
        """Return the piece that is whole with a slice, or None.

        Raises:
            LookupError: a slice is missing before it.
            PieceError: it is none.
        """
        if (number, offset) != (self.number, len(self._piece)):
            raise LookupError
        if not part or size > LIMIT or offset + len(part) > size:
            raise PieceError(PieceProblem.INVALID())
        self._piece += part
        if len(self._piece) < size:
            return None
        piece, self._piece = bytes(self._piece), bytearray()
        self.number += 1
        return piece
