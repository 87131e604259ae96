"""A socket's datagrams as a carrier of the link's scheduler: the pace, and what is in transit."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.path_rate import PathRate
from rsb_bridge.channel.window import LEAST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.scheduler import Scheduler, SendingEnd
    from rsb_bridge.transport.transport import DatagramSocket

_PAUSE = 0.001
"""s; what the I/O loop's timers resolve."""
_NO_PAUSE = 0.005
"""s in which a busy I/O loop may not come to send although something waits. On the simulated paths of
tests/channel/test_pacing.py, 0.5 to 5 ms make no difference. With 50 ms, images at 25 Hz are spread over the time
between them: one of 60 kB takes 49 ms on a path of 100 Mbit/s instead of 25."""
_LEAST_BURST, _BURST_LASTS = 16 * 1024, 0.005
"""Bytes that go at once after a pause: so many, or what crosses in so many s. Round figures: on the same paths, 1.4 to
256 kB and 1 to 50 ms change no image's time, and a radio's queue by 0.02 s at p99."""
WINDOW = 2
"""The part of the receiver's buffer that one route may fill: its routes share it, and small datagrams cost more."""
_PATIENCE = 0.25
"""s, or two round trips if they take longer: after `_ASKS_EVERY`, a receipt is asked for. A round figure."""


class Pacer:
    """The pace of a socket's datagrams. It sends nothing itself; times are in s, on one clock.

    Attributes:
        window: bytes that may be in the receiver's buffer, or 0 if unknown.
    """

    def __init__(self) -> None:
        self.window = 0
        self.path = PathRate()
        self._tokens = self._burst = self.path.pace * _BURST_LASTS
        self._filled_at = 0.0
        self._limited = self._is_held = self._was_idle = False
        self._sent, self._sent_at = 0, 0.0
        self._arrived = 0
        self._under_way: deque[tuple[int, int, float]] = deque()  # last sequence number, bytes sent with it, when
        self._passed = (-1, 0)  # the last receipted sequence number, and bytes sent up to it
        self._heard_at = 0.0
        self._newest, self._opened = -1, 0
        self._round_trip = 0.0

    def room(self, now: float) -> int:
        """Return the bytes that may be sent now; none if it is 0 or less."""
        tokens = self._tokens = min(self._tokens + (now - self._filled_at) * self.path.pace, self._burst)
        self._filled_at = now
        if self.window:
            tokens = min(tokens, self.limit - self.in_transit)
        if tokens < 1:
            self._limited = self._is_held = True
        elif not self._is_held and now - self._sent_at > _NO_PAUSE:
            self._was_idle = True
        return int(tokens)

    @property
    def limit(self) -> int:
        """Bytes that may be in transit: on the path and in the receiver's buffer."""
        return min(self.window + self.path.crossing, self.path.most)

    @property
    def in_transit(self) -> int:
        """Bytes that are neither receipted nor written off."""
        return self._sent - self._arrived

    def gives_up(self, now: float) -> bool:
        """Whether no more may be in transit, but only because receipts were lost."""
        if not self.window or not self._under_way or self.limit > self.in_transit:
            return False
        return now - max(self._under_way[-1][2], self._heard_at) >= self.patience

    @property
    def patience(self) -> float:
        """The time (s) without a receipt after which a full path seems to carry nothing."""
        return max(_PATIENCE, 2 * self._round_trip)

    def write_off(self) -> None:
        """Count all bytes as arrived or lost."""
        if self._under_way:
            self.path.silent(full=self.in_transit >= self.limit)
            self._arrived = self._sent
            self._passed = self._under_way[-1][:2]
            self._under_way.clear()

    def pause(self) -> float:
        """Time (s) until it is worth asking for room again, where no receipt comes before."""
        if self._tokens >= 1 and self.window:
            return self.patience
        # Half of a burst is worth waking up for.
        return min(_BURST_LASTS, max(_PAUSE, (self._burst / 2 - self._tokens) / self.path.pace))

    def sent(self, size: int, sequence: int, now: float) -> None:
        """Note that `size` bytes were sent; the last datagram had this sequence number."""
        if self._was_idle:
            # A pause says nothing about the path: images at 30 Hz would each be spread over 33 ms.
            self._was_idle = self._limited = False
            self.path.interrupted()
        self._is_held = False
        self._sent_at = now
        self._tokens -= size
        self._sent += size
        self._under_way.append((sequence, self._sent, now))

    def receipt(self, newest: int, opened: int, buffer: int, now: float) -> None:
        """Take a receipt: the datagrams opened, up to a sequence number, and the bytes of the receiver's buffer."""
        if newest <= self._newest:
            return  # another one has overtaken it
        self.window = max(buffer // WINDOW, 1)  # 0 would mean that it is unknown
        self._heard_at = now
        before, sent_at = self._arrived, None
        while self._under_way and self._under_way[0][0] <= newest:
            last, self._arrived, sent_at = self._under_way.popleft()
            self._passed = last, self._arrived
        if self._under_way:  # a part of the last burst has arrived
            (begin, reached), (last, after, at) = self._passed, self._under_way[0]
            part = (newest - begin) / (last - begin)
            self._arrived = max(self._arrived, reached + int(part * (after - reached)))
            if newest > begin:  # else it is a late receipt of datagrams that are written off
                sent_at = at if sent_at is None else sent_at
        # A peer may claim that more have arrived than were sent.
        datagrams, arrived = newest - self._newest, min(max(0, opened - self._opened), newest - self._newest)
        self._newest, self._opened = newest, max(opened, self._opened)
        if sent_at is None:
            return
        self._round_trip = now - sent_at
        if self.path.passed(self._arrived - before, datagrams, arrived, sent_at, now, limited=self._limited):
            self._limited = False
            self._burst = max(_LEAST_BURST, self.path.pace * _BURST_LASTS)


_ASKS_EVERY = 0.25
"""s after which the next datagram asks for a receipt, so that the sender learns soon that none comes. Nothing was
measured."""
_PARTS = 4
"""The sender asks for a receipt after each such part of what may be in transit, as for the window of the streams."""
_FIRST_PAUSE, _LONGEST_PAUSE = 0.4, 0.8
"""s until a datagram that tries whether any arrives is written off: 1.8 kB/s, which a link of 5 kB/s has room for."""
_NEW = 2.0
"""s after the first datagram in which the first receipt may still come: a round trip through a full tunnel of 5 kB/s
takes up to 2 s (`bench.robot`)."""


class Datagrams(Protocol):
    """The UDP channel whose datagrams take turns, as far as its carrier knows it."""

    socket: DatagramSocket

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send datagrams."""

    def written_off(self) -> None:
        """Count all datagrams that were sent as no longer in transit."""

    def given_up(self) -> None:
        """Drop the rest of messages whose beginning has probably not arrived."""


class DatagramCarrier:
    """The datagrams of all routes that share a socket. They count in the link's window as a stream's bytes do.

    A receipt tells the newest datagram of a route. All before it are no longer in transit: they have arrived, or are
    lost. If no receipt comes, all are written off, and only a little is sent until one comes: a path on which nothing
    arrives must not keep the window full, and one that takes datagrams again must be noticed.

    Attributes:
        queue: see `rsb_bridge.channel.scheduler.Carrier`, and so for `time`, `behind` and `moved_at`.
    """

    def __init__(self, channel: Datagrams, scheduler: Scheduler) -> None:
        self.queue: list[tuple[int, int, SendingEnd]] = []
        self.time = self.behind = 0
        self.moved_at = float("-inf")
        self._channel = channel
        self._scheduler = scheduler
        self._loop = asyncio.get_running_loop()
        self._pacer = Pacer()
        self._timer: asyncio.TimerHandle | None = None
        self._now = self._loop.time()
        self._datagrams = 0  # sent so far
        self._counted = self._missing = 0  # datagrams that are no longer in transit, and how many of them have not come
        self._proven = self._tried = False
        self._began: float | None = None
        self._heard = False
        self._pause = _FIRST_PAUSE
        self._unasked, self._asked_at = 0, float("-inf")
        self._unanswered = float("inf")  # since when (s) a receipt is asked for
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
            # No event tells that the pace allows more, so a timer wakes the scheduler.
            pause = self._pacer.pause() if self._proven else self._pause
            self._timer = self._loop.call_later(pause, self._go_on)
        return True

    @property
    def is_new(self) -> bool:
        """Whether the first receipt may still come."""
        return not self._heard and (self._began is None or self._loop.time() - self._began < _NEW)

    @property
    def knows_its_rate(self) -> bool:
        """Whether the path carries less than the routes want to send."""
        return self._pacer.path.known

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
        most = min(self._scheduler.every, self._pacer.limit // _PARTS)
        # Where asking or the answer got lost, every datagram asks, so that what gets lost by chance stops nothing.
        overdue = self._now > self._unanswered + self._pacer.patience / 2
        if self._proven and self._unasked < most and self._now - self._asked_at < _ASKS_EVERY and not overdue:
            return False
        self._unasked, self._asked_at = 0, self._now
        self._unanswered = min(self._unanswered, self._now)
        return True

    def send(self, datagrams: Sequence[bytes], size: int, times: int = 1) -> None:
        """Send datagrams, so many times each, of `size` bytes in all."""
        if self._began is None:
            self._began = self._now
        self._scheduler.count(self, size)  # before the pacer: the scheduler asks whether anything was in transit
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
        self._unanswered = float("inf")
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
        self._pacer.write_off()
        self._channel.written_off()

    def tick(self) -> None:
        """Write off bytes that no receipt has covered. Called once a second."""
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
        if not self._proven or self._pacer.gives_up(now):
            self._give_up()
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
