"""Names: of topics, of types, of a session's files, of the hops that messages have crossed, and of keys.

A *hop* is a bridge that took messages, and the topic it took them from: ``_rsb_robot1_1a2b3c4d/scan``, the name of its
ROS node and that of the topic. Messages that crossed the same bridges have the same `Via`: so no message crosses a
bridge twice.
"""

from __future__ import annotations

import difflib
import hashlib
import re
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_TOPIC = re.compile(rf"(/{_PART})+")
_PREFIX = re.compile(rf"{_PART}(/{_PART})*")

_DIGITS = re.compile(r"([0-9]+)")

_STEM_LENGTH = 64  # characters; a file's name has at most 255 bytes, and a suffix and a number come behind it


def file_stem(name: str, number: int = 1) -> str:
    """Return a session's name as a file's name without suffix; the number tells sessions of one name apart."""
    # No dot first: the file would be hidden.
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:_STEM_LENGTH].lstrip(".") or "_"
    return safe if number == 1 else f"{safe}-{number}"


def other_side(role: str, link: str) -> str:
    """Return the name of a link's other side: a client's link has the client's own name."""
    return "the server" if role == "client" else link


@lru_cache(maxsize=4096)
def natural_order(name: str) -> tuple[tuple[str, int], ...]:
    """Return a sort key by which ``robot2`` comes before ``robot10``."""
    parts = _DIGITS.split(name)
    return tuple((text, int(digits or 0)) for text, digits in zip(parts[::2], [*parts[1::2], ""], strict=True))


def is_topic_name(name: str) -> bool:
    """Whether a name is absolute and well-formed (rmw/validate_full_topic_name.h); its length is not looked at."""
    return _TOPIC.fullmatch(name) is not None


def is_prefix(name: str) -> bool:
    """Whether topic names are well-formed with ``/<name>`` before them."""
    return _PREFIX.fullmatch(name) is not None


def well_formed(name: str) -> str:
    """Return the closest name that ROS accepts, without a leading slash; may be empty."""
    parts = (re.sub(r"[^A-Za-z0-9_]", "_", part) for part in name.lstrip("~").split("/") if part)
    return "/".join(f"_{part}" if part[0].isdecimal() else part for part in parts)


def server_topic(topic: str, client: str) -> str:
    """Return the name on the server of a client's topic if `use_name` is set: ``/robot1/scan`` for ``/scan``."""
    return f"/{client}{topic}"


def client_topic(topic: str, client: str) -> str | None:
    """Return the inverse of `server_topic`, or None if the topic has no such prefix."""
    prefix = f"/{client}"
    return topic.removeprefix(prefix) if topic.startswith(f"{prefix}/") else None


# common_interfaces of ROS 2 Jazzy, and what else nearly every robot publishes.
_PACKAGES = {
    "actionlib_msgs": "GoalID GoalStatus GoalStatusArray",
    "diagnostic_msgs": "DiagnosticArray DiagnosticStatus KeyValue",
    "geometry_msgs": """
        Accel AccelStamped AccelWithCovariance AccelWithCovarianceStamped Inertia InertiaStamped Point Point32
        PointStamped Polygon PolygonInstance PolygonInstanceStamped PolygonStamped Pose Pose2D PoseArray
        PoseStamped PoseWithCovariance PoseWithCovarianceStamped Quaternion QuaternionStamped Transform
        TransformStamped Twist TwistStamped TwistWithCovariance TwistWithCovarianceStamped Vector3
        Vector3Stamped VelocityStamped Wrench WrenchStamped
    """,
    "nav_msgs": "Goals GridCells MapMetaData OccupancyGrid Odometry Path",
    "rosgraph_msgs": "Clock",
    "sensor_msgs": """
        BatteryState CameraInfo ChannelFloat32 CompressedImage FluidPressure Illuminance Image Imu JointState
        Joy JoyFeedback JoyFeedbackArray LaserEcho LaserScan MagneticField MultiDOFJointState MultiEchoLaserScan
        NavSatFix NavSatStatus PointCloud PointCloud2 PointField Range RegionOfInterest RelativeHumidity
        Temperature TimeReference
    """,
    "shape_msgs": "Mesh MeshTriangle Plane SolidPrimitive",
    "std_msgs": """
        Bool Byte ByteMultiArray Char ColorRGBA Empty Float32 Float32MultiArray Float64 Float64MultiArray Header
        Int16 Int16MultiArray Int32 Int32MultiArray Int64 Int64MultiArray Int8 Int8MultiArray
        MultiArrayDimension MultiArrayLayout String UInt16 UInt16MultiArray UInt32 UInt32MultiArray UInt64
        UInt64MultiArray UInt8 UInt8MultiArray
    """,
    "stereo_msgs": "DisparityImage",
    "tf2_msgs": "TFMessage",
    "trajectory_msgs": "JointTrajectory JointTrajectoryPoint MultiDOFJointTrajectory MultiDOFJointTrajectoryPoint",
    "visualization_msgs": """
        ImageMarker InteractiveMarker InteractiveMarkerControl InteractiveMarkerFeedback InteractiveMarkerInit
        InteractiveMarkerPose InteractiveMarkerUpdate Marker MarkerArray MenuEntry MeshFile UVCoordinate
    """,
}

SHORT_NAMES: dict[str, str] = {
    name: f"{package}/msg/{name}" for package, names in _PACKAGES.items() for name in names.split()
}
"""Full type name by short name; no two of these packages share one."""

# Packages and types are named alike in ROS 2's interface naming rules; srv and action hold the messages that service
# events and actions travel in.
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)")


class TypeNameProblem(Wording):
    INVALID = "{name!r} is not a message type: write it as package/msg/Name"
    SHORT_NAME_UNKNOWN = "{name!r} is not a known short type name: write it as package/msg/Name"
    SHORT_NAME_MISSPELT = "{name!r} is not a known short type name: did you mean {names}?"


def split_type_name(type_name: str) -> tuple[str, str, str]:
    """Take ``pkg/msg/Name`` apart.

    Returns:
        Package, kind (``msg``, or ``srv`` or ``action`` for the messages inside those) and name.

    Raises:
        ValueError: it is not of that form.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise ValueError(TypeNameProblem.INVALID(name=type_name))
    package, kind, name = match.groups()
    return package, kind, name


def expand_type_name(name: str) -> str:
    """Return the full name of a type, given the full or a short one.

    Args:
        name: ``pkg/msg/Name``, ``pkg/Name``, or the bare name of a common type (``LaserScan``).

    Returns:
        ``pkg/msg/Name``. Whether it is installed is not looked up.

    Raises:
        ValueError: no such short name, or none of these forms; the message suggests a name.
    """
    if "/" not in name:
        if name in SHORT_NAMES:
            return SHORT_NAMES[name]
        close = [SHORT_NAMES[match] for match in difflib.get_close_matches(name, SHORT_NAMES)]
        problem = TypeNameProblem.SHORT_NAME_MISSPELT if close else TypeNameProblem.SHORT_NAME_UNKNOWN
        raise ValueError(problem(name=name, names=" or ".join(close)))
    if name.count("/") == 1:
        name = name.replace("/", "/msg/")
    split_type_name(name)
    return name


_BRIDGE = re.compile(r"/_rsb_\w+_[0-9a-f]{8}")


def is_bridge(node: str) -> bool:
    """Whether a node's full name is a bridge's, which announces itself, on a busy machine some time later."""
    return _BRIDGE.fullmatch(node) is not None


Via: TypeAlias = tuple[str, ...]
"""Hops in the order of the way, or empty for the messages of a publisher that is no bridge."""

OWN_NAMES = "/_rsb_bridge/"  # before the names of what bridges themselves publish or serve
ANNOUNCEMENT_TOPIC = f"{OWN_NAMES}published"
"""What the bridges of a domain tell each other; hidden from ``ros2 topic list``, and never bridged."""
OF_EVERY_NODE = ("/parameter_events", "/rosout", ANNOUNCEMENT_TOPIC)
"""The topics that each node has, and each bridge; lists leave them out."""

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


FINGERPRINT_LENGTH = 8  # bytes; of the protocol (PROTOCOL.md, 1.1). Two operators compare them by eye or by voice


def fingerprint_of(secret: bytes) -> bytes:
    """Return a key's public name, which operators compare on both sides: the beginning of its SHA-256."""
    return hashlib.sha256(secret).digest()[:FINGERPRINT_LENGTH]


def format_fingerprint(fingerprint: bytes) -> str:
    """Return 16 hexadecimal digits in groups of four, or an empty string for zeros, which mean no key."""
    digits = fingerprint.hex()
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4)) if any(fingerprint) else ""
