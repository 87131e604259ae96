"""The bridges that messages have crossed, so that no message crosses a bridge twice.

A *hop* is a bridge that took messages, and the topic it took them from: ``rsb_robot1_1a2b3c4d/scan``, the name of its
ROS node and that of the topic. Messages that crossed the same bridges have the same `Via`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable

Via: TypeAlias = tuple[str, ...]
"""Hops in the order of the way, or empty for the messages of a publisher that is no bridge."""

OWN_NAMES = "/_rsb_bridge/"
"""Before the names of what bridges themselves publish or serve."""
ANNOUNCEMENT_TOPIC = f"{OWN_NAMES}published"
"""What the bridges of a domain tell each other; hidden from ``ros2 topic list``, and never bridged."""
OF_EVERY_NODE = ("/parameter_events", "/rosout", ANNOUNCEMENT_TOPIC)
"""The topics that each node has, and each bridge; lists leave them out."""

MOST_HOPS = 16
"""Of one message; of the protocol (PROTOCOL.md, 3: Source)."""
MOST_SOURCES = 16
"""Of one topic that one link carries: its number has four bits on the wire."""
MOST_BRIDGES = 64
"""In one domain; of the protocol (PROTOCOL.md, 3: Neighbours)."""
HOP_LENGTH = 340
"""Characters: a node's name and a topic's, which alone may have 247."""


def hop(node: str, topic: str) -> str:
    """Return the hop of a bridge's node that takes messages from a topic."""
    return f"{node}{topic}"


def node_of(a_hop: str) -> str:
    """Return the bridge's node."""
    return a_hop.partition("/")[0]


def place(bridges: Iterable[str], topic: str) -> frozenset[str]:
    """Return a topic in a domain, as the hops that messages have if they were there before.

    Args:
        bridges: the names of the domain's bridge nodes.
        topic: the topic's name in that domain.
    """
    return frozenset(hop(node, topic) for node in bridges)
