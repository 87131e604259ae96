"""The services, actions and nodes with parameters of a side's ROS graph: each whole is one entry, its services none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.patterns import is_hidden
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.ros.graph import agreed_type, topics_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from rsb_bridge.model.session import Kind
    from rsb_bridge.ros.api import RosInterface

CALLED: tuple[Kind, ...] = tuple(kind for kind, lanes in LANES.items() if lanes)
WHOLES: tuple[Kind, ...] = tuple(kind for kind in CALLED if len(LANES[kind]) > 1)
"""Those that consist of several services."""
MOST_ENTRIES = 2000
"""Of one kind, in one list: each costs two questions to the middleware, some 50 µs each."""
_OF_EVERY_NODE = "type_description_interfaces/srv/GetTypeDescription"


def graph_of(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """Every topic of the graph, and what else there is of the kinds that are asked for, by kind and name.

    The topics of an action that is in the list are left out.

    Args:
        ros: whose graph.
        kinds: as in `called_in`.

    Raises:
        RosError: the node is not running.
    """
    called = called_in(ros, kinds)
    actions = (entry.topic for entry in called if entry.kind == "action")
    parts = {action + lane.suffix for action in actions for lane in LANES["action"]}
    return [*(topic for topic in topics_of(ros) if topic.topic not in parts), *called]


def called_in(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """What can be called in the graph, by kind and name; of each kind the first `MOST_ENTRIES`.

    What belongs to an action or to a node's parameters is no service of its own, whatever kinds are asked for, and what
    each node has anyway, or ``ros2 service list`` hides, is left out.

    Args:
        ros: whose graph.
        kinds: those of `rsb_bridge.model.session.Kind` that are asked for; topics are not found here.

    Raises:
        RosError: the node is not running.
    """
    services = ros.services()
    names: dict[Kind, dict[str, str]] = {kind: dict(_wholes(kind, services)) for kind in WHOLES}
    parts = {part for kind in WHOLES for whole in names[kind] for part in _services_of(kind, whole)}
    alone = (name for name, types in services.items() if name not in parts and _OF_EVERY_NODE not in types)
    names["service"] = dict.fromkeys(alone, "")
    return [
        entry
        for kind in sorted(names.keys() & set(kinds))
        for name in sorted(name for name in names[kind] if not is_hidden(name))[:MOST_ENTRIES]
        if (entry := _entry(ros, kind, name, names[kind][name])) is not None
    ]


def _services_of(kind: Kind, whole: str) -> Iterator[str]:
    """Of its topics there is no service: that of parameters has the suffix of none, and so the node's own name."""
    return (whole + lane.suffix for lane in LANES[kind] if not lane.is_topic)


def _wholes(kind: Kind, services: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    """The actions with their types, or the nodes with parameters.

    Whoever has the first service of one has the others: rclcpp and rclpy make them together, on either side.
    """
    lead = LANES[kind][0]
    for name, types in services.items():
        whole = name.removesuffix(lead.suffix)
        if len(types) != 1 or whole in (name, ""):
            continue
        if lead.type_name and types[0] == lead.type_name:
            yield whole, ""
        elif lead.type_suffix and "/action/" in types[0] and types[0].endswith(lead.type_suffix):
            yield whole, types[0].removesuffix(lead.type_suffix)


def _entry(ros: RosInterface, kind: Kind, name: str, type_name: str) -> TopicInfo | None:
    """One line of the list; None: whoever had it has just gone."""
    service = name + LANES[kind][0].suffix
    servers, callers = ros.servers(service), ros.callers(service)
    if not servers and not callers:
        return None
    type_hash = ""
    if kind == "service":
        type_name, type_hash = agreed_type(servers or callers)
    return TopicInfo(name, type_name, type_hash, None, len(servers), len(callers), kind)
