"""The robot's frames on /tf and /tf_static, also where ROS lacks the package tf2_msgs, as its wheels do.

There, only the nodes that use them can tell others what a tf2_msgs/msg/TFMessage is, and rclpy's own service for that
knows installed types only.
"""

from __future__ import annotations

import json
import math
import struct
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from type_description_interfaces.msg import Field, FieldType, IndividualTypeDescription, TypeDescription
from type_description_interfaces.srv import GetTypeDescription

from rsb_bridge.cdr.description import hash_of_text
from rsb_bridge.feature_api import Qos
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.raw_types import borrow_type
from rsb_bridge.ros.self_test import findings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.node import Node

_TYPE, _OF_ONE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
_SEQUENCE = 145
"""Type id of a sequence of messages (type_description_interfaces/msg/FieldType)."""


class Frame(NamedTuple):
    """The pose of a frame in its parent."""

    parent: str
    child: str
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    heading: float = 0.0


class _FrameNode:
    """A node by rclpy's extension module, as rclpy's own classes want the layout of a type.

    Raises:
        RosError: the type is not installed, and this ROS carries only types that are.
        RuntimeError: rcl refused an endpoint.
    """

    def __init__(self, node: Node, name: str, kind: Literal["publisher", "subscription"], depth: int) -> None:
        text = _description()
        interface = borrow_type(_TYPE, hash_of_text(text)).interface
        self._node = own = findings().node(name, node.context)
        self._moving = own.create(kind, interface, "/tf", Qos(depth=depth))
        self._static = own.create(kind, interface, "/tf_static", Qos(durability="transient_local", depth=depth))
        node.create_service(GetTypeDescription, f"/{name}/get_type_description", partial(_describe, text))

    def close(self) -> None:
        """Free the endpoints, before their context."""
        for each in (self._moving, self._static, self._node):
            each.destroy()


class FrameBroadcaster(_FrameNode):
    """A node that publishes frames.

    Args:
        node: describes the type in its stead.
    """

    def __init__(self, node: Node, fixed: Iterable[Frame]) -> None:
        super().__init__(node, "robot_state_publisher", "publisher", 1)
        self._clock = node.get_clock()
        self._static.rclpy.publish_raw(self._message(fixed))

    def publish(self, frames: Callable[[], Iterable[Frame]]) -> None:
        """Publish moving frames, if anybody subscribes."""
        if self._moving.rclpy.get_subscription_count():
            self._moving.rclpy.publish_raw(self._message(frames()))

    def _message(self, frames: Iterable[Frame]) -> bytes:
        return serialized(frames, self._clock.now().nanoseconds)


class FrameListener(_FrameNode):
    """A node that subscribes to frames, as a desk's programs do, and leaves them to the middleware.

    Args:
        node: describes the type in its stead.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(node, "frame_listener", "subscription", 1)


def _describe(text: str, request: Any, response: Any) -> Any:
    response.successful = request.type_name == _TYPE
    if response.successful:
        described = json.loads(text)
        first, *others = map(_type, [described["type_description"], *described["referenced_type_descriptions"]])
        response.type_description = TypeDescription(type_description=first, referenced_type_descriptions=others)
    else:
        response.failure_reason = f"this node has {_TYPE} only"
    return response


def _description() -> str:
    """Return the description of TFMessage, a sequence of transforms, made of that of a transform."""
    of_one = json.loads(installed_description(_OF_ONE) or "{}")
    transforms = {"type_id": _SEQUENCE, "capacity": 0, "string_capacity": 0, "nested_type_name": _OF_ONE}
    types = [of_one["type_description"], *of_one["referenced_type_descriptions"]]
    whole = {
        "type_description": {"type_name": _TYPE, "fields": [{"name": "transforms", "type": transforms}]},
        "referenced_type_descriptions": sorted(types, key=lambda each: str(each["type_name"])),
    }
    return json.dumps(whole, separators=(", ", ": "))


def _type(described: dict[str, Any]) -> IndividualTypeDescription:
    fields = [Field(name=each["name"], type=FieldType(**each["type"])) for each in described["fields"]]
    return IndividualTypeDescription(type_name=described["type_name"], fields=fields)


def serialized(frames: Iterable[Frame], stamp: int) -> bytes:
    """Return a serialized TFMessage.

    Args:
        stamp: ns since the epoch.
    """
    frames = list(frames)
    body = bytearray(struct.pack("<I", len(frames)))
    for frame in frames:
        body += bytes(-len(body) % 4) + struct.pack("<iI", *divmod(stamp, 10**9))
        for name in (frame.parent, frame.child):
            body += bytes(-len(body) % 4) + struct.pack("<I", len(name) + 1) + name.encode() + b"\0"
        turn = math.sin(frame.heading / 2), math.cos(frame.heading / 2)
        body += bytes(-len(body) % 8) + struct.pack("<7d", frame.x, frame.y, frame.z, 0.0, 0.0, *turn)
    return b"\0\1\0\0" + bytes(body)
