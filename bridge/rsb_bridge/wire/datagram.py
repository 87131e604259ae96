"""Datagrams: a message's fragments sealed, opened and put together again (PROTOCOL.md, 2)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from rsb_bridge.wire.budget import Budget
from rsb_bridge.wire.framing import MESSAGE_LIMIT, UNFINISHED_LIMIT, ZSTD, Message, ProtocolError
from rsb_bridge.wire.sealing import Buffer, DatagramOpener, Sealer, SealError

MAGIC = 0xB5
FRAGMENTS_LIMIT = 65535
PROBE_ROUTE = 0

_HEADER = struct.Struct(">BBHHI8sQIQ")
_ADDRESSEE = struct.Struct(">I8s")
_PROBE = struct.Struct(">?Q")
_FRAGMENT_COST = 400
"""What Python spends on keeping a message's first fragment beside its bytes: many tiny ones must not cost more than is
counted."""


def addressee(datagram: Buffer) -> tuple[int, bytes] | None:
    """Whose a datagram says it is, to find its reader by; nothing is authenticated until that opens it.

    Returns:
        Route id (`PROBE_ROUTE` for probes) and link id (8 bytes); None: it is none of ours.
    """
    if len(datagram) < _HEADER.size or datagram[0] != MAGIC:
        return None
    route, link_id = _ADDRESSEE.unpack_from(datagram, 6)
    return route, link_id


class Probe(NamedTuple):
    """What `PROBE_ROUTE` carries: whether datagrams come through, and from where.

    Attributes:
        pong: it answers one.
        opaque: the asker's, 0 to 2**64 - 1; echoed.
    """

    pong: bool
    opaque: int

    def pack(self) -> bytes:
        """The probe as a payload."""
        return _PROBE.pack(*self)

    @classmethod
    def unpack(cls, payload: bytes) -> Probe:
        """The probe in a payload.

        Raises:
            ProtocolError: there is none.
        """
        if len(payload) != _PROBE.size:
            raise ProtocolError(f"a probe of {len(payload)} bytes")
        return cls._make(_PROBE.unpack(payload))


class DatagramWriter:
    """Makes a route's datagrams.

    Attributes:
        number: of messages written.
    """

    def __init__(self, sealer: Sealer, link_id: bytes, route: int) -> None:
        self.number = 0
        self._sealer = sealer
        self._link_id = link_id
        self._route = route
        self._overhead = _HEADER.size + sealer.suite.tag_length

    def write(self, payload: Buffer, stamp: int, flags: int, max_datagram: int) -> list[bytes]:
        """One message as datagrams.

        Args:
            payload: the serialized message.
            stamp: ns since the epoch.
            flags: `rsb_bridge.wire.framing.ZSTD` or 0.
            max_datagram: bytes that a datagram may have.

        Raises:
            ValueError: it would take more than `FRAGMENTS_LIMIT` datagrams; none was written.
        """
        size = max_datagram - self._overhead
        count = max(-(-len(payload) // size), 1)
        if count > FRAGMENTS_LIMIT:
            raise ValueError(f"a message of {len(payload)} bytes takes more than {FRAGMENTS_LIMIT} datagrams: use tcp")
        self.number += 1
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
    first_seen: float
    fragments: dict[int, bytes] = field(default_factory=dict)
    size: int = 0
    cost: int = 0


class DatagramReader:
    """Opens a route's datagrams and puts their messages together.

    A message is handed out as soon as it is whole, in whatever order. Message numbers are counted on past 2**32.

    Attributes:
        authentic: datagrams that came from the peer.
        rejected: datagrams that did not, or that broke the format.
        problem: why the last was rejected, in words.
        received: messages handed out.
        expired: messages given up incomplete.
        newest: the highest message number seen.
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
            route: its id.
            max_message: the longest message.
            budget: what incomplete messages are held from, the route's oldest giving way; None: one of its own.
        """
        self.authentic = 0
        self.rejected = 0
        self.problem = ""
        self.received = 0
        self.expired = 0
        self.newest = 0
        self._open = opener.open
        self._route = route
        self._budget = budget or Budget(UNFINISHED_LIMIT)
        self._max_message = max_message
        self._incomplete: dict[int, _Incomplete] = {}  # by message number, the longest kept first
        self._given_up = 0  # the highest number that was: what comes late of those is not kept again

    @property
    def pending(self) -> int:
        """Messages of which some fragments have come and others have not yet."""
        return len(self._incomplete)

    @property
    def lost(self) -> int:
        """Messages before the newest of which nothing has come; one that is only late is taken back."""
        return max(self.newest - self.received - self.expired - self.pending, 0)

    def receive(self, datagram: Buffer, now: float) -> Message | None:
        """Take in one datagram.

        Args:
            datagram: as it came.
            now: s, of any clock that `expire` gets too.

        Returns:
            The message that it makes whole, if it does.
        """
        try:
            return self._receive(datagram, now)
        except (ProtocolError, SealError) as error:
            self.rejected += 1
            self.problem = str(error)
            return None

    def expire(self, now: float, older_than: float = 1.0) -> None:
        """Give up the messages that are incomplete since more than `older_than` s."""
        while self._incomplete:
            number, oldest = next(iter(self._incomplete.items()))
            if now - oldest.first_seen <= older_than:
                break
            self._give_up(number)

    def close(self) -> None:
        """Hold nothing any more: the rest will not come."""
        for number in tuple(self._incomplete):
            self._forget(number)

    def _receive(self, datagram: Buffer, now: float) -> Message | None:
        if len(datagram) < _HEADER.size:
            raise ProtocolError(f"a datagram of {len(datagram)} bytes: its header alone has {_HEADER.size}")
        header = datagram[: _HEADER.size]
        magic, flags, index, count, route, _, sequence, number, stamp = _HEADER.unpack(header)
        if magic != MAGIC or flags > ZSTD or index >= count or route != self._route:
            raise ProtocolError(f"a datagram that begins {header[:10].hex(' ')} has no place on route {self._route}")
        content = self._open(sequence, datagram[_HEADER.size :], header)
        self.authentic += 1
        if count > 1:
            whole = self._gather(self._unwrap(number), index, count, content, now)
            if whole is None:
                return None
            content = whole
        else:
            self._unwrap(number)
        self.received += 1
        return content, stamp, flags

    def _unwrap(self, number: int) -> int:
        """The whole message number that is nearest to the newest (RFC 1982)."""
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
            self._give_up(number)
            raise ProtocolError(f"the fragments of message {number} do not go together, or are too many")
        message.fragments[index] = content
        message.size += len(content)
        if len(message.fragments) == count:
            self._forget(number)
            return b"".join([message.fragments[i] for i in range(count)])
        self._hold(number, len(content) + _FRAGMENT_COST)
        return None

    def _hold(self, number: int, cost: int) -> None:
        """Take what a message's next fragment costs from the budget, or give up the message, as the last of all."""
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
