"""What a stream's samples say of themselves, in their attachments (PROTOCOL.md, 12)."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

_HEADER = struct.Struct(">BBQ")
HEADER_LENGTH = _HEADER.size


class Kind(IntEnum):
    """What a sample of a stream is. Its number is..."""

    DATA = 1
    """... its place among these, from 0."""
    WINDOW = 2
    """... how many bytes this side has taken in so far."""
    END = 3
    """... how many samples of data came before; the payload says why."""


class Header(NamedTuple):
    """What a sample's attachment says.

    Attributes:
        kind: a `Kind`; other numbers are passed over.
        rank: of the stream's priority; `Outbox` has the ranks.
        number: by the kind.
    """

    kind: int
    rank: int
    number: int

    def pack(self) -> bytes:
        """The attachment."""
        return _HEADER.pack(*self)

    @classmethod
    def unpack(cls, attachment: bytes) -> Header | None:
        """What an attachment says; None: it is none of a stream's sample."""
        return cls._make(_HEADER.unpack(attachment)) if len(attachment) == _HEADER.size else None
