"""Rewritten messages are what rclpy makes of the same changes, and bytes of anybody end in an error or a message."""

from __future__ import annotations

import struct
import tracemalloc
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import AbstractGenericString as AnyString
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)
from std_msgs.msg import Header
from tests.cdr.decoder_helpers import INNER, TYPES, described, of
from tests.support.filled import filled

from rsb_bridge.cdr.checker import STEPS
from rsb_bridge.cdr.decoder import Items, decode
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription
from rsb_bridge.feature_api import TransformError
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_extras.demo.robot_frames import Frame, serialized
from rsb_extras.frames.message_rewriter import Rewriter, UnknownTypeError, compile_plan, renamed

if TYPE_CHECKING:
    from collections.abc import Callable

PREFIX = "robot1/"
SHIFT = -1_500_000_000  # ns
WITH_FRAMES = [name for name in TYPES if compile_plan(described(name), frames=True, stamps=False) is not None]
FRAMES = ["", "/", "odom", "/odom", "base_link", "robot1/odom", "/robot1/x", "größe", "robot1", "a", "ab", "abc"]
HEADER = MessageType(
    "std_msgs/msg/Header",
    (
        MessageField("stamp", FieldType(1, 0, 0, "builtin_interfaces/msg/Time")),
        MessageField("frame_id", FieldType(17, 0, 0, "")),
    ),
)
TIME = MessageType(
    "builtin_interfaces/msg/Time",
    (MessageField("sec", FieldType(6, 0, 0, "")), MessageField("nanosec", FieldType(7, 0, 0, ""))),
)


def rewriter(description: TypeDescription, prefix: str = PREFIX, shift: int = SHIFT) -> Rewriter:
    plan = compile_plan(description, frames=bool(prefix), stamps=bool(shift))
    assert plan is not None
    made = Rewriter(plan, prefix)
    made.shift = shift
    return made


# -- beside rclpy


def drawn(draw: Callable[[Any], Any], message_class: Any, depth: int = 0) -> Any:
    slots = zip(message_class.get_fields_and_field_types(), message_class.SLOT_TYPES, strict=True)
    return message_class(**{name: _value(draw, name, slot, depth) for name, slot in slots})


def _value(draw: Callable[[Any], Any], name: str, slot: Any, depth: int) -> Any:
    if isinstance(slot, AbstractNestedType):
        most = slot.maximum_size if isinstance(slot, BoundedSequence) else 4 - min(depth, 3)
        count = slot.size if isinstance(slot, Array) else draw(st.integers(0, min(most, 4)))
        return [_value(draw, name, slot.value_type, depth + 1) for _ in range(count)]
    if isinstance(slot, NamespacedType):
        return drawn(draw, installed_class("/".join(slot.namespaced_name())), depth + 1)
    if isinstance(slot, AnyString):
        if name.endswith("frame_id"):
            return draw(st.sampled_from(FRAMES))
        most = slot.maximum_size if slot.has_maximum_size() else 12
        return draw(st.text("aé0", max_size=min(most // 2, 12)))
    assert isinstance(slot, BasicType)
    if slot.typename == "octet":
        return bytes([draw(st.integers(0, 255))])
    if name in ("sec", "nanosec"):
        return draw(st.sampled_from([0, 1, 5, 999_999_999]))
    return {"boolean": True, "float": 1.5, "double": -3.25}.get(slot.typename, 1)


def frame_in_python(name: str) -> str:
    bare = name.removeprefix("/")
    return name if not bare else bare if bare.startswith(PREFIX) else PREFIX + bare


def stamp_in_python(stamp: Any) -> None:
    total = stamp.sec * 10**9 + stamp.nanosec
    if total and total + SHIFT > 0:
        stamp.sec, stamp.nanosec = divmod(total + SHIFT, 10**9)


def change_in_python(message: Any) -> None:
    """Make the same changes by the rule of the page, in rclpy's messages."""
    for name, slot in zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True):
        value = getattr(message, name)
        kind = slot.value_type if isinstance(slot, AbstractNestedType) else slot
        if isinstance(kind, AnyString) and not isinstance(kind, AbstractWString) and not isinstance(value, list):
            if name == "frame_id" or name.endswith("_frame_id"):
                setattr(message, name, frame_in_python(value))
        elif isinstance(kind, NamespacedType):
            if kind.namespaced_name() == ("builtin_interfaces", "msg", "Time"):
                if name == "stamp" and type(message).__name__ == "Header":
                    stamp_in_python(value)
                continue
            for each in value if isinstance(slot, AbstractNestedType) else [value]:
                change_in_python(each)


@pytest.mark.parametrize("name", WITH_FRAMES)
@settings(max_examples=4, deadline=None)
@given(st.data())
def test_bytes_are_those_of_rclpy(name: str, data: st.DataObject) -> None:
    payload = bytes(serialize_message(drawn(data.draw, installed_class(name))))
    expected = deserialize_message(payload, installed_class(name))
    change_in_python(expected)
    # A second message: nothing of the first one is left over.
    rewrites = rewriter(described(name))
    for _ in range(2):
        found = rewrites.rewrite(payload)
        assert deserialize_message(found, installed_class(name)) == expected
        # Byte for byte they are equal but for padding, in which rclpy leaves what was in its memory.
        assert len(found) == len(serialize_message(expected))


def test_types_with_frames_are_those_with_headers_and_more() -> None:
    expected = {"nav_msgs/msg/Odometry", "geometry_msgs/msg/TransformStamped", "visualization_msgs/msg/MarkerArray"}
    assert expected < {*WITH_FRAMES}
    assert "sensor_msgs/msg/Image" in WITH_FRAMES
    assert "geometry_msgs/msg/Twist" not in WITH_FRAMES
    assert compile_plan(described("builtin_interfaces/msg/Time"), frames=True, stamps=True) is None  # no header's


OF_ONE = described("geometry_msgs/msg/TransformStamped")
_TRANSFORMS = MessageField("transforms", FieldType(145, 0, 0, OF_ONE.type_description.type_name))
TFMESSAGE = TypeDescription(
    MessageType("tf2_msgs/msg/TFMessage", (_TRANSFORMS,)),
    (OF_ONE.type_description, *OF_ONE.referenced_type_descriptions),
)
"""A wheel of tf2_msgs does not exist."""


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_transforms_are_rewritten_byte_for_byte(count: int) -> None:
    frames = [Frame("odom" if n % 2 else "", f"link_{n}", n, 0.5, -1.0, 0.1) for n in range(count)]
    expected = [
        each._replace(parent=PREFIX * (n % 2) + each.parent, child=PREFIX + each.child) for n, each in enumerate(frames)
    ]
    found = rewriter(TFMESSAGE).rewrite(serialized(frames, 5_250_000_000))
    assert found == serialized(expected, 5_250_000_000 + SHIFT)


# -- either byte order


def swapped(description: TypeDescription, payload: bytes) -> bytes:
    """Return a message of little-endian words in the other byte order."""
    out = bytearray(b"\0\0" + payload[2:4])
    types = {each.type_name: each for each in (description.type_description, *description.referenced_type_descriptions)}
    sizes = {2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 8, 9: 8, 10: 4, 11: 8, 13: 1, 15: 1, 16: 1}
    at = 4

    def take(size: int, alignment: int) -> bytes:
        nonlocal at
        pad = (4 - at) % alignment
        out.extend(payload[at : at + pad])
        at += pad + size
        return payload[at - size : at]

    def length() -> int:
        word = take(4, 4)
        out.extend(word[::-1])
        return int.from_bytes(word, "little")

    def field(kind: FieldType) -> None:
        container, base = divmod(kind.type_id - 1, 48)
        for _ in range(1 if container == 0 else kind.capacity if container == 1 else length()):
            if base + 1 == 1:
                for each in types[kind.nested_type_name].fields:
                    field(each.type)
                if not types[kind.nested_type_name].fields:
                    out.extend(take(1, 1))
            elif base + 1 in sizes:
                out.extend(take(sizes[base + 1], sizes[base + 1])[::-1])
            elif base + 1 in (18, 20, 22):
                for _ in range(length()):
                    out.extend(take(4, 1)[::-1])
            else:
                out.extend(take(length(), 1))

    for each in description.type_description.fields:
        field(each.type)
    return bytes(out + payload[at:])


@pytest.mark.parametrize("name", WITH_FRAMES)
def test_both_byte_orders_are_rewritten_alike(name: str) -> None:
    description = described(name)
    payload = bytes(serialize_message(filled(installed_class(name))))
    rewrites = rewriter(description)
    assert rewrites.rewrite(swapped(description, payload)) == swapped(description, rewrites.rewrite(payload))


# -- types that no package has


def test_what_lies_behind_a_name_keeps_its_values() -> None:
    """Fields of each alignment, wide strings, arrays and sequences of messages follow names of each length."""
    mixed = MessageType(
        "t/msg/Mixed", (MessageField("a", FieldType(6, 0, 0, "")), MessageField("b", FieldType(11, 0, 0, "")))
    )
    fields = (
        ("frame_id", 17, 0, 0, ""), ("small", 3, 0, 0, ""), ("other_frame_id", 17, 0, 0, ""), ("wide", 18, 0, 0, ""),
        ("many", 145, 0, 0, "t/msg/Mixed"), ("inner", 49, 3, 0, "t/msg/Inner"), ("fixed", 49, 2, 0, "t/msg/Mixed"),
        ("longs", 152, 0, 0, ""), ("names", 161, 0, 0, ""), ("shorts", 148, 0, 0, ""), ("end", 11, 0, 0, ""),
    )  # fmt: skip
    description = of(*fields)
    description = TypeDescription(description.type_description, (INNER, mixed))
    for first in ("", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg", "/x", "robot1/y"):
        for count in (0, 1, 3):
            payload = _written(first, "x" * count, count)
            found = rewriter(description, shift=0).rewrite(payload)
            values, before = (decode(description, each) for each in (found, payload))
            assert not before.problem
            assert not values.problem
            expected = before.message | {"frame_id": frame_in_python(first)}
            expected |= {"other_frame_id": frame_in_python("x" * count)}
            assert plain(values.message) == plain(expected)


def plain(value: Any) -> Any:
    if isinstance(value, Items):
        return [plain(each) for each in value.shown]
    return {name: plain(each) for name, each in value.items()} if isinstance(value, dict) else value


def _written(first: str, second: str, count: int) -> bytes:
    out = bytearray()

    def put(code: str, *values: Any) -> None:
        size = struct.calcsize(code)
        for value in values:
            out.extend(bytes(-len(out) % size))
            out.extend(struct.pack("<" + code, value))

    def text(value: str) -> None:
        put("I", len(value) + 1)
        out.extend(value.encode() + b"\0")

    text(first)
    put("B", 7)
    text(second)
    put("I", count)
    out.extend(struct.pack(f"<{count}I", *range(65, 65 + count)))
    put("I", count)
    for each in range(count):
        put("i", each)
        put("d", each + 0.5)
    for each in range(3):
        put("B", each)
        put("d", 2.5)
        put("I", 1)
        out.extend(struct.pack("<I", 66))
    for each in range(2):
        put("i", each)
        put("d", 0.25)
    put("I", count)
    put("q", *range(count))
    put("I", 2)
    text("n")
    text("nn")
    put("I", count)
    put("h", *range(count))
    put("d", 9.5)
    return b"\0\1\0\0" + bytes(out)


def test_a_name_too_long_for_its_field_is_no_message() -> None:
    description = of(("frame_id", 21, 0, 8, ""))
    assert rewriter(description, shift=0).rewrite(text_message("a")) == text_message("robot1/a")
    with pytest.raises(TransformError, match="robot1/odom is longer"):
        rewriter(description, shift=0).rewrite(text_message("odom"))


def text_message(text: str) -> bytes:
    return b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


@pytest.mark.parametrize(("number", "name"), [(12, ""), (14, ""), (1, "t/msg/None"), (255, "")])
def test_unknown_types_are_refused(number: int, name: str) -> None:
    fields = MessageField("frame_id", FieldType(17, 0, 0, "")), MessageField("a", FieldType(number, 0, 0, name))
    message = MessageType("t/msg/T", fields)
    with pytest.raises(UnknownTypeError):
        compile_plan(TypeDescription(message, ()), frames=True, stamps=True)


def test_types_that_double_at_each_level_take_no_time() -> None:
    def level(number: int) -> MessageType:
        kind = FieldType(1, 0, 0, f"t/msg/L{number + 1}") if number < 60 else FieldType(17, 0, 0, "")
        return MessageType(f"t/msg/L{number}", (MessageField("frame_id", kind), MessageField("b", kind)))

    first, *others = (level(number) for number in range(61))
    plan = compile_plan(TypeDescription(first, tuple(others)), frames=True, stamps=True)
    assert plan is not None
    with pytest.raises(TransformError):
        Rewriter(plan, PREFIX).rewrite(text_message("a"))


def test_a_type_within_itself_is_refused() -> None:
    message = MessageType("t/msg/T", (MessageField("again", FieldType(1, 0, 0, "t/msg/T")),))
    with pytest.raises(UnknownTypeError):
        compile_plan(TypeDescription(message, ()), frames=True, stamps=True)


# -- stamps


@pytest.mark.parametrize(
    ("stamp", "shift", "expected"),
    [
        ((10, 5), 10**9, (11, 5)),
        ((10, 5), -6, (9, 999_999_999)),
        ((0, 0), 10**9, (0, 0)),  # none, or the newest transform
        ((1, 0), -(10**9), (1, 0)),  # it must not become zero
        ((1, 0), -2 * 10**9, (1, 0)),
        ((2**31 - 1, 0), 10**9, (2**31 - 1, 0)),
        ((-5, 0), 10**9, (-5, 0)),
        ((5, 2**32 - 1), 10**9, (5, 2**32 - 1)),
    ],
)
def test_a_stamp_is_shifted_unless_it_is_none(stamp: tuple[int, int], shift: int, expected: tuple[int, int]) -> None:
    description = TypeDescription(
        MessageType("t/msg/T", (MessageField("header", FieldType(1, 0, 0, "std_msgs/msg/Header")),)), (HEADER, TIME)
    )
    frame = text_message("odom")[4:]
    found = rewriter(description, "", shift).rewrite(b"\0\1\0\0" + struct.pack("<iI", *stamp) + frame)
    assert found == b"\0\1\0\0" + struct.pack("<iI", *expected) + frame


# -- bytes of anybody


def hurt(draw: Callable[[Any], Any], payload: bytes) -> bytes:
    changed = bytearray(payload[: draw(st.integers(0, len(payload)))])
    if len(changed) >= 8:
        at = draw(st.integers(1, len(changed) // 4 - 1)) * 4
        value = draw(st.one_of(st.integers(0, 64), st.integers(0, 2**32 - 1), st.sampled_from([2**28, 2**32 - 1])))
        struct.pack_into("<I", changed, at, value)
    return bytes(changed)


@pytest.mark.parametrize("name", ["visualization_msgs/msg/MarkerArray", "nav_msgs/msg/Path", "sensor_msgs/msg/Image"])
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_bytes_give_a_message_or_an_error(name: str, data: st.DataObject) -> None:
    payload = hurt(data.draw, bytes(serialize_message(filled(installed_class(name)))))
    rewrites = rewriter(described(name))
    try:
        found = rewrites.rewrite(payload)
    except TransformError:
        return
    assert len(found) < len(payload) + 100 * len(PREFIX) + 8


@pytest.mark.parametrize("header", ["", "00", "00 01 00", "00 07 00 00", "01 01 00 00"])
def test_another_encapsulation_is_refused(header: str) -> None:
    with pytest.raises(TransformError, match="XCDR1"):
        rewriter(described("std_msgs/msg/Header")).rewrite(bytes.fromhex(header) + bytes(100 if len(header) > 8 else 0))


def test_a_message_of_too_many_parts_is_refused() -> None:
    inner = MessageType("t/msg/In", (MessageField("frame_id", FieldType(17, 0, 0, "")),))
    message = MessageType("t/msg/T", (MessageField("in", FieldType(145, 0, 0, "t/msg/In")),))
    payload = b"\0\1\0\0" + struct.pack("<I", STEPS + 1) + bytes(4 * (STEPS + 1))
    with pytest.raises(TransformError, match="250,000"):
        rewriter(TypeDescription(message, (inner,)), shift=0).rewrite(payload)


def test_long_names_are_not_kept() -> None:
    """A peer that makes up long names fills no memory with them."""
    made, long = rewriter(described("std_msgs/msg/Header"), shift=0), 100_000
    tracemalloc.start()
    for number in range(100):
        name = f"{number:0{long}}"
        payload = bytes(serialize_message(Header(frame_id=name)))
        assert deserialize_message(made.rewrite(payload), Header).frame_id == PREFIX + name
    payload, name = b"", ""
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 10 * long


@pytest.mark.parametrize(
    ("name", "expected"),
    [("odom", "p/odom"), ("/odom", "p/odom"), ("//odom", "p//odom"), ("p/odom", "p/odom"), ("/p/odom", "p/odom"),
     ("", ""), ("/", "/"), ("p", "p/p"), ("p/", "p/")],
)  # fmt: skip
def test_names_of_frames(name: str, expected: str) -> None:
    assert renamed(name.encode() + b"\0", b"p/") == expected.encode() + b"\0"
