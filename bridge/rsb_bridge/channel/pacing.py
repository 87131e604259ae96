"""How fast a route's datagrams go: as fast as the receiver reads them, and no faster than the path carries.

Two bounds, both learned from receipts (`rsb_bridge.wire.datagram.Receipt`):

- A window: what is under way fits the receiver's kernel buffer, and beyond it what the path itself holds (its rate
  times its delay). So a receiver that is held up for a moment loses nothing.
- A rate: 128 MB/s at first, a gigabit's. It grows by half with each receipt as long as nothing is lost, and shrinks by
  0.3 when something is. From then on it grows by 5 % a second, and the faster the longer nothing is lost.

A peer that sends no receipts has the first rate, and no window.
"""

from __future__ import annotations

from collections import deque

_PAUSE = 0.001
"""s; what the I/O loop's timers resolve."""
_FIRST_BURST = 128 * 1024
_LEAST_BURST, _MOST_BURST = 32 * 1024, 4 * 1024 * 1024
"""Bytes that go in each pause."""
_GROWTH, _CAREFUL_GROWTH, _SHRINKING = 1.5, 0.05, 0.7
WINDOW = 2
"""The part of the receiver's buffer that one route may fill: its routes share it, and small datagrams cost more."""
_MOST_ON_PATH = 16 * 1024 * 1024
_FIRST_WAIT = 0.01
"""s, at most, until the first receipt, which says how much the receiver's buffer takes."""
_PATIENCE = 0.25
"""s without a receipt, after which what is under way counts as arrived or lost."""
_SPAN = 0.005
"""s, at least, over which the path's rate is measured."""


class Pacer:
    """The pace of one route. It sends nothing itself; times are in s, on one clock.

    Attributes:
        window: bytes that may be in the receiver's buffer; 0: not known.
    """

    def __init__(self) -> None:
        self.window = 0
        self._burst = float(_FIRST_BURST)
        self._tokens = float(_FIRST_BURST)
        self._filled_at = 0.0
        self._limited = False
        self._sent = 0
        self._began = 0.0
        self._arrived = 0
        self._under_way: deque[tuple[int, int, float]] = deque()  # last sequence number, bytes sent with it, when
        self._passed = (-1, 0)  # the last sequence number before what is under way, and bytes sent up to it
        self._heard_at = 0.0
        self._newest = -1
        self._missing: int | None = None
        self._most_missing = 0
        self._lost_at: float | None = None
        self._delay = float("inf")
        self._rate = 0.0
        self._on_path = 0
        self._span = (0.0, 0)  # since when the rate is measured, and what had arrived then

    def room(self, now: float) -> int:
        """Bytes that may be sent now; 0 or less: none."""
        burst = self._burst
        tokens = self._tokens + (now - self._filled_at) * burst / _PAUSE
        if tokens > 2 * burst:
            tokens = 2 * burst
        elif tokens <= 0:
            self._limited = True
        self._tokens = tokens
        self._filled_at = now
        if not self.window:
            return 0 if self._sent >= _FIRST_BURST and now - self._began < _FIRST_WAIT else int(tokens)
        left = self.window + self._on_path - (self._sent - self._arrived)
        if left <= 0 and now - max(self._under_way[-1][2], self._heard_at) >= _PATIENCE:
            self._arrived = self._sent
            self._passed = self._under_way[-1][:2]
            self._under_way.clear()
            left = self.window
        return int(min(tokens, left))

    def pause(self) -> float:
        """Time (s) until it is worth asking for room again, where no receipt comes before."""
        return _PAUSE if self._tokens <= 0 or not self.window else _PATIENCE

    def sent(self, size: int, sequence: int, now: float) -> None:
        """So many bytes were sent; the last datagram had this sequence number."""
        if not self._sent:
            self._began = now
        self._tokens -= size
        self._sent += size
        self._under_way.append((sequence, self._sent, now))
        if not self.window and len(self._under_way) > 1 and now - self._under_way[0][2] > _PATIENCE:
            self._passed = self._under_way.popleft()[:2]  # a peer that sends no receipts
            self._arrived = self._passed[1]

    def receipt(self, newest: int, opened: int, buffer: int, now: float) -> None:
        """The receiver has opened so many datagrams, up to that sequence number, and has a buffer of so many bytes."""
        if newest <= self._newest:
            return  # another one has overtaken it
        self._newest = newest
        self.window = max(buffer // WINDOW, 1)
        while self._under_way and self._under_way[0][0] <= newest:
            last, self._arrived, sent_at = self._under_way.popleft()
            self._passed = last, self._arrived
            self._delay = min(self._delay, now - sent_at)
        if self._under_way:  # a part of what was sent at once has come
            (begin, before), (last, after, _) = self._passed, self._under_way[0]
            part = (newest - begin) / (last - begin)
            self._arrived = max(self._arrived, before + int(part * (after - before)))
        since, self._heard_at = now - self._heard_at, now
        began, arrived = self._span
        if now - began >= max(_SPAN, self._delay):
            self._rate = max((self._arrived - arrived) / (now - began), 0.9 * self._rate)
            self._span = now, self._arrived
        self._on_path = min(int(self._rate * self._delay), _MOST_ON_PATH) if self._rate else 0
        self._adapt(newest + 1 - opened, since)

    def _adapt(self, missing: int, since: float) -> None:
        """Adapt the rate; `missing` datagrams before the newest have not come, or not yet: some overtake others."""
        before, self._missing = self._missing, missing
        if before is None:
            self._most_missing = missing
            return
        lost = min(before, missing)
        if lost > self._most_missing:
            self._most_missing = lost
            self._lost_at = self._heard_at
            self._burst = max(self._burst * _SHRINKING, _LEAST_BURST)
        elif self._limited:
            growth = _GROWTH
            if self._lost_at is not None:
                growth = min(1 + _CAREFUL_GROWTH * since * (1 + (self._heard_at - self._lost_at) ** 2), _GROWTH)
            self._burst = min(self._burst * growth, _MOST_BURST)
        self._limited = False
