"""Channels whose messages go as datagrams, over a UDP channel that they share."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import Counts, Pace
from rsb_bridge.channel.udp_channel import BufferShortage
from rsb_bridge.transport.streams import BATCH_BYTES, PacketCounts
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.wire.datagram import Receipt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Buffer

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
"""Seconds without a receipt after which sent bytes count as arrived or lost."""
_SPAN = 0.005
"""s, at least, over which the path's rate is measured."""


class Pacer:
    """The pace of one route. It sends nothing itself; times are in s, on one clock.

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
        self._began = 0.0
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
            return 0 if self._sent >= _FIRST_BURST and now - self._began < _FIRST_WAIT else int(tokens)
        left = self.window + self._on_path - (self._sent - self._arrived)
        if left <= 0 and now - max(self._under_way[-1][2], self._heard_at) >= _PATIENCE:
            self._arrived = self._sent
            self._passed = self._under_way[-1][:2]
            self._under_way.clear()
            left = self.window
        return int(tokens if tokens < left else left)

    def pause(self) -> float:
        """Time (s) until it is worth asking for room again, where no receipt comes before."""
        return _PAUSE if self._tokens <= 0 or not self.window else _PATIENCE

    def sent(self, size: int, sequence: int, now: float) -> None:
        """Note that `size` bytes were sent; the last datagram had this sequence number."""
        if not self._sent:
            self._began = now
        self._tokens -= size
        self._sent += size
        self._under_way.append((sequence, self._sent, now))
        if not self.window and len(self._under_way) > 1 and now - self._under_way[0][2] > _PATIENCE:
            self._passed = self._under_way.popleft()[:2]  # a peer that sends no receipts
            self._arrived = self._passed[1]

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


_RATE_OVER, _RATE_LASTS = 1.0, 2.5
"""s between the receipts from which the rate of arrival is computed, and s for which it counts."""
_MOST_RECEIPTS = 64
_EXPIRE = 1.0
"""s without a fragment of it, after which an incomplete message is given up."""
_RECEIPTS_PER_BUFFER = 4 * WINDOW
"""The receiver says what has come each time a quarter of the sender's window has."""


class _DatagramChannel:
    """The part that both ends share."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink) -> None:
        self.carrier = udp_channel
        self._route = route
        self._route_id = route.id

    @property
    def ready(self) -> bool:
        return self.carrier.ready

    def trouble(self) -> str:
        return self.carrier.trouble

    def close(self, reason: str) -> None:
        self.carrier.remove(self._route_id)


class DatagramSender(_DatagramChannel):
    """The sending end. What the pace holds up waits here, sealed; nothing more is sealed meanwhile."""

    batch_bytes = BATCH_BYTES
    arrived_share: float | None = None
    """The share of the datagrams that arrives, by the last receipts, or None before the first."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramWriter) -> None:
        super().__init__(udp_channel, route)
        self._codec = codec
        self._loop = asyncio.get_running_loop()
        self._pacer = Pacer()
        self._waiting: Sequence[bytes] = ()
        self._timer: asyncio.TimerHandle | None = None
        self._receipted = (-1, 0)  # the newest datagram of the last receipt, and how many had arrived
        self._receipted_at = float("-inf")
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=_MOST_RECEIPTS)  # time (s), arrivals by then
        udp_channel.add_sender(route.id, self)

    @property
    def congested(self) -> bool:
        return bool(self._waiting) or self.carrier.socket.congested

    @property
    def pace(self) -> Pace:
        return Pace.STOPPED if self.congested else Pace.FREE

    def ask(self) -> None:
        """Do nothing: the timer of what the pace holds up, or the socket, has the route's queue flushed."""

    def datagrams(self, size: int) -> int:
        """Return how many datagrams a message of `size` bytes takes now; only once it is ready."""
        return self._codec.datagrams(size, self.carrier.datagram_size())

    def send(self, batch: Sequence[Message]) -> None:
        datagrams = self._codec.write_many(batch, self.carrier.datagram_size())
        self._waiting = [*self._waiting, *datagrams] if self._waiting else datagrams
        if self._timer is None:
            self._send_waiting()

    def close(self, reason: str) -> None:
        self._waiting = ()
        if self._timer is not None:
            self._timer.cancel()
        super().close(reason)

    def writable(self) -> None:
        """See `DatagramSource.writable`."""
        if self._timer is None:
            self._go_on()

    def receipt(self, receipt: Receipt) -> None:
        """See `DatagramSource.receipt`."""
        newest, opened = self._receipted
        if receipt.newest > newest:
            share = max(0.0, min((receipt.opened - opened) / (receipt.newest - newest), 1.0))
            self.arrived_share = share if self.arrived_share is None else (share + self.arrived_share) / 2
            self._receipted = receipt.newest, receipt.opened
            self._receipted_at = self._loop.time()
            self._note_arrivals(receipt.opened, self._loop.time())
        self._pacer.receipt(receipt.newest, receipt.opened, receipt.buffer, self._loop.time())
        if receipt.buffer < RECEIVE_BUFFER and self._codec.largest > self._pacer.window:
            self.carrier.shortages[False] = BufferShortage(False, receipt.buffer, self._codec.largest)
        if self._timer is not None:
            self._timer.cancel()
            self._go_on()

    @property
    def unheard_for(self) -> float:
        """Seconds since a receipt told of further datagrams; infinite before the first."""
        return self._loop.time() - self._receipted_at

    def packets(self) -> PacketCounts:
        """Return the counts of datagrams, by the last receipt."""
        newest, opened = self._receipted
        return PacketCounts(newest + 1, max(0, newest + 1 - opened), newest + 1, 0, 0)

    def _note_arrivals(self, opened: int, now: float) -> None:
        arrivals = self._arrivals
        while len(arrivals) > 1 and now - arrivals[1][0] >= _RATE_OVER:
            arrivals.popleft()
        if len(arrivals) < _MOST_RECEIPTS:
            arrivals.append((now, opened))
        else:
            arrivals[-1] = now, opened

    def arrival_rate(self) -> float:
        """Return the datagrams/s that arrive by the last receipts, or 0 if they are too old."""
        if len(self._arrivals) < 2:
            return 0.0
        (began, before), (at, opened) = self._arrivals[0], self._arrivals[-1]
        if at - began < _RATE_OVER or self._loop.time() - at > _RATE_LASTS:
            return 0.0
        return max(0.0, (opened - before) / (at - began))

    def _go_on(self) -> None:
        self._timer = None
        self._send_waiting()
        if not self.congested:
            self._route.flush()

    def _send_waiting(self) -> None:
        """Send as much as the pace allows, and set the timer for the rest; while the socket is congested it calls."""
        while self._waiting and not self.carrier.socket.congested:
            now = self._loop.time()
            room = self._pacer.room(now)
            if room <= 0:
                self._timer = self._loop.call_later(self._pacer.pause(), self._go_on)
                return
            waiting, self._waiting = self._waiting, ()
            size = sum(map(len, waiting))
            if size > room:
                size, count = 0, 0
                while size < room:
                    size += len(waiting[count])
                    count += 1
                waiting, self._waiting = waiting[:count], waiting[count:]
            self.carrier.send(waiting)
            self._pacer.sent(size, self._codec.sequence - len(self._waiting) - 1, now)


class DatagramReceiver(_DatagramChannel):
    """The receiving end."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramReader) -> None:
        super().__init__(udp_channel, route)
        self._codec = codec
        self._buffer = udp_channel.socket.receive_buffer
        self._due = 1  # opened bytes at which the next receipt is due: the sender knows the buffer once anything comes
        self._missing = 0  # datagrams, at the last receipt
        udp_channel.add_receiver(route.id, self)

    def counts(self) -> Counts | None:
        return Counts(self._codec.newest, self._codec.pending, self._codec.expired)

    def close(self, reason: str) -> None:
        self._codec.close()
        super().close(reason)

    def received(self, datagrams: Sequence[Buffer], now: float) -> bool:
        """See `DatagramSink.received`."""
        receive = self._codec.receive
        whole: list[Message] = []
        for datagram in datagrams:
            message = receive(datagram, now)
            if message is not None:
                whole.append(message)
        if self._codec.opened_bytes >= self._due:
            self._acknowledge()
        if not whole:
            return False
        if self._buffer < RECEIVE_BUFFER:
            self._check_buffer(max(len(payload) for payload, _, _ in whole))
        self._route.deliver(whole)
        return True

    def _acknowledge(self) -> None:
        codec = self._codec
        self._due = codec.opened_bytes + self._buffer // _RECEIPTS_PER_BUFFER
        self._missing = codec.newest_sequence + 1 - codec.opened
        self.carrier.acknowledge(Receipt(self._route_id, codec.newest_sequence, codec.opened, self._buffer))

    def expire(self, now: float) -> None:
        """Give up messages whose fragments did not come in time."""
        self._codec.expire(now, _EXPIRE)
        missing = self._codec.newest_sequence + 1 - self._codec.opened
        if missing > self._missing and self._codec.opened:
            self._acknowledge()  # so the sender learns within a second how much is lost
        if self._buffer < RECEIVE_BUFFER:  # its limit may have been raised
            before, self._buffer = self._buffer, self.carrier.socket.receive_buffer
            if self._buffer != before:
                # At once: the sender, whose window is still the old one, would wait for a receipt each time.
                self._due = 1

    def _check_buffer(self, largest: int) -> None:
        if largest > self._buffer // WINDOW:
            self.carrier.shortages[True] = BufferShortage(True, self._buffer, largest)


def datagram_channel(udp_channel: UdpChannel, route: RouteSink, keys: DataKeys) -> DatagramSender | DatagramReceiver:
    """Return this side's end of a route's channel on a UDP channel."""
    if route.outgoing:
        return DatagramSender(udp_channel, route, keys.datagram_writer(route.id))
    return DatagramReceiver(udp_channel, route, keys.datagram_reader(route.id))
