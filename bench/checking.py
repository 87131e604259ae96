"""Prints what checking messages before ROS gets them costs: ``python -m bench.checking``.

For each type, messages are published raw to one subscription of another node, with the check and without it by turns,
in one run; CPU time is the publishing thread's. The ratio is to publishing alone: a bridge does more for a message
than that, so that the check is a smaller part of it.
"""

from __future__ import annotations

import os
import statistics
import struct
import time
from typing import TYPE_CHECKING, Any, NamedTuple

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # read by each context that joins a domain

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import String

from rsb_bridge.cdr.checker import Checker
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, read_description
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of, installed_class

if TYPE_CHECKING:
    from collections.abc import Callable

_DOMAIN = 77
_ROUNDS = 21
_ROUND = 0.02
"""s of messages in a round, about."""
_MATCHED_WITHIN = 10.0
_SEQUENCE_OF_NESTED = 145  # type_description_interfaces/msg/FieldType: an unbounded sequence of messages


class Case(NamedTuple):
    """Messages of one type."""

    name: str
    payload: bytes
    checker: Checker


def main() -> None:
    publish, close = _publisher()
    row = "{:<28} {:>10} {:>12} {:>12} {:>10} {:>8} {:>12}".format
    print(row("", "bytes", "publish, µs", "checked, µs", "check, µs", "ratio", "compile, µs"))
    for case in _cases():
        alone, checked = _measure(case, publish)
        check = _cost(lambda case=case: case.checker.check(case.payload), 2000)  # type: ignore[misc]
        compiled = _compile_time(case.name)
        figures = f"{alone:.1f}", f"{checked:.1f}", f"{check:.2f}", f"{checked / alone:.2f}", compiled
        print(row(case.name, f"{len(case.payload):,}", *figures))
    close()


def _measure(case: Case, publish: Callable[[bytes], None]) -> tuple[float, float]:
    """Return µs a message, without the check and with it."""

    def checked() -> None:
        case.checker.check(case.payload)
        publish(case.payload)

    def alone() -> None:
        publish(case.payload)

    count = max(5, int(_ROUND / (_cost(alone, 20) / 1e6)))
    rounds = [(_cost(alone, count), _cost(checked, count)) for _ in range(_ROUNDS)]
    return statistics.median(each[0] for each in rounds), statistics.median(each[1] for each in rounds)


def _cost(work: Callable[[], object], count: int) -> float:
    began = time.thread_time_ns()
    for _ in range(count):
        work()
    return (time.thread_time_ns() - began) / count / 1e3


def _compile_time(name: str) -> str:
    description = _DESCRIPTIONS[name]
    return f"{_cost(lambda: Checker(description), 20):.0f}"


_DESCRIPTIONS: dict[str, TypeDescription] = {}


def _cases() -> list[Case]:
    fields = [PointField(name=name) for name in ("x", "y", "z", "intensity")]
    values = [KeyValue(key=f"key {number}", value="0.123") for number in range(10)]
    statuses = [DiagnosticStatus(name=f"part {n}", message="ok", values=values) for n in range(20)]
    transforms = described("geometry_msgs/msg/TransformStamped")
    of_transforms = TypeDescription(
        MessageType(
            "tf2_msgs/msg/TFMessage",
            (MessageField("transforms", FieldType(_SEQUENCE_OF_NESTED, 0, 0, "geometry_msgs/msg/TransformStamped")),),
        ),
        (transforms.type_description, *transforms.referenced_type_descriptions),
    )
    return [
        _case("Twist", Twist()),
        _case("String 2.5 kB", String(data="x" * 2500)),
        _case("Image 1 MB", Image(encoding="rgb8", data=bytes(1_000_000))),
        _case("PointCloud2 1 MB", PointCloud2(fields=fields, data=bytes(1_000_000))),
        _described("TFMessage of 100", _transforms(100), of_transforms),
        _case("DiagnosticArray 20 × 10", DiagnosticArray(status=statuses)),
    ]


def described(type_name: str) -> TypeDescription:
    """Return the description of an installed type."""
    text, found = installed_description(type_name), installed_class(type_name)
    assert text is not None
    assert found is not None
    return read_description(text, hash_of(found))


def _case(name: str, message: Any) -> Case:
    kind = type(message)
    type_name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
    return _described(name, bytes(serialize_message(message)), described(type_name))


def _described(name: str, payload: bytes, description: TypeDescription) -> Case:
    _DESCRIPTIONS[name] = description
    return Case(name, payload, Checker(description))


def _transforms(count: int) -> bytes:
    """Return a serialized tf2_msgs/msg/TFMessage, whose package has no wheel."""
    body = struct.pack("<I", count)
    for number in range(count):
        body += bytes(-len(body) % 4) + struct.pack("<iI", 1, 2)
        for name in ("base_link", f"joint_{number}_link"):
            text = name.encode() + b"\0"
            body += bytes(-len(body) % 4) + struct.pack("<I", len(text)) + text
        body += bytes(-len(body) % 8) + struct.pack("<7d", *range(7))
    return b"\0\1\0\0" + body


def _publisher() -> tuple[Callable[[bytes], None], Callable[[], None]]:
    """Return what publishes raw to a subscription that is matched, and what ends both."""
    contexts = Context(), Context()
    nodes = []
    for context in contexts:
        rclpy.init(context=context, domain_id=_DOMAIN)
        nodes.append(Node("bench", context=context, enable_rosout=False, start_parameter_services=False))
    qos = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    nodes[1].create_subscription(String, "checked", lambda _: None, qos, raw=True)
    publisher = nodes[0].create_publisher(String, "checked", qos)
    deadline = time.monotonic() + _MATCHED_WITHIN
    while not publisher.get_subscription_count():
        assert time.monotonic() < deadline, "DDS did not match the subscription"
        time.sleep(0.01)

    def close() -> None:
        for node, context in zip(nodes, contexts, strict=True):
            node.destroy_node()
            context.try_shutdown()

    return publisher.handle.publish_raw, close


if __name__ == "__main__":
    main()
