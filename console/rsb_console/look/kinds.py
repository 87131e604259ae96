"""The words for what a route carries: a topic, a service, an action, or a node's parameters."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from rsb_console.look import formats

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.calls import CallsSnapshot
    from rsb_bridge.model.session import Kind

NOUN: dict[Kind, str] = {"topic": "topic", "service": "service", "action": "action", "parameters": "parameters"}
SHORT: dict[Kind, str] = {"topic": "msg", "service": "srv", "action": "act", "parameters": "par"}
"""What fits into a narrow column: the first three are ROS's own names for the types."""


def named(kind: Kind, name: str) -> str:
    """Say what a name is: ``the service /load_map``, ``the parameters of /planner``."""
    return f"the {NOUN[kind]} {'of ' if kind == 'parameters' else ''}{name}"


def counted(kinds: Iterable[Kind]) -> str:
    """Format a count of routes: ``8 topics, 2 services, parameters of 1 node``; of none, ``0 topics``."""
    counts = Counter(kinds)
    nodes = counts.pop("parameters", 0)
    parts = [formats.counted(counts[kind], noun) for kind, noun in NOUN.items() if counts[kind]]
    parts += [f"parameters of {formats.counted(nodes, 'node')}"] if nodes else []
    return ", ".join(parts) or formats.counted(0, "topic")


def failed(calls: CallsSnapshot) -> int:
    """How many calls will have no answer."""
    return calls.expired + calls.lost + sum(calls.refused.values())
