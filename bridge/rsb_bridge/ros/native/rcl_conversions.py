"""Converts a QoS to that of rcl, and the endpoints of rcl's graph to ours."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.qos import Qos, clamp_qos
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.native.typesupport import HASH_PREFIX
from rsb_bridge.ros.ros_interface import BARE_DDS, Endpoint

_INFINITE = 2**63 - 1  # ns: RMW_DURATION_INFINITE
_NODES = {
    "_NODE_NAME_UNKNOWN_": "",  # of an endpoint that was discovered before its node
    "_CREATED_BY_BARE_DDS_APP_": BARE_DDS,
}
_DEEPEST = 2**31 - 1  # messages: DDS counts a history's depth in 32 bits


def rcl_profile(qos: Qos) -> QoSProfile:
    """Return a QoS for rcl; a depth or time that it cannot count becomes the highest that it can."""
    return QoSProfile(
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        history=HistoryPolicy[qos.history.upper()],
        # A depth of 0 would be the default of the middleware.
        depth=min(max(qos.depth, 1), _DEEPEST),
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        liveliness_lease_duration=_duration(qos.liveliness_lease_duration),
    )


def _duration(seconds: float) -> Duration:
    """A peer's figure may be anything; ROS takes what fits in 63 bits."""
    return Duration(nanoseconds=int(min(_INFINITE, max(0, seconds * 1e9))))


def endpoint_of(info: dict[str, Any]) -> Endpoint:
    """An endpoint of the graph. Any DDS program may have put it there, so nothing in it is trusted."""
    type_hash, profile = info.get("topic_type_hash"), info["qos_profile"]
    node, durability = _NODES.get(info["node_name"]), profile["durability"]
    is_durable = durability == DurabilityPolicy.UNKNOWN
    return Endpoint(
        node=sanitize_text(f"{info['node_namespace'].rstrip('/')}/{info['node_name']}") if node is None else node,
        type_name=safe_type_name(info["topic_type"]),
        type_hash=f"{HASH_PREFIX}{type_hash['value'].hex()}" if type_hash and type_hash["version"] == 1 else "",
        qos=clamp_qos(
            Qos(
                reliability="reliable" if profile["reliability"] == ReliabilityPolicy.RELIABLE else "best_effort",
                # What offers more than ROS knows offers what ROS knows, too.
                durability="transient_local"
                if is_durable or durability == DurabilityPolicy.TRANSIENT_LOCAL
                else "volatile",
                history="keep_all" if profile["history"] == HistoryPolicy.KEEP_ALL else "keep_last",
                depth=0,
                deadline=_seconds(profile["deadline"]),
                lifespan=_seconds(profile["lifespan"]),
                liveliness="manual_by_topic"
                if profile["liveliness"] == LivelinessPolicy.MANUAL_BY_TOPIC
                else "automatic",
                liveliness_lease_duration=_seconds(profile["liveliness_lease_duration"]),
            )
        ),
        gid=bytes(info["endpoint_gid"]),
        is_durable=is_durable,
    )


def safe_type_name(name: str) -> str:
    """Return a type's name from the graph, printable and of a limited length."""
    return sanitize_text(name, TEXT_LENGTH)


def _seconds(duration: Duration) -> float:
    nanoseconds: int = duration.nanoseconds
    return 0.0 if nanoseconds >= _INFINITE else nanoseconds / 1e9
