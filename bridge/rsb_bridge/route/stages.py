"""The steps of a message's way that both halves of a route have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Stage

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route

LINK_STAGE = "link up"


def link_stage(route: Route) -> Stage:
    """Whether the peer is there, and what carries the route gets through."""
    trouble = route.trouble()
    return Stage(LINK_STAGE, route.peer.linked and not trouble, trouble or route.peer.down_reason)


def accepted_stage(route: Route) -> Stage:
    """Whether both sides want the route."""
    return Stage("peer accepted", False if route.refusal else route.accepted or None, route.refusal)
