"""A socket's datagrams as a carrier of the link's scheduler: what is in transit, and whether anything arrives."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.pacing import Pacer
from rsb_bridge.channel.scheduler import Carrier
from rsb_bridge.channel.window import LEAST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.scheduler import Scheduler
    from rsb_bridge.transport.transport import DatagramSocket
    from rsb_bridge.wire.datagram import Arrived, Receipt

# Where these were measured: bench/README.md, *Constants of datagrams*.
_ASKS_EVERY = 0.25  # s after which the next datagram asks for a receipt: the sender learns soon that none comes
_PARTS = 4  # it also asks after each such part of what may be in transit, as the window of the streams does
_FIRST_PAUSE, _LONGEST_PAUSE = 0.4, 0.8  # s until a datagram that tries whether any arrives is written off
_NEW = 2.0  # s after the first datagram in which the first receipt may still come


class Datagrams(Protocol):
    """The UDP channel whose datagrams take turns, as far as its carrier knows it."""

    socket: DatagramSocket
    ready: bool

    def send(self, datagrams: Sequence[bytes]) -> None: ...


class DatagramSource(Protocol):
    """The sending end of a route's channel."""

    def receipt(self, arrived: Arrived, buffer: int) -> None:
        """Take the route's part of a receipt; the receiver's buffer has so many bytes."""

    def written_off(self, *, drop_rest: bool) -> None:
        """Count all datagrams that were sent as no longer in transit, and `drop_rest` of a message that has begun."""


class DatagramCarrier(Carrier):
    """The datagrams of all routes that share a socket. They count in the link's window as a stream's bytes do.

    A receipt tells the newest datagram of a route. All before it are no longer in transit: they have arrived, or are
    lost. If no receipt comes, all are written off, and only a little is sent until one comes: a path on which nothing
    arrives must not keep the window full, and one that takes datagrams again must be noticed.

    Attributes:
        senders: sending ends of its routes, by the route's id.
        pacer: the pace of the path.
        proven: whether datagrams arrive, by the last receipt.
        asked_at: when (s) a datagram asked for a receipt last.
    """

    def __init__(self, channel: Datagrams, scheduler: Scheduler) -> None:
        super().__init__(scheduler)
        self.senders: dict[int, DatagramSource] = {}
        self.pacer = Pacer()
        self.proven = self._tried = False
        self._channel = channel
        self._loop = asyncio.get_running_loop()
        self._now = self._loop.time()
        self._new_until = math.inf  # s; the first receipt may come until then
        self._datagrams = 0  # sent so far
        self._counted = self._missing = 0  # datagrams that are no longer in transit, and how many of them have not come
        self._told = (0, 0)  # the two by the last receipt
        self._unasked, self.asked_at = 0, -math.inf
        self._unanswered = math.inf  # since when (s) a receipt is asked for
        self._timer: asyncio.TimerHandle | None = None
        self._pause = _FIRST_PAUSE
        channel.socket.when_writable.add(self.writable)

    @property
    def in_transit(self) -> int:
        return self.pacer.in_transit

    @property
    def congested(self) -> bool:
        channel = self._channel
        if channel.socket.congested or not channel.ready or self.over:
            return True
        if self.room() > 0:
            return False
        if self._timer is None:
            # No event tells that the pace allows more, so a timer wakes the scheduler.
            pause = self.pacer.pause() if self.proven else self._pause
            self._timer = self._loop.call_later(pause, self._go_on)
        return True

    @property
    def moves(self) -> bool:
        return self.proven and super().moves

    @property
    def is_new(self) -> bool:
        """Whether the first receipt may still come."""
        return not self.over and self._loop.time() < self._new_until

    def room(self) -> int:
        """Return the bytes that may be sent now."""
        self._now = self._loop.time()
        room = self.pacer.room(self._now, self.scheduler.waits_since)
        return room if self.proven else min(room, LEAST - self.pacer.in_transit)

    def asks(self, size: int) -> bool:
        """Whether the next datagrams, of `size` bytes together, have to ask for a receipt."""
        self._unasked += size
        most = min(self.scheduler.window.every, self.pacer.limit // _PARTS)
        # Where asking or the answer got lost, every datagram asks, so that what gets lost by chance stops nothing.
        overdue = self._now > self._unanswered + self.pacer.patience / 2
        if self.proven and self._unasked < most and self._now - self.asked_at < _ASKS_EVERY and not overdue:
            return False
        self._unasked, self.asked_at = 0, self._now
        self._unanswered = min(self._unanswered, self._now)
        return True

    def send(self, datagrams: Sequence[bytes], size: int, times: int = 1) -> None:
        """Send datagrams, so many times each, of `size` bytes in all."""
        if not self._datagrams:
            self._new_until = min(self._new_until, self._now + _NEW)
        now = self.scheduler.count(size)
        if not self.pacer.in_transit:
            self.moved_at = now
        self._datagrams += len(datagrams)
        self.pacer.sent(size, self._datagrams - 1, self._now)
        self._channel.send(datagrams if times == 1 else [*datagrams] * times)

    # --- receipts

    def count(self, datagrams: int, missing: int) -> None:
        """Count further datagrams of a route that are not in transit, and further ones of them that have not come."""
        self._counted += datagrams
        self._missing += missing

    def receipt(self, receipt: Receipt) -> None:
        before = self.pacer.in_transit
        for each in receipt.arrived:
            if (sender := self.senders.get(each.route)) is not None:
                sender.receipt(each, receipt.buffer)
        now = self._loop.time()
        self.pacer.receipt(self._counted - 1, self._counted - self._missing, receipt.buffer, receipt.at / 1e6, now)
        self._stop_timer()
        self.proven, self._tried = True, False
        self._new_until = -math.inf
        self._unanswered = math.inf
        self._pause = _FIRST_PAUSE
        self.moved_at = now
        (datagrams, missing), self._told = self._told, (self._counted, self._missing)
        datagrams, missing = self._counted - datagrams, self._missing - missing
        gained = before - self.pacer.in_transit
        # A late receipt after a write-off may tell of fewer that are missing, and of no further datagram.
        lost = gained * max(0, missing) // datagrams if datagrams > max(0, missing) else gained
        self.scheduler.acknowledge(gained, lost)

    def write_off(self) -> None:
        """Count what is in transit no longer, and send little until a receipt comes."""
        for sender in self.senders.values():
            sender.written_off(drop_rest=self._tried)  # its beginning has probably not arrived
        self._tried = not self.proven  # a first datagram may only be late, and its message goes on
        self.proven = False
        self.pacer.write_off()

    def write_gathered(self) -> None:
        """Do nothing: datagrams leave as they are made."""

    def tick(self) -> None:
        """Write off bytes that no receipt has covered. Called once a second."""
        if self.is_stuck(self._loop.time()):
            self._give_up()

    def _give_up(self) -> None:
        size = self.in_transit
        self.write_off()
        self.scheduler.written_off(size)

    def _go_on(self) -> None:
        self._timer = None
        if not self.proven:
            self._pause = _LONGEST_PAUSE
        if not self.proven or self.pacer.gives_up(self._loop.time()):
            self._give_up()
        self.scheduler.run()

    def close(self) -> None:
        self.over = True
        self._channel.socket.when_writable.discard(self.writable)
        self._stop_timer()
        self.scheduler.remove(self)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
