"""Reads the nodes of the ROS graph. It takes about 0.2 ms a node, on a thread."""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import RosError
from rsb_bridge.model.names import is_bridge
from rsb_bridge.ros.ros_interface import NodeEnds
from rsb_extras.nodes.node_data import MOST_NODES

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from rsb_bridge.ros.ros_interface import RosInterface

ROSOUT = "/rosout"
_OF_MOST_NODES = (ROSOUT, "/parameter_events")
PARTICIPANT = 12
"""Bytes of an endpoint's GUID that are its participant's (RTPS 2.5, 9.3.1.1)."""


class GraphNode(NamedTuple):
    """A node as the graph has it.

    Attributes:
        participants: ids of the DDS participants that have a node of this name.
    """

    ends: NodeEnds
    participants: frozenset[bytes]


class GraphNodes(NamedTuple):
    """Some nodes of the graph.

    Attributes:
        nodes: by full name.
        log_publishers: nodes by the ids of their publishers of /rosout.
        log_hash: hash of that topic's type, or empty.
    """

    nodes: Mapping[str, GraphNode]
    log_publishers: Mapping[bytes, str]
    log_hash: str


def node_names(ros: RosInterface) -> Counter[str]:
    """Return the names of all nodes but bridges', with how many nodes have each."""
    names = Counter(name for name in ros.node_names() if not is_bridge(name))
    return Counter(dict(sorted(names.items())[:MOST_NODES])) if len(names) > MOST_NODES else names


def read_nodes(ros: RosInterface, names: Collection[str]) -> GraphNodes:
    """Read nodes by their names. Those whose names ROS does not take have no endpoints."""
    participants: defaultdict[str, set[bytes]] = defaultdict(set)
    log_publishers, log_hash = {}, ""
    for topic in _OF_MOST_NODES:
        for end in ros.publishers(topic):
            participants[end.node].add(end.gid[:PARTICIPANT])
            if topic == ROSOUT:
                log_publishers[end.gid] = end.node
                log_hash = log_hash or end.type_hash
    found = {}
    for name in names:
        ends = NodeEnds()
        with contextlib.suppress(RosError):  # a program without ROS may have any name, such as a-b
            ends = ros.ends_of(name)
            if name not in participants:  # its log is off, and it has no parameters
                participants[name] |= _participants_of(ros, name, ends)
        found[name] = GraphNode(ends, frozenset(participants[name]))
    return GraphNodes(found, log_publishers, log_hash)


def _participants_of(ros: RosInterface, name: str, ends: NodeEnds) -> set[bytes]:
    """Return the participants of a node by one of its endpoints."""
    for names, ask in ((ends.publishes, ros.publishers), (ends.hears, ros.subscriptions), (ends.serves, ros.servers)):
        for topic in names:
            if found := {end.gid[:PARTICIPANT] for end in ask(topic) if end.node == name}:
                return found
    return set()
