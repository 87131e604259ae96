"""The headers before the content of a data frame: lease, history and call (PROTOCOL.md, 1.5, 7.2 and 8)."""

from __future__ import annotations

import hashlib
import struct
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeAlias

from msgspec import Meta

from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Collection

LAST_LEASE = 2**32 - 1

_LEASE_HEADER = struct.Struct(">I")
LEASE_HEADER_LENGTH = _LEASE_HEADER.size
LeaseNumber: TypeAlias = Annotated[int, Meta(ge=0, le=LAST_LEASE)]


def with_number(number: int, content: bytes) -> bytes:
    """Return a message's content behind the number that its lease header carries."""
    return _LEASE_HEADER.pack(number) + content


def split_number(payload: bytes) -> tuple[int, bytes]:
    """Take a payload whose flags have `rsb_bridge.wire.framing.LEASED` apart: the number, and the rest.

    Raises:
        ProtocolError: it is too short for the header.
    """
    if len(payload) < _LEASE_HEADER.size:
        raise ProtocolError(Broken.LEASE_HEADER_TOO_SHORT(length=len(payload), expected=_LEASE_HEADER.size))
    return _LEASE_HEADER.unpack_from(payload)[0], payload[_LEASE_HEADER.size :]


PUBLISHER_ID_LENGTH = 16
MOST_RESENDS = 16  # then a publisher's ids begin again: the peer has dropped the first ones long ago
_LAST_IN_HISTORY = 2**63 - 1
_HISTORY_HEADER = struct.Struct(f">{PUBLISHER_ID_LENGTH}sQI")


class HistoryHeader(NamedTuple):
    """The header of messages with the flag `rsb_bridge.wire.framing.HISTORY`, before the content."""

    publisher: bytes  # the id (16 bytes) of the publisher on the sending side
    number: int  # the message's among that publisher's, from 1, or 0 if the middleware does not number them
    depth: int  # messages that the publisher keeps for late joiners, as far as the sender knows by now; at least 1

    def pack(self) -> bytes:
        return _HISTORY_HEADER.pack(*self)


def publisher_id(gid: bytes, resent: int = 0) -> bytes:
    """Return a publisher's id on the wire for its id in the middleware, once its history was sent again so often."""
    if resent:
        return hashlib.blake2b(gid, digest_size=PUBLISHER_ID_LENGTH, salt=resent.to_bytes()).digest()
    return gid[:PUBLISHER_ID_LENGTH].ljust(PUBLISHER_ID_LENGTH, b"\0")


def resends_of(gid: bytes, kept: Collection[bytes]) -> int | None:
    """Return how often a publisher's history was sent again by the ids that the peer keeps, or None if it has none.

    For a moment the peer keeps the id before, too: the last one counts.
    """
    if not kept:
        return None
    are_kept = [publisher_id(gid, resent) in kept for resent in range(MOST_RESENDS)]
    return next((at for at in range(MOST_RESENDS) if are_kept[at] and not are_kept[(at + 1) % MOST_RESENDS]), None)


def split_history(payload: bytes) -> tuple[HistoryHeader, bytes]:
    """Take a message's payload apart: its history header, and the rest.

    Raises:
        ProtocolError: it is too short for a header, or a figure in it is out of its range.
    """
    if len(payload) < _HISTORY_HEADER.size:
        raise ProtocolError(Broken.HISTORY_HEADER_TOO_SHORT(length=len(payload), expected=_HISTORY_HEADER.size))
    header = HistoryHeader._make(_HISTORY_HEADER.unpack_from(payload))
    if not header.depth or header.number > _LAST_IN_HISTORY:
        raise ProtocolError(Broken.HISTORY_HEADER_INVALID(number=header.number, depth=header.depth))
    return header, payload[_HISTORY_HEADER.size :]


_CALL_HEADER = struct.Struct(">BBQQ")
CALL_HEADER_LENGTH = _CALL_HEADER.size
MOST_TOOK = 2**63 - 1  # ns; the caller knows a lower bound: the time since its request


class What(IntEnum):
    """The kind of a call frame."""

    CALL = 1
    """A request, from the callers' side."""
    ANSWER = 2
    """A response, from the providing side."""
    REFUSED = 3
    """The providing side will not answer a call; the content says why, in UTF-8."""
    MESSAGE = 4
    """A message of a lane that is a topic, from the providing side."""


_CALL_KINDS = {int(each): each for each in What}  # `What(kind)` would be two more functions for each frame


def frame_size(content: bytes) -> int:
    """Return the bytes that a call holds of the budget for its request or its response."""
    return CALL_HEADER_LENGTH + len(content)


class CallFrame(NamedTuple):
    """One frame."""

    what: What
    lane: int  # its place among the lanes of the route's kind
    call: int  # the callers' side's number, from 1 in each opening of the route, or 0 for a message
    took: int  # of an answer, ns that the providing node took for it, as that side's bridge measured it; else 0
    content: bytes  # the serialized message (CDR with its encapsulation header), or the reason why a call is refused
    lease: int = 0  # the number in the lease header before the frame, or 0 without one
    stamp: int = 0
    """ns, from which the age of a request counts, by its sender's clock, or 0 for none. It is the stamp of the message
    that carries the frame."""

    def pack(self) -> bytes:
        return _CALL_HEADER.pack(self.what, self.lane, self.call, self.took) + self.content


def unpack_call(payload: bytes) -> CallFrame:
    """Unpack a route's message as a frame.

    Raises:
        ProtocolError: it is too short, of no known kind, or a message with the number of a call, or a call without one,
            or it says how long a node took for what is no answer, or longer than `MOST_TOOK`.
    """
    if len(payload) < CALL_HEADER_LENGTH:
        raise ProtocolError(Broken.CALL_FRAME_TOO_SHORT(length=len(payload), header=CALL_HEADER_LENGTH))
    kind, lane, call, took = _CALL_HEADER.unpack_from(payload)
    what = _CALL_KINDS.get(kind)
    if what is None:
        raise ProtocolError(Broken.CALL_KIND_UNKNOWN(kind=kind))
    if (call == 0) != (what is What.MESSAGE):
        raise ProtocolError(Broken.CALL_NUMBER_INVALID(kind=kind, number=call))
    if took > (MOST_TOOK if what is What.ANSWER else 0):
        raise ProtocolError(Broken.CALL_DURATION_INVALID(kind=kind, took=took))
    return CallFrame(what, lane, call, took, payload[CALL_HEADER_LENGTH:])
