"""Calls by hand, and types of what is published by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.names import expand_type_name
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot

_NODES_NAMED = 3  # nodes in a report; the others are counted. A round figure


class AnswerText(Wording):
    """Reports on calls by hand."""

    ANSWERED = "{link}: answered by {nodes} {where}, after {seconds:.3g} s"
    THERE, HERE = "there", "on this side"


def answer_report(route: RouteSnapshot, seconds: float) -> str:
    """Return the report of a call that was answered.

    Args:
        seconds: from the call to its answer.
    """
    nodes = join_first(route.subscribers, _NODES_NAMED) or "a node"
    where = AnswerText.THERE() if route.outgoing else AnswerText.HERE()
    return AnswerText.ANSWERED(link=route.link, nodes=nodes, where=where, seconds=seconds)


def full_type(route: RouteSnapshot) -> str:
    """Return the full name of a route's type, or an empty string if nobody on this side knows it."""
    if route.type_name or route.spec.type == "auto":
        return route.type_name
    return expand_type_name(route.spec.type)
