"""Slices of pieces, so small and so few under way that topics beside them hardly wait.

A route of low priority alone does not do that: while it always has something to send, the link is full, and what is in
transit delays all. So a fetch sends as LEDBAT does (RFC 6817): more while slices arrive as fast as ever, less as soon
as they queue. Measured by `rsb_extras.courier.tests.fetch_cost`: docs/courier-figures.md.
"""

from __future__ import annotations

import struct
from collections import deque
from typing import NamedTuple

from rsb_extras.courier.pieces import LIMIT, PIECE, PieceError, PieceProblem

SLICE_HEAD = struct.Struct("<IIII")
"""Of a slice: run, number of the piece, bytes of the piece before it, bytes of the piece."""
_LEAST, _FIRST = 2 << 10, 4 << 10  # bytes
_GROWS, _SHRINKS = 1.25, 0.7  # round figures
_VARIES_OVER, _VARIES_MOST = 16, 0.035
"""How many of the smallest slices have the mean delay that counts for the line's own, and how much (s) it is at most. A
radio with 0.1 s of jitter is no full line; with more, topics beside a fetch would wait for as long."""
_BASE_FOR = 60.0
"""s for which the fastest slice counts at least: a way may get longer."""


class _Bounds(NamedTuple):
    """How much a fetch may have in transit.

    Attributes:
        under_way: slices.
        more_below, less_above: s that a slice takes more than the fastest lately, for larger or smaller ones.
    """

    under_way: int
    more_below: float
    less_above: float


_ALONE = _Bounds(2, 0.05, 0.1)
"""One slice is on the line while the answer to the other one comes back; RFC 6817 has 0.1 s as the most."""
_BESIDE = _Bounds(2, 0.03, 0.06)
_BESIDE_ON_THIN = _Bounds(1, 0.02, 0.04)
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
        self._sent: deque[float] = deque()
        self._heard = 0
        self._fastest = self._fastest_before = float("inf")
        self._since: float | None = None
        self._varies = 0.0  # s that a small slice takes longer than the fastest: by others, and by a radio's moods

    @property
    def is_open(self) -> bool:
        """Whether a further slice may be sent."""
        return len(self._sent) < self._bounds.under_way

    @property
    def _bounds(self) -> _Bounds:
        if not self.has_others:
            return _ALONE
        return _BESIDE_ON_THIN if self.size < _THIN else _BESIDE

    def sent(self, now: float) -> None:
        self._sent.append(now)

    def heard(self, count: int, now: float) -> None:
        """Take in that so many slices have arrived in all, at `now` (s)."""
        while self._sent and self._heard < count:
            self._heard += 1
            self._judge(now - self._sent.popleft(), now)

    def _judge(self, seconds: float, now: float) -> None:
        if self._since is None or now - self._since > _BASE_FOR:
            self._since, self._fastest_before, self._fastest = now, self._fastest, float("inf")
        self._fastest = min(self._fastest, seconds)
        over = seconds - min(self._fastest, self._fastest_before)
        if self.size == _LEAST:
            self._varies += (over - self._varies) / _VARIES_OVER
        over -= min(self._varies, _VARIES_MOST)
        if over < self._bounds.more_below:
            self.size = min(int(self.size * _GROWS), PIECE)
        elif over > self._bounds.less_above:
            self.size = max(int(self.size * _SHRINKS), _LEAST)


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
