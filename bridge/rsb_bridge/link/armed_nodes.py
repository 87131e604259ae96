"""Finds what routes say of nodes: what is armed of them, and whose parameters the other side may set by an entry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.gates import why_not_by_hand

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.link.link import Link
    from rsb_bridge.ros.ros_interface import RosInterface
    from rsb_bridge.route.route import Route

_UNNAMED = "something"


def armed_of_nodes(links: Iterable[Link], nodes: Sequence[str], ros: RosInterface, asker: Link) -> str:
    """Return the name of a route that is armed, and that one of some nodes takes, or an empty string.

    Args:
        nodes: full names; without any, all that is armed counts.
        asker: the link of the peer that asks. It gets the name of another link's route only if it may know that.
    """
    for link, route in ((each, route) for each in links for route in each.routes.values()):
        if route.arming.held and (not nodes or _concerns(route, nodes, ros)):
            is_known = link is asker or asker.end.shows(route.local_topic, route.spec.kind)
            return route.local_topic if is_known else _UNNAMED
    return ""


def are_parameters_open(link: Link, node: str) -> bool:
    """Whether the other side may read and set a node's parameters now, as they are bridged."""
    return any(
        route.life.accepted and why_not_by_hand(route, route.context.now()) is None
        for route in link.routes.values()
        if route.spec.kind == "parameters" and not route.outgoing and route.local_topic == node
    )


def _concerns(route: Route, nodes: Sequence[str], ros: RosInterface) -> bool:
    """Whether one of some nodes takes what crosses on a route; also if DDS does not tell."""
    name = route.local_topic
    if route.spec.kind == "parameters":
        return name in nodes
    try:
        if route.spec.kind == "topic":
            found = ros.subscriptions(name)
        else:
            found = ros.servers(f"{name}/_action/send_goal" if route.spec.kind == "action" else name)
    except RosError:
        return True
    return any(each.node in ("", *nodes) for each in found)
