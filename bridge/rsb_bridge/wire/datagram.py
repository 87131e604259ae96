"""Datagrams: fragments of messages, sealed, opened and reassembled (PROTOCOL.md, 2)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from rsb_bridge.wire.framing import (
    HISTORY,
    LEASED,
    MESSAGE_LIMIT,
    SOURCE_FLAGS,
    UNFINISHED_LIMIT,
    ZSTD,
    Budget,
    Message,
)
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealing import Buffer, DatagramOpener, Sealer, SealError

MAGIC = 0xB5
FRAGMENTS_LIMIT = 65535
PROBE_ROUTE = 0

_HEADER = struct.Struct(">BBHHI8sQIQ")
_ADDRESSEE = struct.Struct(">I8s")
_PROBE = struct.Struct(">?Q")
_RECEIPT = struct.Struct(">BIQQI")
_RECEIPT_KIND = 2
_UNKNOWN_FLAGS = 0xFF & ~(ZSTD | HISTORY | LEASED | SOURCE_FLAGS)
_FRAGMENT_COST = 400
"""Bytes of memory that a fragment takes beyond its content: many tiny ones must not take more than is counted."""


def addressee(datagram: Buffer) -> tuple[int, bytes] | None:
    """The route and the link that a datagram names, to find its reader by. Not authenticated.

    Returns:
        Route id (`PROBE_ROUTE` for probes) and link id (8 bytes), or None for a foreign datagram.
    """
    if len(datagram) < _HEADER.size or datagram[0] != MAGIC:
        return None
    route, link_id = _ADDRESSEE.unpack_from(datagram, 6)
    return route, link_id


class Probe(NamedTuple):
    """The payload of `PROBE_ROUTE`'s messages, which test whether datagrams get through.

    Attributes:
        pong: this answers a probe.
        opaque: 0 to 2**64 - 1, chosen by the asker and echoed.
    """

    pong: bool
    opaque: int

    def pack(self) -> bytes:
        """Return the probe as a payload."""
        return _PROBE.pack(*self)

    @classmethod
    def unpack(cls, payload: bytes) -> Probe:
        """Return the probe in a payload.

        Raises:
            ProtocolError: the payload is no probe.
        """
        if len(payload) != _PROBE.size:
            raise ProtocolError(Broken.PROBE_INVALID(length=len(payload)))
        return cls._make(_PROBE.unpack(payload))


class Receipt(NamedTuple):
    """Another payload of `PROBE_ROUTE`'s messages: what a receiver has of a route, for its sender's pace.

    Attributes:
        route: its id.
        newest: the highest sequence number opened.
        opened: datagrams opened so far.
        buffer: bytes of the kernel's receive buffer on the receiver's side, at most 2**32 - 1.
    """

    route: int
    newest: int
    opened: int
    buffer: int

    def pack(self) -> bytes:
        """Return the receipt as a payload."""
        return _RECEIPT.pack(_RECEIPT_KIND, *self)


def unpack_probe(payload: bytes) -> Probe | Receipt:
    """Read a payload of `PROBE_ROUTE`.

    Raises:
        ProtocolError: the payload is neither a probe nor a receipt.
    """
    if len(payload) != _RECEIPT.size:
        return Probe.unpack(payload)
    kind, *fields = _RECEIPT.unpack(payload)
    if kind != _RECEIPT_KIND:
        raise ProtocolError(Broken.RECEIPT_UNKNOWN(kind=kind))
    return Receipt._make(fields)


class DatagramWriter:
    """Seals a route's messages as datagrams.

    Attributes:
        number: messages written so far.
    """

    def __init__(self, sealer: Sealer, link_id: bytes, route: int) -> None:
        self.number = 0
        self._sealer = sealer
        self._link_id = link_id
        self._route = route
        self._overhead = _HEADER.size + sealer.suite.tag_length

    @property
    def sequence(self) -> int:
        """The next datagram's sequence number."""
        return self._sealer.sequence

    def datagrams(self, size: int, max_datagram: int) -> int:
        """Return how many datagrams of at most `max_datagram` bytes a message of `size` bytes takes."""
        return max(-(-size // (max_datagram - self._overhead)), 1)

    def write(self, payload: Buffer, stamp: int, flags: int, max_datagram: int) -> list[bytes]:
        """Return one message as datagrams, all but the last of one size: the kernel takes such at once.

        Args:
            payload: the serialized message.
            stamp: ns since the epoch.
            flags: `rsb_bridge.wire.framing.ZSTD`, `rsb_bridge.wire.framing.HISTORY`.
            max_datagram: bytes that a datagram may have.

        Raises:
            ValueError: the message needs more than `FRAGMENTS_LIMIT` datagrams; none was written.
        """
        count = self.datagrams(len(payload), max_datagram)
        if count > FRAGMENTS_LIMIT:
            raise ValueError(Misuse.TOO_MANY_DATAGRAMS(length=len(payload), limit=FRAGMENTS_LIMIT))
        self.number += 1
        size = -(-len(payload) // count)
        sealer, view, datagrams = self._sealer, memoryview(payload), []
        for index in range(count):
            header = _HEADER.pack(
                MAGIC,
                flags,
                index,
                count,
                self._route,
                self._link_id,
                sealer.sequence,
                self.number & 0xFFFFFFFF,
                stamp,
            )
            datagrams.append(header + sealer.seal(view[index * size : (index + 1) * size], header))
        return datagrams


@dataclass(slots=True)
class _Incomplete:
    count: int
    last_seen: float
    fragments: dict[int, bytes] = field(default_factory=dict)
    size: int = 0
    cost: int = 0


class DatagramReader:
    """Opens a route's datagrams and reassembles their messages.

    A message is returned as soon as it is whole, in any order. Message numbers continue beyond 2**32.

    Attributes:
        expired: messages given up incomplete.
        newest: the highest message number seen.
        opened: datagrams opened so far.
        newest_sequence: the highest sequence number opened; -1: none.
    """

    def __init__(
        self,
        opener: DatagramOpener,
        route: int,
        max_message: int = MESSAGE_LIMIT,
        budget: Budget | None = None,
    ) -> None:
        """Read one route.

        Args:
            opener: of the peer's direction.
            route: route id.
            max_message: bytes of the longest message.
            budget: for incomplete messages; when it is spent, the route's oldest is given up. None: one of its own.
        """
        self.expired = 0
        self.newest = 0
        self.opened = 0
        self.newest_sequence = -1
        self._open = opener.open
        self._route = route
        self._budget = budget or Budget(UNFINISHED_LIMIT)
        self._max_message = max_message
        self._incomplete: dict[int, _Incomplete] = {}  # by message number, in the order of the last fragments
        self._given_up = 0  # the highest number that was given up: late fragments up to it are not kept

    @property
    def pending(self) -> int:
        """Messages that wait for some of their fragments."""
        return len(self._incomplete)

    def receive(self, datagram: Buffer, now: float) -> Message | None:
        """Take one datagram. One that is forged, replayed or against the format is ignored.

        Args:
            datagram: as it came.
            now: s, on the same clock as for `expire`.

        Returns:
            The message that this datagram completes, if any.
        """
        if len(datagram) < _HEADER.size:
            return None
        view = memoryview(datagram)
        header = view[: _HEADER.size]
        magic, flags, index, count, route, _, sequence, number, stamp = _HEADER.unpack(header)
        if magic != MAGIC or flags & _UNKNOWN_FLAGS or index >= count or route != self._route:
            return None
        try:
            content = self._open(sequence, view[_HEADER.size :], header)
        except SealError:
            return None
        self.opened += 1
        self.newest_sequence = max(self.newest_sequence, sequence)
        number = self._unwrap(number)
        if count == 1:
            return content, stamp, flags
        whole = self._gather(number, index, count, content, now)
        return None if whole is None else (whole, stamp, flags)

    def expire(self, now: float, older_than: float = 1.0) -> None:
        """Give up the incomplete messages of which nothing has come for more than `older_than` s."""
        while self._incomplete:
            number, oldest = next(iter(self._incomplete.items()))
            if now - oldest.last_seen <= older_than:
                break
            self._give_up(number)

    def close(self) -> None:
        """Give up all incomplete messages."""
        for number in tuple(self._incomplete):
            self._forget(number)

    def _unwrap(self, number: int) -> int:
        """Return the full message number, the one nearest to the newest (RFC 1982)."""
        number = self.newest + ((number - self.newest + 2**31) & 0xFFFFFFFF) - 2**31
        self.newest = max(self.newest, number)
        return number

    def _gather(self, number: int, index: int, count: int, content: bytes, now: float) -> bytes | None:
        message = self._incomplete.get(number)
        if message is None:
            if number <= self._given_up:
                return None
            message = self._incomplete[number] = _Incomplete(count, now)
        if count != message.count or index in message.fragments or message.size + len(content) > self._max_message:
            self._give_up(number)  # its fragments contradict each other, or are too many
            return None
        message.fragments[index] = content
        message.size += len(content)
        message.last_seen = now
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
