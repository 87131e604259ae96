"""What a latched topic's message says of the history that it belongs to (PROTOCOL.md, 1.5)."""

from __future__ import annotations

import struct
from typing import NamedTuple

from rsb_bridge.wire.framing import ProtocolError

PUBLISHER_ID_LENGTH = 16
_LAST_NUMBER = 2**63 - 1
_HEADER = struct.Struct(f">{PUBLISHER_ID_LENGTH}sQI")


class HistoryHeader(NamedTuple):
    """Stands before the content of a message whose flags have `rsb_bridge.wire.framing.HISTORY`.

    Attributes:
        publisher: the id (16 bytes) of the publisher on the sending side.
        number: of the message among that publisher's, from 1; 0: the middleware does not number them.
        depth: messages that the publisher keeps for late joiners, as far as the sender knows by now; at least 1.
    """

    publisher: bytes
    number: int
    depth: int

    def pack(self) -> bytes:
        """The header as it stands before the content."""
        return _HEADER.pack(*self)


def publisher_id(gid: bytes) -> bytes:
    """The id of a publisher on the wire, of the one that it has in the middleware."""
    return gid[:PUBLISHER_ID_LENGTH].ljust(PUBLISHER_ID_LENGTH, b"\0")


def split_history(payload: bytes) -> tuple[HistoryHeader, bytes]:
    """Take a message's payload apart: its history header, and the rest.

    Raises:
        ProtocolError: it is too short for a header, or a figure in it is out of its range.
    """
    if len(payload) < _HEADER.size:
        raise ProtocolError(f"a history header of {len(payload)} bytes: it has {_HEADER.size}")
    header = HistoryHeader._make(_HEADER.unpack_from(payload))
    if not header.depth or header.number > _LAST_NUMBER:
        raise ProtocolError(f"a history header with message number {header.number} and a depth of {header.depth}")
    return header, payload[_HEADER.size :]
