"""Channels whose messages go as datagrams, over a UDP channel that they share."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import REOPENS, Counts, DataChannel, ReceivingChannel
from rsb_bridge.channel.pacing import WINDOW
from rsb_bridge.channel.scheduler import SendingChannel
from rsb_bridge.channel.udp_channel import TIMES, BufferShortage
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.transport.streams import PacketCounts
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.wire.datagram import Arrived
from rsb_bridge.wire.framing import LEASED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.datagram_carrier import DatagramCarrier
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.wire.datagram import Cut, DatagramReader, DatagramWriter
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Buffer

_REPEATS, _REPEATED_AFTER = 5, 0.1
"""How often the last command is sent again, and s from one to the next: no further one makes up for a lost stop. On a
link that loses 30 %, its first two copies get lost once in 11 times, and all seven once in 4,500."""


class DatagramEnd(DataChannel):
    """The base of both ends. An end is suspended by the end of its UDP channel, which comes with the connection's."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink) -> None:
        self.route = route
        self._udp_channel = udp_channel
        self._route_id = route.id
        self._was_ready = False  # on the connection before, as messages wait for the path of this one

    @property
    def is_suspended(self) -> bool:
        """Whether it waits for a UDP channel of the link's next connection."""
        return self._udp_channel.over

    @property
    def ready(self) -> bool:
        return self._was_ready or self._udp_channel.ready

    def trouble(self) -> Verdict | None:
        if self.is_suspended or (self._was_ready and not self._udp_channel.ready):
            return Verdict(State.WAITING, Cause.AWAITS_LINK, REOPENS)
        if text := self._udp_channel.trouble:
            return Verdict(State.DOWN, Cause.NO_PATH, text)
        return None

    def resume(self, udp_channel: UdpChannel, keys: DataKeys) -> None:
        """Go on over a UDP channel of the link's next connection."""
        self._was_ready = self.ready
        self._udp_channel = udp_channel

    def close(self, reason: str) -> None:
        self._udp_channel.remove(self._route_id)


class DatagramSender(DatagramEnd, SendingChannel):
    """The sending end, a `DatagramSource`.

    A message that has begun is sent whole, unless its beginning was written off.
    """

    via: DatagramCarrier

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramWriter) -> None:
        super().__init__(udp_channel, route)
        SendingChannel.__init__(self, route, udp_channel.sending())
        self._codec = codec
        self._loop = asyncio.get_running_loop()
        self._cut: Cut | None = None  # of a message that takes several turns
        self._at = 0  # pieces of it that are sent
        self._counted = self._missing = 0  # datagrams that are no longer in transit, and how many of them have not come
        self._receipted = (-1, 0)  # the newest datagram of the last receipt, and how many had arrived
        self._receipted_at = float("-inf")
        self._command: Sequence[bytes] = ()  # the last one, which may be sent again
        self._repeats = 0  # of it, that are left
        self._repeat_at = 0.0
        self._repeating: asyncio.TimerHandle | None = None
        self.via.senders[route.id] = self

    @property
    def congested(self) -> bool:
        return self._cut is not None or super().congested

    @property
    def waits(self) -> bool:
        return self._cut is not None or super().waits

    @property
    def free(self) -> bool:
        return self.via.is_new or (super().free and not (self.congested and self.via.pacer.path.known))

    def datagrams(self, size: int) -> int:
        return self._codec.datagrams(size, self._udp_channel.datagram_size())

    def send(self, batch: Sequence[Message]) -> None:
        if self._in_turn:
            self._messages += batch
            return
        size = sum([len(payload) for payload, _, _ in batch])
        if size <= self._scheduler.chunk:
            # No turn is due, so there is none to wait for: the hot path.
            self._scheduler.charge(self.via, ((self, self._send(batch, size)),))
            return
        self._wait(batch)

    def take_turn(self, limit: int) -> int:
        if self._cut is None and not self._messages and not self._fill():
            return 0
        limit = min(limit, self.via.room())
        if self._cut is not None:
            return self._go_on(self._cut, limit)
        batch: list[Message] = []
        size = 0
        # A message that fits into one datagram is not cut, however little room is left.
        most = max(limit, self._codec.room(self._udp_channel.datagram_size()))
        while self._messages and size < limit:
            length = len(self._messages[0][0])
            if length > most or (batch and size + length > limit):
                break
            batch.append(self._messages.popleft())
            size += length
        if batch:
            return self._send(batch, size)
        if not self._messages:
            return 0
        self._cut = self._codec.cut(self._messages.popleft(), self._udp_channel.datagram_size())
        return self._go_on(self._cut, limit)

    def _go_on(self, cut: Cut, limit: int) -> int:
        """Send the next pieces of a message."""
        begin, count = self._at, len(cut.pieces)
        length = len(cut.pieces[begin])
        end = min(begin + max(1, limit // length), count)  # at least one, or its turns would come without end
        datagrams = self._codec.write_pieces(
            cut, begin, end, asks=self.via.asks((end - begin) * (length + self._codec.overhead))
        )
        self._cut, self._at = (cut, end) if end < count else (None, 0)
        return self._pass(datagrams)

    def _send(self, batch: Sequence[Message], size: int) -> int:
        datagrams = self._codec.write_many(
            batch, self._udp_channel.datagram_size(), asks=self.via.asks(size + len(batch) * self._codec.overhead)
        )
        # A network of routers, whose sockets have no port, loses them where it is congested, which more make worse.
        is_command = len(datagrams) == 1 and batch[0][2] & LEASED and self._udp_channel.socket.port
        if not is_command:
            return self._pass(datagrams)
        passed = self._pass(datagrams, TIMES)
        self._command, self._repeats, self._repeat_at = datagrams, _REPEATS, self._loop.time() + _REPEATED_AFTER
        if self._repeating is None:  # else the timer that runs finds the new time: none is set for each command
            self._repeating = self._loop.call_at(self._repeat_at, self._repeat)
        return passed

    def _repeat(self) -> None:
        """Send the last command again, if no message has followed; the receiver opens it once."""
        self._repeating = None
        if not self._repeats:
            return
        now = self._loop.time()
        if now >= self._repeat_at:
            self._udp_channel.send(self._command)
            self._repeats -= 1
            self._repeat_at = now + _REPEATED_AFTER
        self._repeating = self._loop.call_at(self._repeat_at, self._repeat)

    def _pass(self, datagrams: Sequence[bytes], times: int = 1) -> int:
        self._repeats = 0  # an earlier frame must not come after these
        size = times * sum(map(len, datagrams))
        self.via.send(datagrams, size, times)
        return size

    def resume(self, udp_channel: UdpChannel, keys: DataKeys) -> None:
        super().resume(udp_channel, keys)
        self._codec.resume(keys.keys.route_sealer(self._route_id, keys.role), keys.keys.link_id)
        self._counted = self._missing = 0
        self._receipted = (-1, 0)
        self._cut, self._at = None, 0
        self.via, self.start = udp_channel.sending(), 0
        self.via.senders[self._route_id] = self
        if self.waits:
            self._scheduler.join(self)

    def close(self, reason: str) -> None:
        if self._repeating is not None:
            self._repeating.cancel()
        self.leave()
        self.written_off(drop_rest=True)  # no receipt tells of a route that is closed: its bytes would stay in transit
        super().close(reason)

    def receipt(self, arrived: Arrived, buffer: int) -> None:
        # A peer may claim more than was sent.
        newest = min(arrived.newest, self._codec.sequence - 1)
        opened = min(arrived.opened, newest + 1)
        before, _ = self._receipted
        if newest <= before:
            return  # another one has overtaken it
        self._receipted = newest, opened
        self._receipted_at = self._loop.time()
        # After a write-off, more are counted than a late receipt tells of.
        self._count(max(newest + 1, self._counted), newest + 1 - opened)
        if buffer < RECEIVE_BUFFER and self._codec.largest > buffer // WINDOW:
            self._udp_channel.shortages[False] = BufferShortage(buffer, self._codec.largest)

    def _count(self, counted: int, missing: int) -> None:
        self.via.count(counted - self._counted, missing - self._missing)
        self._counted, self._missing = counted, missing

    def written_off(self, *, drop_rest: bool) -> None:
        self._count(self._codec.sequence, self._missing)
        if drop_rest:
            self._cut, self._at = None, 0

    @property
    def unheard_for(self) -> float:
        return self._loop.time() - self._receipted_at

    def packets(self) -> PacketCounts:
        """Return the counts of datagrams, by the last receipt."""
        newest, opened = self._receipted
        return PacketCounts(newest + 1, max(0, newest + 1 - opened), newest + 1, 0, 0)


class DatagramReceiver(DatagramEnd, ReceivingChannel):
    """The receiving end, a `DatagramSink`."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramReader) -> None:
        super().__init__(udp_channel, route)
        self._codec = codec
        self._told = 0  # opened datagrams, at the last receipt
        udp_channel.receivers[route.id] = self

    def counts(self) -> Counts:
        return Counts(self._codec.newest, self._codec.pending, self._codec.expired)

    def close(self, reason: str) -> None:
        self._codec.close()
        super().close(reason)

    def received(self, datagrams: Sequence[Buffer], now: float) -> bool:
        whole = self._open(datagrams, now)
        if self._codec.asked:
            self._codec.asked = False
            self._udp_channel.asked()
        if not whole:
            return False
        buffer = self._udp_channel.receive_buffer
        if buffer < RECEIVE_BUFFER:
            largest = max(len(payload) for payload, _, _ in whole)
            if largest > buffer // WINDOW:
                self._udp_channel.shortages[True] = BufferShortage(buffer, largest)
        self.route.deliver(whole)
        return True

    def _open(self, datagrams: Sequence[Buffer], now: float) -> list[Message]:
        """Return the messages that datagrams make whole."""
        receive = self._codec.receive
        return [message for each in datagrams if (message := receive(each, now)) is not None]

    def news(self) -> Arrived | None:
        codec = self._codec
        if codec.opened == self._told:
            return None
        self._told = codec.opened
        return Arrived(self._route_id, codec.newest_sequence, codec.opened)

    def expire(self, now: float) -> None:
        self._codec.expire(now)

    def resume(self, udp_channel: UdpChannel, keys: DataKeys) -> None:
        super().resume(udp_channel, keys)
        self._codec.resume(keys.keys.datagram_opener(self._route_id, keys.peer_role))
        self._told = 0
        udp_channel.receivers[self._route_id] = self
