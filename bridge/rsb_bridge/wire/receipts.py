"""The control message by which a receiver says what it has taken in (PROTOCOL.md, 1.6)."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from msgspec import Meta

from rsb_bridge.wire.fields import Count, RouteId
from rsb_bridge.wire.message import ControlMessageBase

MOST_RECEIPTS = 500
"""Of each kind in one message."""
_Counts: TypeAlias = Annotated[tuple[tuple[RouteId, Count], ...], Meta(max_length=MOST_RECEIPTS)]


class Receipts(ControlMessageBase, frozen=True, omit_defaults=True):
    """Either side: how far streams have come. What names no open route is late, and is ignored.

    Attributes:
        taken: for routes received here, the bytes of the channel taken in so far.
        every: for routes sent from here, the bytes after which the sender wants a receipt.
    """

    taken: _Counts = ()
    every: _Counts = ()
