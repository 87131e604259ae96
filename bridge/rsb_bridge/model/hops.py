"""Hops: the way that messages have come, by which no message crosses a bridge twice.

A *hop* is a bridge that took messages, and the topic it took them from: ``_rsb_robot1_1a2b3c4d/scan``, the name of its
ROS node and that of the topic. Messages that crossed the same bridges have the same `Via`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable

Via: TypeAlias = tuple[str, ...]
"""Hops in the order of the way, or empty for the messages of a publisher that is no bridge."""

MOST_HOPS = 16  # of one message; of the protocol (PROTOCOL.md, 3: Source)
MOST_SOURCES = 16  # of one topic that one link carries: its number has four bits on the wire
MOST_BRIDGES = 64  # in one domain; of the protocol (PROTOCOL.md, 3: Neighbours)
HOP_LENGTH = 340  # characters: a node's name and a topic's, which alone may have 247


def hop(node: str, topic: str) -> str:
    """Return the hop of a bridge's node that takes messages from a topic."""
    return f"{node}{topic}"


def node_of_hop(a_hop: str) -> str:
    return a_hop.partition("/")[0]


def topic_place(bridges: Iterable[str], topic: str) -> frozenset[str]:
    """Return a topic in a domain, as the hops that messages have if they were there before.

    Args:
        bridges: the names of the domain's bridge nodes.
        topic: the topic's name in that domain.
    """
    return frozenset(hop(node, topic) for node in bridges)
