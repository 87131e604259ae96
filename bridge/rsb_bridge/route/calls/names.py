"""What the lanes of a route are called and which types they have, from the route's own name and type."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.calls import Lane


def name_of(lane: Lane, route_name: str) -> str:
    """A lane's service or topic: ``/navigate/_action/send_goal``."""
    return lane.absolute or route_name + lane.suffix


def type_of(lane: Lane, route_type: str) -> str:
    """A lane's type: ``pkg/action/Navigate_SendGoal``; empty: it depends on the route's, which is not known."""
    return lane.type_name or (route_type + lane.type_suffix if route_type else "")


def route_type_of(lane: Lane, lane_type: str) -> str:
    """The route's type, by the type of one of its lanes; empty: that says nothing about it."""
    if lane.type_name or not lane_type.endswith(lane.type_suffix):
        return ""
    return lane_type.removesuffix(lane.type_suffix)
