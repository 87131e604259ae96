"""Channels of reliable topics over datagrams: lost datagrams are sent again, and each message comes once and in order.

A receipt lists the last datagrams that have arrived. The sender sends the content of the others again under new
sequence numbers, as QUIC does (RFC 9002). It names the message and the piece, so that the receiver drops a second copy.
New messages leave the route's queue only after that, so that no more than a window waits here.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.channel.channel import Counts
from rsb_bridge.channel.datagram_channel import DatagramReceiver, DatagramSender
from rsb_bridge.model.fates import Fate, Lost
from rsb_bridge.wire.datagram import DatagramReader, OrderedReader

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator, Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.wire.datagram import Arrived, Cut, DatagramWriter
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Buffer

_WINDOW = 1024  # sequence numbers of which a receipt can tell (`rsb_bridge.wire.sealing.DatagramOpener`)
_LATER = 1.25  # round trips after which a datagram that a later one has overtaken is lost (RFC 9002, 6.1.2: 9/8)
_GAP_TOLD_EVERY = 0.01  # s between receipts about gaps: further datagrams of a burst tell nothing new. A round figure
_QUEUED = -1  # in place of a sequence number: the piece waits to be sent, or sent again


_Sent: TypeAlias = tuple[int, dict[int, int], int, float]
"""The number of a message, `_Unacknowledged.pieces` of its cut, a piece of these, and when (s) that was sent."""


class _Unacknowledged:
    """A message of which some pieces may not have arrived.

    Attributes:
        size: bytes of the datagrams that it is cut for, or 0 if they are not known yet.
        pieces: the newest sequence number of each piece that is not acknowledged.
    """

    __slots__ = ("cut", "message", "pieces", "size")

    def __init__(self, message: Message, size: int, pieces: dict[int, int]) -> None:
        self.message, self.size, self.pieces = message, size, pieces
        self.cut: Cut | None = None  # once something is sent again


class ReliableSender(DatagramSender):
    """The sending end.

    Attributes:
        unacknowledged: messages that may not have arrived, by their numbers.
    """

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramWriter) -> None:
        super().__init__(udp_channel, route, codec)
        self.unacknowledged: dict[int, _Unacknowledged] = {}
        self._flight: dict[int, _Sent] = {}  # by sequence number
        self._again: list[tuple[int, int]] = []  # messages and pieces, a heap: the oldest go first
        self._newest, self._absent = -1, 0  # by the last receipt
        self._moved_at = 0.0  # when (s) something was sent or a receipt came last
        self._timer: asyncio.TimerHandle | None = None

    @property
    def waits(self) -> bool:
        return bool(self._again) or super().waits

    # --- sending

    def take_turn(self, limit: int) -> int:
        if self._again and (datagrams := self._send_again(min(limit, self.via.room()))):
            return self._pass(datagrams)
        return super().take_turn(limit)

    def _send_again(self, limit: int) -> Sequence[bytes]:
        """Seal again what is lost, the oldest first: about `limit` bytes."""
        datagrams: list[bytes] = []
        size = 0
        while self._again and (not datagrams or size < limit):
            number, index = heapq.heappop(self._again)
            kept = self.unacknowledged.get(number)
            if kept is None or kept.pieces.get(index) != _QUEUED:
                continue  # its receipt has come at last
            if (cut := self._cut_again(number, kept)) is None:
                continue
            length = len(cut.pieces[index])
            asks = self.via.asks(length + self._codec.overhead) or not datagrams
            self._note(number, kept.pieces, range(index, index + 1), self._codec.sequence)
            datagrams += self._codec.write_pieces(cut, index, index + 1, asks=asks)
            size += length
        return datagrams

    def _cut_again(self, number: int, kept: _Unacknowledged) -> Cut | None:
        """Return a message in the pieces that it had, or None if the path takes only smaller ones now: all go again."""
        size = self._udp_channel.datagram_size()
        if kept.cut is None and kept.size:
            kept.cut = self._codec.cut_again(number, kept.message, kept.size)
        if kept.cut is not None and (size >= kept.size or len(kept.cut.pieces[0]) <= self._codec.room(size)):
            return kept.cut
        if self._cut is not None and self._cut is kept.cut:
            self._cut, self._at = None, 0  # its further pieces would be too long, too
        kept.size, kept.cut = size, self._codec.cut_again(number, kept.message, size)
        kept.pieces = dict.fromkeys(range(len(kept.cut.pieces)), _QUEUED)
        for index in kept.pieces:
            heapq.heappush(self._again, (number, index))
        return None

    def _send(self, batch: Sequence[Message], size: int) -> int:
        codec, datagram = self._codec, self._udp_channel.datagram_size()
        before, sequence = codec.number, codec.sequence
        passed = super()._send(batch, size)
        for number, message in enumerate(batch, before + 1):
            pieces: dict[int, int] = {}
            self.unacknowledged[number] = _Unacknowledged(message, datagram, pieces)
            sequence = self._note(number, pieces, range(codec.datagrams(len(message[0]), datagram)), sequence)
        return passed

    def _go_on(self, cut: Cut, limit: int) -> int:
        codec, begin, sequence = self._codec, self._at, self._codec.sequence
        number = codec.number
        passed = super()._go_on(cut, limit)
        if not begin:
            message, pieces = (bytes(cut.payload), cut.stamp, cut.flags), dict.fromkeys(range(len(cut.pieces)), _QUEUED)
            kept = self.unacknowledged[number] = _Unacknowledged(message, self._udp_channel.datagram_size(), pieces)
            kept.cut = cut
        self._note(
            number, self.unacknowledged[number].pieces, range(begin, begin + codec.sequence - sequence), sequence
        )
        return passed

    def _note(self, number: int, pieces: dict[int, int], sent: range, sequence: int) -> int:
        """Note that pieces are sent, from a sequence number on; return the number after them."""
        now = self._moved_at = self._loop.time()
        for index in sent:
            self._flight[sequence] = number, pieces, index, now
            pieces[index] = sequence
            sequence += 1
        if self._timer is None:
            self._watch(self.via.pacer.patience)
        return sequence

    # --- what has arrived

    def receipt(self, arrived: Arrived, buffer: int) -> None:
        before, _ = self._receipted
        super().receipt(arrived, buffer)
        newest, _ = self._receipted
        if newest > before:
            self._newest, self._absent = newest, arrived.missing >> max(0, arrived.newest - newest)
            self._moved_at = self._loop.time()
        elif newest == before == arrived.newest:
            self._absent &= arrived.missing  # only older ones have come since
        self._settle()

    def _settle(self) -> None:
        """Find out by the last receipt which datagrams have arrived, and which are lost."""
        now, flight = self._loop.time(), self._flight
        later = _LATER * self.via.pacer.round_trip
        suspected = None
        for sequence in [*self._covered()]:
            back = self._newest - sequence
            if back < _WINDOW and not self._absent >> back & 1:
                self._acknowledge(*flight.pop(sequence)[:3])
            elif (left := flight[sequence][3] + later - now) <= 0.0:
                self._lost(sequence, flight.pop(sequence))
            elif suspected is None:
                suspected = left  # overtaken by a later one, but it may still come
        if self._again:
            self._scheduler.join(self)  # what takes the receipt gives the turns
        if suspected is not None:
            self._watch(max(0.001, suspected))

    def _covered(self) -> Iterator[int]:
        """Yield the sequence numbers in flight up to the newest one of the last receipt."""
        for sequence in self._flight:
            if sequence > self._newest:
                return
            yield sequence

    def _acknowledge(self, number: int, pieces: dict[int, int], index: int) -> None:
        pieces.pop(index, None)
        if not pieces and (kept := self.unacknowledged.get(number)) is not None and kept.pieces is pieces:
            del self.unacknowledged[number]

    def _lost(self, sequence: int, sent: _Sent) -> None:
        """Have a piece sent again, unless it has come or is sent again already."""
        number, pieces, index, _ = sent
        if pieces.get(index) == sequence and self.unacknowledged[number].pieces is pieces:
            pieces[index] = _QUEUED
            heapq.heappush(self._again, (number, index))

    def _watch(self, seconds: float) -> None:
        """Look again after some time, or earlier."""
        if self._timer is not None:
            if self._timer.when() <= self._loop.time() + seconds:
                return
            self._timer.cancel()
        self._timer = self._loop.call_later(seconds, self._look)

    def _look(self) -> None:
        """Send the newest datagram again if nothing has been heard of it: no later one makes a receipt tell of it."""
        self._timer = None
        if not self._flight or self.is_suspended:
            return
        patience = self.via.pacer.patience
        # One datagram that asks is enough for all routes. But its receipt tells nothing of a route whose last one got
        # lost: beside routes that ask all the time, it waits for one answer only.
        asked_at = min(self.via.asked_at, self._moved_at + patience)
        if not self._again and self._loop.time() - max(self._moved_at, asked_at) >= patience:
            sequence, sent = next(reversed(self._flight.items()))
            if sequence > self._newest:
                self._lost(sequence, sent)
        self._watch(patience)
        self._settle()
        self._scheduler.run()

    def written_off(self, *, drop_rest: bool) -> None:
        super().written_off(drop_rest=False)
        for sequence, sent in self._flight.items():
            self._lost(sequence, sent)
        # A late receipt may tell of the newest ones.
        for sequence in [*self._flight][:-_WINDOW]:
            del self._flight[sequence]

    # --- the next connection

    def resume(self, udp_channel: UdpChannel, keys: DataKeys) -> None:
        self._flight.clear()
        self._again.clear()
        self._newest, self._absent = -1, 0
        # Whole, as the receiver has discarded incomplete ones.
        for number, kept in self.unacknowledged.items():
            kept.size, kept.cut, kept.pieces = 0, None, {0: _QUEUED}
            self._again.append((number, 0))
        super().resume(udp_channel, keys)

    def close(self, reason: str) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().close(reason)


class ReliableReceiver(DatagramReceiver):
    """The receiving end."""

    _codec: OrderedReader

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: OrderedReader) -> None:
        super().__init__(udp_channel, route, codec)
        self._gap_told_at = float("-inf")

    def counts(self) -> Counts:
        return Counts(newest=None)

    def received(self, datagrams: Sequence[Buffer], now: float) -> bool:
        came = super().received(datagrams, now)
        if self._codec.has_gap and now - self._gap_told_at >= _GAP_TOLD_EVERY:
            self._gap_told_at = now
            self._udp_channel.send_receipts()
        return came

    def _open(self, datagrams: Sequence[Buffer], now: float) -> list[Message]:
        codec = self._codec
        whole: list[Message] = []
        for datagram in datagrams:
            if (message := codec.receive(datagram, now)) is not None:
                whole += (message, *codec.following)
                codec.following = []
        return whole

    def news(self) -> Arrived | None:
        news = super().news()
        return None if news is None else news._replace(missing=self._codec.missing)


def datagram_channel(udp_channel: UdpChannel, route: RouteSink, keys: DataKeys) -> DatagramSender | DatagramReceiver:
    """Return this side's end of a route's channel on a UDP channel."""
    reliable = route.fates[Lost.DATAGRAM] is Fate.SENDS_AGAIN
    if route.outgoing:
        return (ReliableSender if reliable else DatagramSender)(udp_channel, route, keys.datagram_writer(route.id))
    if reliable:
        return ReliableReceiver(udp_channel, route, keys.datagram_reader(route.id, OrderedReader))
    return DatagramReceiver(udp_channel, route, keys.datagram_reader(route.id, DatagramReader))
