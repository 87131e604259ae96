"""The control message that acknowledges the bytes of streams (PROTOCOL.md, 1.6)."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from msgspec import Meta

from rsb_bridge.wire.fields import Count, RouteId
from rsb_bridge.wire.message import ControlMessageBase

MOST_RECEIPTS = 500
"""Entries of each list in one message."""
_Counts: TypeAlias = Annotated[tuple[tuple[RouteId, Count], ...], Meta(max_length=MOST_RECEIPTS)]


class Receipts(ControlMessageBase, frozen=True, omit_defaults=True):
    """Receipts for streams, from either side. An entry for a route that is not open is ignored.

    Attributes:
        received: route ids with the bytes of their channels that the sender of the message has received.
        every: route ids with the bytes after which the sender of the route wants a receipt.
    """

    received: _Counts = ()
    every: _Counts = ()
