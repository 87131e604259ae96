"""A socket's datagrams as a carrier of the link's scheduler: the pace, and what is in transit."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.window import LEAST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.scheduler import Scheduler, Turns
    from rsb_bridge.transport.transport import DatagramSocket

_PAUSE = 0.001
"""s; what the I/O loop's timers resolve."""
_FIRST_BURST = 128 * 1024
_LEAST_BURST, _MOST_BURST = 32 * 1024, 4 * 1024 * 1024
"""Bytes that go in each pause."""
_GROWTH, _CAREFUL_GROWTH, _SHRINKING = 1.5, 0.05, 0.7
WINDOW = 2
"""The part of the receiver's buffer that one route may fill: its routes share it, and small datagrams cost more."""
_MOST_ON_PATH = 16 * 1024 * 1024
_PATIENCE = 0.25
"""Seconds without a receipt after which sent bytes count as arrived or lost."""
_SPAN = 0.005
"""s, at least, over which the path's rate is measured."""


class Pacer:
    """The pace of a socket's datagrams. It sends nothing itself; times are in s, on one clock.

    Attributes:
        window: bytes that may be in the receiver's buffer, or 0 if unknown.
    """

    def __init__(self) -> None:
        self.window = 0
        self._burst = float(_FIRST_BURST)
        self._tokens = float(_FIRST_BURST)
        self._filled_at = 0.0
        self._limited = False
        self._sent = 0
        self._arrived = 0
        self._under_way: deque[tuple[int, int, float]] = deque()  # last sequence number, bytes sent with it, when
        self._passed = (-1, 0)  # the last receipted sequence number, and bytes sent up to it
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
        """Return the bytes that may be sent now; none if it is 0 or less."""
        burst = self._burst
        tokens = self._tokens + (now - self._filled_at) * burst / _PAUSE
        if tokens > 2 * burst:
            tokens = 2 * burst
        elif tokens <= 0:
            self._limited = True
        self._tokens = tokens
        self._filled_at = now
        if not self.window:
            return int(tokens)
        left = self.window + self._on_path - (self._sent - self._arrived)
        return int(tokens if tokens < left else left)

    @property
    def in_transit(self) -> int:
        """Bytes that are neither receipted nor written off."""
        return self._sent - self._arrived

    def gives_up(self, now: float) -> bool:
        """Whether the receiver's buffer seems full, but only because receipts were lost."""
        if not self.window or not self._under_way or self.window + self._on_path > self.in_transit:
            return False
        return now - max(self._under_way[-1][2], self._heard_at) >= _PATIENCE

    def write_off(self) -> None:
        """Count all bytes as arrived or lost."""
        if self._under_way:
            self._arrived = self._sent
            self._passed = self._under_way[-1][:2]
            self._under_way.clear()

    def pause(self) -> float:
        """Time (s) until it is worth asking for room again, where no receipt comes before."""
        return _PAUSE if self._tokens <= 0 or not self.window else _PATIENCE

    def sent(self, size: int, sequence: int, now: float) -> None:
        """Note that `size` bytes were sent; the last datagram had this sequence number."""
        self._tokens -= size
        self._sent += size
        self._under_way.append((sequence, self._sent, now))

    def receipt(self, newest: int, opened: int, buffer: int, now: float) -> None:
        """Take a receipt: the datagrams opened, up to a sequence number, and the bytes of the receiver's buffer."""
        if newest <= self._newest:
            return  # another one has overtaken it
        self._newest = newest
        self.window = max(buffer // WINDOW, 1)
        while self._under_way and self._under_way[0][0] <= newest:
            last, self._arrived, sent_at = self._under_way.popleft()
            self._passed = last, self._arrived
            self._delay = min(self._delay, now - sent_at)
        if self._under_way:  # a part of the last burst has arrived
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


_ASKS_EVERY = 0.25
"""s after which the next datagram asks for a receipt, so that the sender learns soon that none comes."""
_PARTS = 4
"""The sender asks for a receipt after each such part of the receiver's buffer that it may fill."""
_FIRST_PAUSE, _LONGEST_PAUSE = 0.4, 0.8
"""s until a datagram that tries whether any arrives is written off: 1.8 kB/s, which a link of 5 kB/s has room for."""
_NEW = 2.0
"""s after the first datagram in which the first receipt may still come."""


class Datagrams(Protocol):
    """The UDP channel whose datagrams take turns, as far as its carrier knows it."""

    socket: DatagramSocket

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send datagrams."""
        ...

    def written_off(self) -> None:
        """Count all datagrams that were sent as no longer in transit."""
        ...

    def given_up(self) -> None:
        """Drop the rest of messages whose beginning has probably not arrived."""
        ...


class DatagramCarrier:
    """The datagrams of all routes that share a socket. They count in the link's window as a stream's bytes do.

    A receipt tells the newest datagram of a route. All before it are no longer in transit: they have arrived, or are
    lost. If no receipt comes, all are written off, and only a little is sent until one comes: a path on which nothing
    arrives must not keep the window full, and one that takes datagrams again must be noticed.

    Attributes:
        queue: see `rsb_bridge.channel.scheduler.Carrier`, and so for `time`, `behind` and `moved_at`.
    """

    def __init__(self, channel: Datagrams, scheduler: Scheduler) -> None:
        self.queue: list[tuple[int, int, Turns]] = []
        self.time = self.behind = 0
        self.moved_at = float("-inf")
        self._channel = channel
        self._scheduler = scheduler
        self._loop = asyncio.get_running_loop()
        self._pacer = Pacer()
        self._timer: asyncio.TimerHandle | None = None
        self._now = self._loop.time()
        self._datagrams = 0  # sent so far
        self._counted = self._missing = 0  # datagrams that are not in transit, and those of them that have not come
        self._proven = self._tried = False
        self._began: float | None = None
        self._heard = False
        self._pause = _FIRST_PAUSE
        self._unasked, self._asked_at = 0, float("-inf")
        scheduler.add(self)

    @property
    def in_transit(self) -> int:
        return self._pacer.in_transit

    @property
    def congested(self) -> bool:
        if self._channel.socket.congested:
            return True
        if self.room() > 0:
            return False
        if self._timer is None:
            pause = self._pacer.pause() if self._proven else self._pause
            self._timer = self._loop.call_later(pause, self._go_on)
        return True

    @property
    def is_new(self) -> bool:
        """Whether the first receipt may still come."""
        return not self._heard and (self._began is None or self._loop.time() - self._began < _NEW)

    @property
    def window(self) -> int:
        """Bytes that may be in the receiver's buffer, or 0 if unknown."""
        return self._pacer.window

    def room(self) -> int:
        """Return the bytes that may be sent now; none if it is 0 or less."""
        self._now = self._loop.time()
        room = self._pacer.room(self._now)
        return room if self._proven else min(room, LEAST - self._pacer.in_transit)

    def asks(self, size: int) -> bool:
        """Whether the next datagrams, of `size` bytes together, have to ask for a receipt."""
        self._unasked += size
        most = min(self._scheduler.every, self._pacer.window // _PARTS)
        if self._proven and self._unasked < most and self._now - self._asked_at < _ASKS_EVERY:
            return False
        self._unasked, self._asked_at = 0, self._now
        return True

    def send(self, datagrams: Sequence[bytes], size: int, times: int = 1) -> None:
        """Send datagrams, so many times each, of `size` bytes in all."""
        if self._began is None:
            self._began = self._now
        self._scheduler.count(self, size)
        self._datagrams += len(datagrams)
        self._pacer.sent(size, self._datagrams - 1, self._now)
        self._channel.send(datagrams if times == 1 else [*datagrams] * times)

    # --- receipts

    def count(self, datagrams: int, missing: int) -> None:
        """Count further datagrams of a route that are not in transit, and further ones of them that have not come."""
        self._counted += datagrams
        self._missing += missing

    def receipt(self, buffer: int) -> None:
        """Take a receipt, whose routes have counted what is in it; the receiver's buffer has so many bytes."""
        before = self._pacer.in_transit
        now = self._loop.time()
        self._pacer.receipt(self._counted - 1, self._counted - self._missing, buffer, now)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._heard = self._proven = True
        self._tried = False
        self._pause = _FIRST_PAUSE
        self.moved_at = now
        self._scheduler.acknowledge(before - self._pacer.in_transit)

    def write_off(self) -> None:
        """Count what is in transit no longer, and send little until a receipt comes."""
        if self._tried:
            self._channel.given_up()
        self._tried = not self._proven  # a first datagram may only be late, and its message goes on
        self._proven = False
        self._count_all()

    def _count_all(self) -> None:
        self._pacer.write_off()
        self._channel.written_off()

    def tick(self) -> None:
        """Write off what no receipt has told of. Called once a second."""
        if self.in_transit and self._loop.time() - self.moved_at > self._scheduler.stalls_after:
            self._give_up()

    def _give_up(self) -> None:
        size = self.in_transit
        self.write_off()
        self._scheduler.written_off(size)

    def _go_on(self) -> None:
        self._timer = None
        now = self._loop.time()
        if not self._proven:
            self._pause = _LONGEST_PAUSE
            self._give_up()
        elif self._pacer.gives_up(now):
            size = self.in_transit
            self._count_all()
            self._scheduler.written_off(size)
        self._scheduler.run()

    def writable(self) -> None:
        """Go on: the socket takes datagrams again."""
        self._scheduler.run()

    def close(self) -> None:
        """Take no more turns."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._scheduler.remove(self)
