"""Datagrams: fragments of messages, sealed, opened and reassembled (PROTOCOL.md, 2)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from rsb_bridge.wire.framing import LEASED, MESSAGE_LIMIT, UNFINISHED_LIMIT, Budget, Message
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealing import Buffer, DatagramOpener, Sealer, SealError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

Origin = TypeVar("Origin")

MAGIC = 0xB5
FRAGMENTS_LIMIT = 65535  # the header has 16 bits for them
_HEADER = struct.Struct(">BBHHI8sQIQ")
_HEADER_SIZE = _HEADER.size
_unpack_addressee = struct.Struct(">I8s").unpack_from
_ASKS = 2  # a flag: the sender of the datagram wants a receipt now
_PROBE = struct.Struct(">?Q")
_RECEIPT, _ARRIVED = struct.Struct(">BIQ"), struct.Struct(">IQQB")
_RECEIPT_KIND, _URGENT_KIND = 2, 3
_LONGEST_RECEIPT = 1100  # bytes: one fits into a datagram of 1,200
# s without a fragment of it, after which an incomplete message is given up: the newest one's may wait for turns.
_EXPIRES, _NEWEST_EXPIRES = 1.0, 5.0
_FRAGMENT_COST = 400
"""Bytes of memory that a fragment takes beyond its content: many tiny ones must not take more than is counted. The only
fragment of a message takes the most, some 390 in CPython 3.11 (`sys.getsizeof` of its record, dict and bytes)."""


def by_addressee(datagrams: Iterable[tuple[Buffer, Origin]]) -> dict[tuple[int, bytes, Origin], list[Buffer]]:
    """Sort datagrams by their addressee, to find its reader; foreign datagrams are left out. Nothing is authenticated.

    Returns:
        For each route id (`PROBE_ROUTE` for probes), link id (8 bytes) and origin the datagrams, in their order.
    """
    sorted_: dict[tuple[int, bytes, Origin], list[Buffer]] = {}
    for datagram, origin in datagrams:
        if len(datagram) >= _HEADER_SIZE and datagram[0] == MAGIC:
            route, link_id = _unpack_addressee(datagram, 6)
            sorted_.setdefault((route, link_id, origin), []).append(datagram)
    return sorted_


class Probe(NamedTuple):
    """The payload of `PROBE_ROUTE`'s messages, which test whether datagrams get through."""

    pong: bool  # this answers a probe
    opaque: int  # 0 to 2**64 - 1, chosen by the asker and echoed

    def pack(self) -> bytes:
        return _PROBE.pack(*self)

    @classmethod
    def unpack(cls, payload: bytes) -> Probe:
        """Return the probe in a payload.

        Raises:
            ProtocolError: the payload is no probe.
        """
        if len(payload) != _PROBE.size or payload[0] > 1:
            raise ProtocolError(Broken.PROBE_INVALID(length=len(payload)))
        return cls._make(_PROBE.unpack(payload))


class Arrived(NamedTuple):
    """The datagrams of one route that a receiver has."""

    route: int
    newest: int  # the highest sequence number opened
    opened: int  # datagrams opened so far
    missing: int = 0  # of a reliable topic: bit n is set if the n-th before the newest has not come, up to bit 1,023

    @property
    def size(self) -> int:
        """Its bytes in a receipt."""
        return _ARRIVED.size + (self.missing.bit_length() + 7) // 8

    def pack(self) -> bytes:
        length = self.size - _ARRIVED.size
        return _ARRIVED.pack(self.route, self.newest, self.opened, length) + self.missing.to_bytes(length)


class Receipt(NamedTuple):
    """Another payload of `PROBE_ROUTE`'s messages: what a receiver has of some routes, for their sender's pace."""

    buffer: int  # bytes of the kernel's receive buffer on the receiver's side, at most 2**32 - 1
    at: int  # when the newest datagram reached the receiver's kernel, in µs on the receiver's clock, at most 2**64 - 1
    arrived: tuple[Arrived, ...]

    def pack(self) -> bytes:
        return _RECEIPT.pack(_RECEIPT_KIND, self.buffer, self.at) + b"".join([each.pack() for each in self.arrived])

    @classmethod
    def unpack(cls, payload: bytes) -> Receipt:
        """Return the receipt in a payload.

        Raises:
            ProtocolError: it is none.
        """
        at, arrived = _RECEIPT.size, list[Arrived]()
        try:
            _, buffer, when = _RECEIPT.unpack_from(payload)
            while at < len(payload):
                route, newest, opened, length = _ARRIVED.unpack_from(payload, at)
                at += _ARRIVED.size + length
                arrived.append(Arrived(route, newest, opened, int.from_bytes(payload[at - length : at])))
        except struct.error:
            at = -1
        if at != len(payload):
            raise ProtocolError(Broken.RECEIPT_INVALID(length=len(payload)))
        return cls(buffer, when, tuple(arrived))


def receipts(buffer: int, at: int, arrived: Iterable[Arrived]) -> Iterator[Receipt]:
    """Yield receipts that fit into one datagram each: a lost fragment would lose all of a longer one."""
    part: list[Arrived] = []
    size = _RECEIPT.size
    for each in arrived:
        if size + each.size > _LONGEST_RECEIPT:
            yield Receipt(buffer, at, tuple(part))
            part, size = [], _RECEIPT.size
        part.append(each)
        size += each.size
    if part:
        yield Receipt(buffer, at, tuple(part))


class Urgent(NamedTuple):
    """Another payload of `PROBE_ROUTE`'s messages: an encoded control message that crosses on its connection, too."""

    content: bytes

    def pack(self) -> bytes:
        return bytes((_URGENT_KIND,)) + self.content


OfProbeRoute: TypeAlias = Probe | Receipt | Urgent


def unpack_probe(payload: bytes) -> OfProbeRoute:
    """Read a payload of `PROBE_ROUTE`, whose first byte says what it is.

    Raises:
        ProtocolError: it is none of the three, or has another length.
    """
    kind = payload[0] if payload else 0
    if kind == _URGENT_KIND:
        return Urgent(payload[1:])
    if kind != _RECEIPT_KIND:
        return Probe.unpack(payload)
    return Receipt.unpack(payload)


class Cut(NamedTuple):
    """A message in pieces, each for a datagram."""

    number: int
    payload: Buffer
    pieces: Sequence[Buffer]  # of the payload, all but the last of one size
    stamp: int  # ns since the epoch
    flags: int  # as of `rsb_bridge.wire.framing.Message`


class DatagramWriter:
    """Seals a route's messages as datagrams.

    Attributes:
        number: messages written so far.
        largest: bytes of the longest of them.
        overhead: bytes of a datagram besides its content.
    """

    def __init__(self, sealer: Sealer, link_id: bytes, route: int) -> None:
        self.number = 0
        self.largest = 0
        self._sealer = sealer
        self._link_id = link_id
        self._route = route
        self.overhead = _HEADER_SIZE + sealer.suite.tag_length

    def resume(self, sealer: Sealer, link_id: bytes) -> None:
        """Seal with the keys of the association's next connection. The messages' numbers continue."""
        self._sealer, self._link_id = sealer, link_id

    @property
    def sequence(self) -> int:
        """The next datagram's sequence number."""
        return self._sealer.sequence

    def datagrams(self, size: int, max_datagram: int) -> int:
        """Return how many datagrams of at most `max_datagram` bytes a message of `size` bytes takes."""
        return max(-(-size // (max_datagram - self.overhead)), 1)  # an empty message takes one, too

    def room(self, max_datagram: int) -> int:
        """Return the bytes of a message that one datagram of at most `max_datagram` bytes carries."""
        return max_datagram - self.overhead

    def write(self, payload: Buffer, stamp: int, flags: int, max_datagram: int) -> list[bytes]:
        """Return one message as datagrams: see `write_many`."""
        return self.write_many(((payload, stamp, flags),), max_datagram)

    def write_many(
        self, messages: Iterable[tuple[Buffer, int, int]], max_datagram: int, *, asks: bool = False
    ) -> list[bytes]:
        """Return messages as datagrams, each message's of one size but the last: the kernel takes such at once.

        Args:
            messages: each the serialized message, its stamp (ns since the epoch), and its flags
                (`rsb_bridge.wire.framing.ZSTD`, `rsb_bridge.wire.framing.HISTORY`).
            asks: whether the first datagram asks for a receipt.

        Raises:
            ValueError: a message needs more than `FRAGMENTS_LIMIT` datagrams; no datagram of it was written.
        """
        pack, sealer, route, link_id = _HEADER.pack, self._sealer, self._route, self._link_id
        room = max_datagram - self.overhead
        datagrams: list[bytes] = []
        asking = _ASKS if asks else 0
        for payload, stamp, flags in messages:
            length = len(payload)
            if length > self.largest:  # noqa: PLR1730 - max() takes three times as long
                self.largest = length
            pieces = (payload,) if length <= room else _cut(payload, room)
            self.number += 1
            number, count = self.number & 0xFFFFFFFF, len(pieces)
            for index, piece in enumerate(pieces):
                header = pack(MAGIC, flags | asking, index, count, route, link_id, sealer.sequence, number, stamp)
                datagrams.append(header + sealer.seal(piece, header))
                asking = 0
        return datagrams

    def cut(self, message: Message, max_datagram: int) -> Cut:
        """Cut a message to write its datagrams little by little.

        Raises:
            ValueError: the message needs more than `FRAGMENTS_LIMIT` datagrams.
        """
        self.largest = max(self.largest, len(message[0]))
        self.number += 1
        return self.cut_again(self.number, message, max_datagram)

    def cut_again(self, number: int, message: Message, max_datagram: int) -> Cut:
        """Cut a message that has its number; raises as `cut`."""
        payload, stamp, flags = message
        return Cut(number & 0xFFFFFFFF, payload, _cut(payload, max_datagram - self.overhead), stamp, flags)

    def write_pieces(self, cut: Cut, begin: int, end: int, *, asks: bool = False) -> list[bytes]:
        """Return the datagrams of some pieces; `asks` as for `write_many`."""
        number, _, pieces, stamp, flags = cut
        sealer, count = self._sealer, len(pieces)
        datagrams: list[bytes] = []
        for index in range(begin, min(end, count)):
            asking = _ASKS if asks and index == begin else 0
            header = _HEADER.pack(
                MAGIC, flags | asking, index, count, self._route, self._link_id, sealer.sequence, number, stamp
            )
            datagrams.append(header + sealer.seal(pieces[index], header))
        return datagrams


def _cut(payload: Buffer, room: int) -> Sequence[memoryview]:
    """Cut a message into the fewest pieces of at most `room` bytes, all but the last of one size."""
    view, length = memoryview(payload), len(payload)
    count = max(-(-length // room), 1)
    if count > FRAGMENTS_LIMIT:
        raise ValueError(Misuse.TOO_MANY_DATAGRAMS(length=length, limit=FRAGMENTS_LIMIT))
    size = max(-(-length // count), 1)
    return [view[begin : begin + size] for begin in range(0, max(length, 1), size)]


@dataclass(slots=True)
class _Incomplete:
    count: int
    last_seen: float
    since: int  # sequence number of its first fragment that came
    fragments: dict[int, bytes] = field(default_factory=dict)
    size: int = 0
    cost: int = 0


class DatagramReader:
    """Opens a route's datagrams and reassembles their messages.

    A message is returned as soon as it is whole, in any order; a leased one not after a later one. Message numbers
    continue beyond 2**32.

    Attributes:
        expired: messages given up incomplete.
        newest: the highest message number seen.
        opened: datagrams opened so far.
        asked: whether one of them asked for a receipt; set back by who sends it.
    """

    def __init__(
        self,
        opener: DatagramOpener,
        route: int,
        max_message: int = MESSAGE_LIMIT,
        budget: Budget | None = None,
        meter: Callable[[int], bool] | None = None,
    ) -> None:
        """Read one route.

        Args:
            opener: of the peer's direction.
            budget: for incomplete messages; when it is spent, the route's oldest is given up. None: one of its own.
            meter: takes the bytes of each datagram that opens; once it refuses some, nothing more is taken.
        """
        self.expired = 0
        self.newest = 0
        self.opened = 0
        self.asked = False
        self._opener = opener
        self._route = route
        self._budget = budget or Budget(UNFINISHED_LIMIT)
        self._max_message = max_message
        self._meter = meter
        self._ended = False  # by the meter
        self._incomplete: dict[int, _Incomplete] = {}  # by message number, in the order of the last fragments
        self._handed_on = 0  # the highest number of a leased message that was returned
        self._given_up = 0  # the highest number that was given up: late fragments up to it are not kept

    @property
    def newest_sequence(self) -> int:
        """The highest sequence number opened, or -1 if none was."""
        return self._opener.newest

    @property
    def pending(self) -> int:
        """Messages that wait for some of their fragments."""
        return len(self._incomplete)

    def receive(self, datagram: Buffer, now: float) -> Message | None:
        """Take one datagram. One that is forged, replayed or against the format is ignored.

        Args:
            now: s, on the same clock as for `expire`.

        Returns:
            The message that this datagram completes, if any.
        """
        if len(datagram) < _HEADER_SIZE:
            return None
        view = memoryview(datagram)
        header = view[:_HEADER_SIZE]
        magic, flags, index, count, route, _, sequence, number, stamp = _HEADER.unpack(header)
        if magic != MAGIC or index >= count or route != self._route:
            return None
        try:
            content = self._opener.open(sequence, view[_HEADER_SIZE:], header)
        except SealError:
            return None
        self.opened += 1
        if self._meter is not None and not self._counted(len(datagram), self._meter):
            return None
        if flags & _ASKS:
            self.asked = True
            flags ^= _ASKS  # on streams, that bit means `framing.MORE`
        number = self._full(number)
        self.newest = max(self.newest, number)
        if count > 1:
            whole = self._gather(number, index, count, content, sequence, now)
            if whole is None:
                return None
            content = whole
        return self._whole(number, (content, stamp, flags))

    def _counted(self, size: int, meter: Callable[[int], bool]) -> bool:
        if not self._ended and not meter(size):
            self._ended = True
            self.close()
        return not self._ended

    def _full(self, number: int) -> int:
        """Return the full message number, the one nearest to the newest (RFC 1982)."""
        ahead = (number - self.newest) & 0xFFFFFFFF
        return self.newest + (ahead if ahead < 2**31 else ahead - 2**32)

    def _whole(self, number: int, message: Message) -> Message | None:
        """Return a message that is whole, if it may be handed on now."""
        if message[2] & LEASED:
            # A motion must not follow the stop that has overtaken it.
            if number < self._handed_on:
                return None
            self._handed_on = number
        return message

    def resume(self, opener: DatagramOpener) -> None:
        """Open with the keys of the association's next connection; what is incomplete is discarded."""
        DatagramReader.close(self)
        self._opener = opener
        self.opened = 0

    def expire(self, now: float) -> None:
        """Give up messages whose fragments did not come in time."""
        # All of them: the newest one, which may wait longer, can be anywhere among them.
        for number, message in tuple(self._incomplete.items()):
            if now - message.last_seen > (_NEWEST_EXPIRES if number == self.newest else _EXPIRES):
                self._give_up(number)

    def close(self) -> None:
        """Give up all incomplete messages."""
        for number in tuple(self._incomplete):
            self._forget(number)

    def _gather(self, number: int, index: int, count: int, content: bytes, sequence: int, now: float) -> bytes | None:
        message = self._incomplete.get(number)
        if message is None:
            if number <= self._given_up:
                return None
            message = self._incomplete[number] = _Incomplete(count, now, sequence)
        if count != message.count or index in message.fragments or message.size + len(content) > self._max_message:
            self._give_up(number)  # its fragments contradict each other, or are too many
            return None
        message.fragments[index] = content
        message.size += len(content)
        message.last_seen = now
        # The order of the last fragments, in which messages are given up. Mostly it is the last one already.
        if next(reversed(self._incomplete)) != number:
            self._incomplete[number] = self._incomplete.pop(number)
        if len(message.fragments) == count:
            self._forget(number)
            return b"".join([message.fragments[i] for i in range(count)])
        self._hold(number, len(content) + _FRAGMENT_COST)
        return None

    def _hold(self, number: int, cost: int) -> None:
        """Take a fragment's cost from the budget; to make room, give up older messages, then this one."""
        while not self._budget.take(cost):
            oldest = next(iter(self._incomplete))
            self._give_up(oldest)
            if oldest == number:
                return
        self._incomplete[number].cost += cost

    def _give_up(self, number: int) -> None:
        self._forget(number)
        self.expired += 1
        self._given_up = max(self._given_up, number)

    def _forget(self, number: int) -> None:
        self._budget.give(self._incomplete.pop(number).cost)


class OrderedReader(DatagramReader):
    """Opens the datagrams of a reliable topic: each message once and in order, as what got lost is sent again.

    Attributes:
        following: messages that follow the one returned last, which has held them up. The caller takes them with it.
    """

    def __init__(self, *args: Any, **limits: Any) -> None:
        super().__init__(*args, **limits)
        self.following: list[Message] = []
        self._next = 1  # number of the message that is handed on next
        self._ahead: dict[int, Message] = {}

    @property
    def missing(self) -> int:
        """The last datagrams that have not come, as in `Arrived`."""
        return self._opener.missing

    @property
    def has_gap(self) -> bool:
        """Whether something of a later message has come while one is incomplete."""
        return self.newest > self._next

    def receive(self, datagram: Buffer, now: float) -> Message | None:
        # Not opened without room, so that it is not acknowledged. The next message makes room once it is whole.
        if self._budget.held + len(datagram) > self._budget.limit and not self._is_of_next(datagram):
            return None
        return super().receive(datagram, now)

    def expire(self, now: float) -> None:
        """Give up nothing: what is incomplete is sent again."""

    def close(self) -> None:
        super().close()
        for message in self._ahead.values():
            self._budget.give(len(message[0]))
        self._ahead.clear()

    def _is_of_next(self, datagram: Buffer) -> bool:
        return len(datagram) >= _HEADER_SIZE and self._full(_HEADER.unpack_from(datagram)[7]) == self._next

    def _has(self, number: int) -> bool:
        return number < self._next or number in self._ahead

    def _gather(self, number: int, index: int, count: int, content: bytes, sequence: int, now: float) -> bytes | None:
        if self._has(number):
            return None
        message = self._incomplete.get(number)
        if message is not None and message.count != count:
            if sequence < message.since:
                return None
            self._forget(number)  # the path takes only smaller datagrams now, and all is sent again
        elif message is not None and index in message.fragments:
            return None
        return super()._gather(number, index, count, content, sequence, now)

    def _hold(self, number: int, cost: int) -> None:
        self._budget.held += cost  # `receive` has asked whether there is room
        self._incomplete[number].cost += cost

    def _whole(self, number: int, message: Message) -> Message | None:
        if self._has(number):
            return None
        if number > self._next:
            self._budget.held += len(message[0])
            self._ahead[number] = message
            return None
        self._next += 1
        while (held := self._ahead.pop(self._next, None)) is not None:
            self._budget.give(len(held[0]))
            self.following.append(held)
            self._next += 1
        return message
