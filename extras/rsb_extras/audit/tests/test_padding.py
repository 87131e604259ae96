"""Bytes between fields are no content, wherever they are; all others are."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from tests.cdr.decoder_helpers import TYPES, described
from tests.support.filled import filled
from tests.support.wording import says

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, text_of
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_extras.audit.audit_table import AuditText
from rsb_extras.audit.padding import Padding, PaddingError
from rsb_extras.audit.tests.conftest import Audited, Sides
from rsb_extras.recording.message_definition import message_definition
from rsb_extras.recording.reading.defined_types import DefinitionError, defined_type

Run = Callable[..., Audited]
IMAGE = message_definition(text_of(described("sensor_msgs/msg/Image")))
MANY = 100_000
BYTE, DOUBLE, STRING, NESTED, ARRAY, SEQUENCE = 3, 11, 17, 1, 48, 144


def cleared(padding: Padding, payload: bytes) -> bytes:
    """Return a message without padding, but for that to a multiple of 4."""
    found, _ = padding.cleared(memoryview(payload), MANY)
    plain = payload if found is None else found
    return plain + bytes(-len(plain) % 4)


@pytest.mark.parametrize("type_name", TYPES)
def test_each_byte_of_each_type_is_content_or_padding(type_name: str) -> None:
    """A byte is padding if ROS reads the same message without it; its type is known from a recording's definition."""
    description = described(type_name)
    padding = Padding(defined_type(type_name, message_definition(text_of(description))))
    payload = serialize_message(filled(installed_class(type_name)))
    base, read = cleared(padding, payload), decode(description, payload)
    assert not read.problem
    for at in islice(range(4, len(payload)), 400):
        other = bytearray(payload)
        other[at] ^= 1
        try:
            is_content = cleared(padding, bytes(other)) != base
        except PaddingError:  # it is a length
            is_content = True
        changed = decode(description, bytes(other))
        assert is_content == (bool(changed.problem) or changed.message != read.message), at


def image(number: int, filling: int) -> bytes:
    """Return an image whose two bytes of padding have a value, as memory leaves it there."""
    frame = Header(frame_id="cam")
    payload = bytearray(serialize_message(Image(header=frame, encoding="rgb8", width=number, data=bytes(12))))
    at = payload.index(b"rgb8\0") + 5 + 1  # behind the encoding, and the byte whether it is big-endian
    payload[at : at + 2] = bytes((filling, filling))
    return bytes(payload)


def add_images(sides: Sides) -> None:
    for number in range(68):
        for side, age in zip(sides, (0.0, 0.02), strict=True):
            side.add("/image", 2 + number * 0.1 + age, image(number, 17 if side is sides.near else 99))


@pytest.mark.parametrize(
    ("type_name", "definitions"),
    [
        ("sensor_msgs/msg/Image", (IMAGE, IMAGE)),
        ("sensor_msgs/msg/Image", (IMAGE, "")),  # as of Humble, whose recordings define nothing
        ("unknown_msgs/msg/Image", (IMAGE, IMAGE)),
    ],
)
def test_known_types_are_compared_without_padding(
    type_name: str, definitions: tuple[str, str], sides: Sides, audited: Run
) -> None:
    sides.spans(15)
    for side, definition in zip(sides, definitions, strict=True):
        side.topic("/image", type_name, definition=definition, encoding="ros2msg" if definition else "")
    add_images(sides)
    found = audited()
    assert (found["/image"]["matched"], found["/image"]["described"], found.code) == (68, True, 0)


def test_unknown_types_say_that_padding_may_differ(sides: Sides, audited: Run, ran: Any) -> None:
    sides.spans(15)
    for side, definition in zip(sides, (IMAGE, ""), strict=True):
        side.topic("/image", "unknown_msgs/msg/Image", definition=definition, encoding="ros2msg" if definition else "")
    add_images(sides)
    found = audited()
    assert not found["/image"]["described"]
    assert ("not_judged", "/image", 68) in found.breaches
    lines = ran("audit", str(sides.near.path), str(sides.far.path)).out
    assert says(lines, AuditText.PADDING, topic="/image", type="unknown_msgs/Image")


def test_definition_of_another_version_is_not_believed(sides: Sides, audited: Run) -> None:
    """It would take content for padding."""
    sides.spans(15)
    topic = sides.topic("/odd", type_name="my_msgs/msg/Odd", definition="uint8 one\nfloat64 two")
    for number in range(20):
        for side in sides:
            side.add(topic, 2 + number * 0.1, b"\0\1\0\0" + bytes((0, number)) + bytes(30))
    found = audited()
    assert (found["/odd"]["matched"], found["/odd"]["by_order"], found["/odd"]["described"]) == (20, 0, False)


def test_bytes_behind_the_last_field_are_padding() -> None:
    """What rclpy reserves for the elements of empty sequences has whatever was in memory."""
    padding = Padding(described("trajectory_msgs/msg/JointTrajectoryPoint"))
    payload = serialize_message(installed_class("trajectory_msgs/msg/JointTrajectoryPoint")())  # type: ignore[misc]
    assert cleared(padding, payload[:28] + b"x" * (len(payload) - 28)) == payload[:28]


def test_big_endian_messages_have_padding() -> None:
    padding = Padding(defined_type("a/msg/B", "uint8 one\nuint32 two"))
    assert cleared(padding, b"\0\0\0\0\1xyz\0\0\0\2") == b"\0\0\0\0\1\0\0\0\0\0\0\2"


def test_fixed_array_of_structs_has_padding_in_each() -> None:
    padding = Padding(defined_type("a/msg/B", f"C[100] all\n{'=' * 80}\nMSG: a/C\nuint8 one\nuint16 two"))
    payload = b"\0\1\0\0" + b"\1x\2\0" * 100
    assert cleared(padding, payload) == b"\0\1\0\0" + b"\1\0\2\0" * 100


@pytest.mark.parametrize(
    "text",
    [
        "uint8", "uint8 1x", "uint8[ x", "uint8<=3 x", "a/b/c/d x", "string x\n" + "=" * 80 + "\nIDL: a/C\nx",
        "x" * (1 << 20),
    ],
)  # fmt: skip
def test_text_that_defines_nothing_is_refused(text: str) -> None:
    with pytest.raises(DefinitionError):
        defined_type("a/msg/B", text)


def test_message_files_are_read_as_ros_reads_them() -> None:
    text = """# a comment
int32 LIMIT=5
string NAME = "x"  # a constant, too
string<=10[<=3] names  # bounded
int32[] numbers
float64[36] covariance [0.0]
bool flag true
C other
x_msgs/msg/D third
Header header
"""
    described_ = defined_type("a/msg/B", text + "=" * 80 + "\nMSG: a/C\n").type_description
    fields = {each.name: each.type for each in described_.fields}
    assert fields == {
        "names": FieldType(21 + 96, 3, 10, ""),
        "numbers": FieldType(6 + SEQUENCE, 0, 0, ""),
        "covariance": FieldType(DOUBLE + ARRAY, 36, 0, ""),
        "flag": FieldType(15, 0, 0, ""),
        "other": FieldType(NESTED, 0, 0, "a/C"),
        "third": FieldType(NESTED, 0, 0, "x_msgs/D"),
        "header": FieldType(NESTED, 0, 0, "std_msgs/Header"),
    }


def test_hostile_types_take_few_steps() -> None:
    """60 types have the next one twice each, and an array has 4e9 elements."""
    types = []
    for number in range(60):
        nested = FieldType(NESTED, 0, 0, f"a/T{number + 1}")
        types.append(MessageType(f"a/T{number}", tuple(MessageField(each, nested) for each in "ab")))
    leaf = (MessageField("a", FieldType(BYTE, 0, 0, "")), MessageField("b", FieldType(DOUBLE + ARRAY, 1 << 31, 0, "")))
    for fields in (leaf, (MessageField("a", FieldType(STRING, 0, 0, "")),)):
        padding = Padding(TypeDescription(types[0], (*types[1:], MessageType("a/T60", fields))))
        with pytest.raises(PaddingError):
            padding.cleared(b"\0\1\0\0" + bytes(1 << 20), MANY)
    with pytest.raises(PaddingError):
        Padding(TypeDescription(types[0], tuple(types[1:])))
    endless = MessageType("a/T", (MessageField("a", FieldType(NESTED, 0, 0, "a/T")),))
    with pytest.raises(PaddingError):
        Padding(TypeDescription(endless, ()))
