"""The control message about calls that operators make by hand (PROTOCOL.md, 8)."""

from __future__ import annotations

# msgspec resolves the annotations at run time
from rsb_bridge.wire.fields import Count, Name, Reason, RouteId  # noqa: TC001
from rsb_bridge.wire.message import ControlMessageBase


class ByHand(ControlMessageBase, frozen=True):
    """Either side: an operator there calls by hand what a route provides. The call itself is none of this message's.

    Attributes:
        route: route id.
        lane: of the route.
        request: what the operator wrote, or the beginning of it, on one line.
        who: the operator, in words.
        outcome: what became of the call, in words; empty: it is about to be made.
    """

    route: RouteId
    lane: Count = 0
    request: Reason = ""
    who: Name = ""
    outcome: Reason = ""
