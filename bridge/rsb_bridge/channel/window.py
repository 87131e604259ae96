"""How much of a stream channel's data may be on its way, so that it waits there for a second at most.

A stream takes what its buffers hold: the kernel's, and those of a tunnel behind them. On a link of 5 kB/s that is data
of several minutes. So the receiver says how many bytes it has taken in, and the sender keeps no more under way than
the window. The rest waits in the route's queue, where the oldest messages go first.

The window follows the age of the oldest byte that has not arrived. While that is low, the window grows with what
arrives, as TCP's does at first: by as much again in each round trip. Once it is above `_LATE`, the window shrinks
to what crosses in `_AIM`. So it needs no rate to begin with, and on a link that is fast enough it is never reached.

Nothing here knows sockets or clocks. Bytes are counted from the beginning of the stream.
"""

from __future__ import annotations

from collections import deque

FEATURE = "receipts"
"""A side that says what it has taken in names it (PROTOCOL.md, 1.6)."""

FIRST = 8 * 1024
"""Bytes under way before anything is known: 1.6 s of 5 kB/s. A message more may always be."""
LEAST = 2 * 1024
_PARTS = 4
"""A receiver says what it has taken in after each such part of the window."""
FIRST_RECEIPT = 512
"""Bytes after which it says so before it was asked: few, so that the way there and back is seen before a queue is."""

_FRESH, _LATE, _AIM = 0.2, 0.8, 0.5
"""s that the oldest byte may be under way: below the first the window grows, above the second it shrinks to what
crosses in the third."""
_ROOM = 4.0
"""s of what crosses that the window grows to where nothing waits: then the sender needs a receipt once a second."""
_FARTHEST = 2.0
"""s that a way there and back may take of itself; what takes longer counts as waiting."""
_SILENT = 2.0
"""s after which nothing arrives any more: a receiver that has had nothing more for a while says so once a second."""
_MEASURED_OVER = 1.0
_STOPPED = 1.5
"""s without a receipt."""
_MARKS_PER_WINDOW, _MARK_EVERY = 64, 0.02
_MOST_MARKS, _MOST_RECEIPTS = 1024, 64


class Window:
    """The sending end's.

    Attributes:
        limit: bytes sent in all from which on the channel is congested.
        size: bytes that may be under way.
        slow: what was sent arrives late.
    """

    __slots__ = (
        "_last_mark",
        "_last_mark_at",
        "_marks",
        "_near",
        "_origin",
        "_receipts",
        "_taken",
        "limit",
        "size",
        "slow",
    )

    def __init__(self, sent: int) -> None:
        """Begin where so many bytes have been sent, which are not the channel's."""
        self.size = FIRST
        self.limit = sent + FIRST
        self.slow = False
        self._origin = self._taken = sent
        self._marks: deque[tuple[int, float]] = deque()  # how many bytes were sent when (s)
        self._last_mark, self._last_mark_at = sent, float("-inf")
        self._receipts: deque[tuple[int, float]] = deque(maxlen=_MOST_RECEIPTS)
        self._near = _FARTHEST  # s, the shortest way there and back so far

    def wrote(self, before: int, now: float) -> None:
        """Note that data is written at `now` (s); `before`: bytes sent before it."""
        marks = self._marks
        if not marks:
            if not self._receipts or now - self._receipts[-1][1] > 2 * _MEASURED_OVER:
                self._receipts.clear()
                self._receipts.append((self._taken, now))  # nothing could arrive before
        elif now - self._last_mark_at < _MARK_EVERY and before - self._last_mark < self.size // _MARKS_PER_WINDOW:
            return
        if len(marks) < _MOST_MARKS:  # else a byte seems older than it is
            marks.append((before, now))
            self._last_mark, self._last_mark_at = before, now

    def took(self, count: int, sent: int, now: float) -> None:
        """Take a receipt.

        Args:
            count: bytes of the channel that the receiver has taken in, as it says.
            sent: bytes sent so far.
            now: s.
        """
        taken = min(self._origin + count, sent)
        gained = taken - self._taken
        if gained <= 0:
            return
        limited = 2 * (sent - self._taken) >= self.size
        marks = self._marks
        written_at = None
        while marks and marks[0][0] < taken:
            written_at = marks.popleft()
        if written_at is not None:
            self._near = min(self._near, max(0.0, now - written_at[1]))
            if taken < sent and (not marks or marks[0][0] > taken):
                marks.appendleft((taken, written_at[1]))
        self._taken = taken
        rate = self._rate(taken, now)
        waits = self._age(now) - self._near
        if waits > _LATE:
            self.slow = True
            self.size = max(LEAST, int(rate * _AIM), min(self.size, (sent - taken) // 2))
        elif waits < _FRESH:
            self.slow = self.slow and limited
            if limited or self.size < rate * _ROOM:
                self.size += gained
        elif limited:
            self.slow = True
        self.limit = taken + self.size

    def look(self, sent: int, now: float) -> None:
        """Send no more for now where nothing arrives: once a second."""
        if self._age(now) - self._near > _SILENT:
            self.slow = True
            self.limit = min(self.limit, max(sent, self._taken + LEAST))

    def moves(self, now: float) -> bool:
        """Whether anything has arrived lately."""
        return bool(self._receipts) and now - self._receipts[-1][1] < _STOPPED

    @property
    def every(self) -> int:
        """Bytes after which a receipt is wanted."""
        return max(FIRST_RECEIPT, self.size // _PARTS)

    def _age(self, now: float) -> float:
        """S since the oldest byte that has not arrived was written; 0: all have arrived."""
        return now - self._marks[0][1] if self._marks else 0.0

    def _rate(self, taken: int, now: float) -> float:
        """Bytes/s that have arrived lately."""
        receipts = self._receipts
        while len(receipts) > 1 and receipts[1][1] <= now - _MEASURED_OVER:
            receipts.popleft()
        rate = 0.0
        if receipts:
            first, at = receipts[0]
            rate = (taken - first) / max(now - at, 0.05)
        receipts.append((taken, now))
        return rate


class Taken:
    """The receiving end's: when to say how much it has taken in.

    Attributes:
        count: bytes taken in so far.
        due: of them, from which on it is time to say so.
    """

    __slots__ = ("_every", "_said", "count", "due")

    def __init__(self, every: float = FIRST_RECEIPT) -> None:
        self.count = self._said = 0
        self._every = every
        self.due = every

    def ask(self, every: int) -> None:
        """Have it said after so many bytes each."""
        self._every = max(1, every)
        self.due = self._said + self._every

    def say(self) -> int:
        """Return what to say, which counts as said."""
        self._said = self.count
        self.due = self.count + self._every
        return self.count

    @property
    def news(self) -> bool:
        """Whether more was taken in than was said."""
        return self.count != self._said
