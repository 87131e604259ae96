"""The attachments of a stream's samples (PROTOCOL.md, 12)."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from rsb_bridge.wire.sealing import TAG_LENGTH

_HEADER = struct.Struct(">BBQ")
HEADER_LENGTHS = (_HEADER.size, _HEADER.size + TAG_LENGTH)
"""Bytes of attachments, without a tag and with one."""


class SampleKind(IntEnum):
    """The kind of a stream's sample, which gives its number a meaning: it is..."""

    DATA = 1
    """... its place among these, from 0."""
    WINDOW = 2
    """... how many bytes this side has taken in so far."""
    END = 3
    """... how many samples of data came before; the payload says why."""


class Header(NamedTuple):
    """The attachment of a sample of a stream.

    Attributes:
        kind: a `SampleKind`; other numbers are passed over.
        rank: of the stream's priority; `SampleOutbox` has the ranks.
        tag: proves that the peer sent the sample, or is empty.
    """

    kind: int
    rank: int
    number: int
    tag: bytes = b""

    def pack(self) -> bytes:
        """Return the attachment."""
        return _HEADER.pack(*self[:3]) + self.tag

    @classmethod
    def unpack(cls, attachment: bytes) -> Header | None:
        """Read an attachment; return None if it is not that of a stream's sample."""
        if len(attachment) not in HEADER_LENGTHS:
            return None
        kind, rank, number = _HEADER.unpack_from(attachment)
        return cls(kind, rank, number, attachment[_HEADER.size :])
