"""The messages by which two sides keep old messages of armed topics from being published (PROTOCOL.md, 7.2)."""

from __future__ import annotations

import struct
from typing import Annotated, TypeAlias

from msgspec import Meta

from rsb_bridge.wire.fields import RouteId  # noqa: TC001 - msgspec resolves the annotations at run time
from rsb_bridge.wire.message import ControlMessageBase
from rsb_bridge.wire.protocol_error import ProtocolError

FEATURE = "lease"
"""The feature by which a side takes part in leases."""
LAST_NUMBER = 2**32 - 1

_HEADER = struct.Struct(">I")
HEADER_LENGTH = _HEADER.size
_Number: TypeAlias = Annotated[int, Meta(ge=0, le=LAST_NUMBER)]


class Lease(ControlMessageBase, frozen=True):
    """A number from either side, sent several times a second while a route is armed or an operator asks for that.

    Attributes:
        number: of this message among its sender's, counting up.
        echo: the newest number that its sender has heard from the other side, or 0 before the first.
    """

    number: _Number
    echo: _Number = 0


class Settled(ControlMessageBase, frozen=True):
    """The answer to `Disarm`: the sender publishes nothing of that opening any more.

    Attributes:
        route: route id.
    """

    route: RouteId


LeaseMessage: TypeAlias = Lease | Settled


def with_number(number: int, content: bytes) -> bytes:
    """A message's content behind the number that its lease header carries."""
    return _HEADER.pack(number) + content


def split_number(payload: bytes) -> tuple[int, bytes]:
    """Take a payload whose flags have `rsb_bridge.wire.framing.LEASED` apart: the number, and the rest.

    Raises:
        ProtocolError: it is too short for the header.
    """
    if len(payload) < _HEADER.size:
        raise ProtocolError(f"a lease header of {len(payload)} bytes: it has {_HEADER.size}")
    return _HEADER.unpack_from(payload)[0], payload[_HEADER.size :]
