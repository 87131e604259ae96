"""What rcl has of an endpoint, as the engine has it, and back."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.qos import Qos, clamp_qos
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.api import Endpoint
from rsb_bridge.ros.typesupport import HASH_PREFIX

_INFINITE = 2**63 - 1  # ns: RMW_DURATION_INFINITE
_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"  # of an endpoint that was discovered before its node
_MOST = 2**31 - 1  # messages: DDS counts a history's depth in 32 bits


def rcl_profile(qos: Qos) -> QoSProfile:
    """A QoS for rcl; a depth or time that it cannot count becomes the highest that it can."""
    return QoSProfile(
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        history=HistoryPolicy[qos.history.upper()],
        depth=min(max(qos.depth, 1), _MOST),
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
    )


def _duration(seconds: float) -> Duration:
    """A peer's figure may be anything; ROS takes what fits in 63 bits."""
    return Duration(nanoseconds=int(min(_INFINITE, max(0, seconds * 1e9))))


def endpoint_of(info: dict[str, Any]) -> Endpoint:
    """An endpoint of the graph. Any DDS program may have put it there, so nothing in it is believed."""
    type_hash, profile = info["topic_type_hash"], info["qos_profile"]
    known = info["node_name"] != _UNKNOWN_NODE
    return Endpoint(
        node=sanitize_text(f"{info['node_namespace'].rstrip('/')}/{info['node_name']}") if known else "",
        type_name=safe_type_name(info["topic_type"]),
        type_hash=f"{HASH_PREFIX}{type_hash['value'].hex()}" if type_hash["version"] == 1 else "",
        qos=clamp_qos(
            Qos(
                reliability="reliable" if profile["reliability"] == ReliabilityPolicy.RELIABLE else "best_effort",
                durability="transient_local"
                if profile["durability"] == DurabilityPolicy.TRANSIENT_LOCAL
                else "volatile",
                history="keep_all" if profile["history"] == HistoryPolicy.KEEP_ALL else "keep_last",
                depth=0,
                deadline=_seconds(profile["deadline"]),
                lifespan=_seconds(profile["lifespan"]),
            )
        ),
        gid=bytes(info["endpoint_gid"]),
    )


def safe_type_name(name: str) -> str:
    """A type's name from the graph, printable and of a limited length."""
    return sanitize_text(name, TEXT_LENGTH)


def _seconds(duration: Duration) -> float:
    nanoseconds: int = duration.nanoseconds
    return 0.0 if nanoseconds >= _INFINITE else nanoseconds / 1e9
