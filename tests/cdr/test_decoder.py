"""Messages are read by their types' descriptions as ROS itself reads them, and nothing that comes can do harm."""

from __future__ import annotations

import array
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from tests.cdr.decoder_helpers import INNER, TYPES, described, of
from tests.support.filled import filled
from tests.support.wording import pattern, says

from rsb_bridge.cdr.decoder import Decoded, Items, Unreadable, decode
from rsb_bridge.cdr.description import (
    DescriptionError,
    FieldType,
    InvalidDescription,
    MessageField,
    MessageType,
    TypeDescription,
    hash_of_text,
    read_description,
    text_of,
)
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of, installed_class

EVERYTHING = 1 << 30


def tree(value: Any) -> Any:
    """Return rclpy's message in plain values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: tree(getattr(value, field)) for field in value.get_fields_and_field_types()} or {
            "structure_needs_at_least_one_member": 0
        }
    if isinstance(value, np.generic | np.ndarray | array.array):
        return value.tolist()
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, list):
        return [tree(each) for each in value]
    return value


def plain(value: Any) -> Any:
    if isinstance(value, Items):
        assert len(value.shown) == value.total
        return [plain(each) for each in value.shown]
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    return value


def test_all_of_them_are_there() -> None:
    assert len(TYPES) > 150


@pytest.mark.parametrize("name", TYPES)
def test_every_installed_type_reads_as_rclpy_reads_it(name: str) -> None:
    message_class: Any = installed_class(name)
    description = described(name)
    for message in (message_class(), filled(message_class)):
        payload = serialize_message(message)
        decoded = decode(description, payload, items=EVERYTHING, steps=EVERYTHING)
        assert decoded.problem == ""
        assert plain(decoded.message) == tree(deserialize_message(payload, message_class))


# --- kinds of fields that no installed type has


def test_every_kind_of_field() -> None:
    """Against a message of a package that was built for this, as rclpy of Jazzy on x86-64 serialized it."""
    text, *digits = Path(__file__).with_name("everything.txt").read_text(encoding="utf-8").splitlines()
    description = read_description(text, hash_of_text(text))
    inner = {n: {"a": n, "b": n / 2, "w": "é" * n} for n in range(5)}
    decoded = decode(description, bytes.fromhex("".join(digits)))
    assert decoded.problem == ""
    assert plain(decoded.message) == {
        "flag": True, "i8": -8, "wide": "größer 漢", "wide_bounded": "12345", "brief": "0123456789",
        "briefs": ["a", "", "ccc"], "wides": ["x", "yz"], "some": [-1, 2, -3], "three": [1.5, 2.5, -0.0],
        "inner": inner[1], "inners": [inner[2], inner[0], inner[3]], "pair": [inner[1], inner[2]], "few": [inner[4]],
        "bytes": [1, 255], "c": 65, "bools": [True, False, True], "two": ["", "two"], "last": -(2**62),
    }  # fmt: skip


def test_big_endian() -> None:
    description = of(("a", 3, 0, 0, ""), ("b", 8, 0, 0, ""), ("w", 18, 0, 0, ""), ("s", 148, 0, 0, ""))
    payload = b"\x00\x00\x00\x00" + struct.pack(">B7xqI2IIhh", 1, -2, 2, ord("h"), ord("é"), 2, -5, 6)
    assert plain(decode(description, payload).message) == {"a": 1, "b": -2, "w": "hé", "s": [-5, 6]}


def test_arrays_of_none_are_not_free() -> None:
    """They have no bytes, so that only the steps bound what a hostile description makes of a message of four."""
    many = tuple(MessageField(f"f{number}", FieldType(1 + 48, 0, 0, "t/msg/Inner")) for number in range(600))
    outer = MessageType("t/msg/Many", many)
    top = MessageType("t/msg/T", (MessageField("all", FieldType(1 + 48, 1_000_000, 0, "t/msg/Many")),))
    hostile = TypeDescription(top, (outer, MessageType("t/msg/Inner", ())))
    decoded = decode(hostile, b"\x00\x01\x00\x00", items=10**9, steps=1000)
    kept = decoded.message["all"]
    assert isinstance(kept, Items)
    assert len(kept.shown) <= 2
    assert decoded.problem


def test_long_array_is_shortened_and_rest_read() -> None:
    cloud: Any = installed_class("sensor_msgs/msg/PointCloud2")
    payload = serialize_message(cloud(data=array.array("B", bytes(range(256)) * 4000), is_dense=True))
    message = decode(described("sensor_msgs/msg/PointCloud2"), payload, items=5).message
    assert message["data"] == Items("uint8", 1_024_000, [0, 1, 2, 3, 4])
    assert message["is_dense"] is True


def test_beginning_of_message_shows_what_is_in_it() -> None:
    image: Any = installed_class("sensor_msgs/msg/Image")
    payload = serialize_message(
        image(height=1080, width=1920, encoding="rgb8", data=array.array("B", bytes(6_220_800)))
    )
    decoded = decode(described("sensor_msgs/msg/Image"), payload[:100_000], items=5)
    assert (decoded.message["height"], decoded.message["width"]) == (1080, 1920)
    assert decoded.message["data"] == Items("uint8", 6_220_800, [0, 0, 0, 0, 0])
    assert says(decoded.problem, Unreadable.FIELD, field="data")
    assert says(decoded.problem, Unreadable.ENDS_EARLY, expected=6_220_800)


def header(*parts: bytes) -> bytes:
    return b"\x00\x01\x00\x00" + b"".join(parts)


ENDLESS = TypeDescription(MessageType("t/msg/T", (MessageField("again", FieldType(1, 0, 0, "t/msg/T")),)), ())
EMPTY_ELEMENTS = TypeDescription(
    MessageType("t/msg/T", (MessageField("many", FieldType(145, 0, 0, "t/msg/E")),)), (MessageType("t/msg/E", ()),)
)


@pytest.mark.parametrize(
    ("of_what", "payload", "field", "problem", "parameters"),
    [
        (("a", 6, 0, 0, ""), b"", "", Unreadable.NO_BYTES, {}),
        (("a", 6, 0, 0, ""), b"\x00\x07\x00\x00" + bytes(8), "", Unreadable.NOT_XCDR1, {"beginning": "00 07 00 00"}),
        (("a", 6, 0, 0, ""), header(b"\x01\x02"), "a", Unreadable.ENDS_EARLY, {"expected": 4, "left": 2}),
        (("a", 153, 0, 0, ""), header(b"\xff\xff\xff\x7f"), "a", Unreadable.ENDS_EARLY, {"expected": 17_179_869_176}),
        (("s", 17, 0, 0, ""), header(b"\xff\xff\xff\xff"), "s", Unreadable.ENDS_EARLY, {"expected": 4_294_967_295}),
        (("s", 18, 0, 0, ""), header(b"\xff\xff\xff\xff"), "s", Unreadable.ENDS_EARLY, {"expected": 17_179_869_180}),
        (("s", 17, 0, 0, ""), header(b"\x02\x00\x00\x00ab"), "s", Unreadable.STRING_WITHOUT_END, {}),
        (("s", 18, 0, 0, ""), header(b"\x01\x00\x00\x00\x00\x00\x01\x00"), "s", Unreadable.CHARACTER_TOO_WIDE, {}),
        (("s", 21, 0, 3, ""), header(b"\x05\x00\x00\x00abcd\x00"), "s", Unreadable.STRING_TOO_LONG, {"limit": 3}),
        (("a", 102, 2, 0, ""), header(b"\x03\x00\x00\x00" + bytes(12)), "a", Unreadable.SEQUENCE_TOO_LONG,
         {"length": 3}),
        (("n", 1, 0, 0, "t/msg/None"), header(), "n", Unreadable.TYPE_MISSING, {"type": "t/msg/None"}),
        (("x", 12, 0, 0, ""), header(bytes(16)), "x", Unreadable.TYPE_UNKNOWN, {"type": 12}),
        (("x", 0, 0, 0, ""), header(bytes(16)), "x", Unreadable.TYPE_UNKNOWN, {"type": 0}),
        (("x", 250, 0, 0, ""), header(bytes(16)), "x", Unreadable.TYPE_UNKNOWN, {"type": 250}),
        (ENDLESS, header(bytes(8)), None, Unreadable.TOO_DEEP, {"limit": 64}),
        (EMPTY_ELEMENTS, header(b"\xff\xff\xff\xff"), None, Unreadable.TOO_MANY_VALUES, {}),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_said(
    of_what: Any, payload: bytes, field: str | None, problem: Unreadable, parameters: dict[str, object]
) -> None:
    began = time.process_time()
    found = decode(of_what if isinstance(of_what, TypeDescription) else of(of_what), payload).problem
    assert says(found, problem, **parameters)
    assert field is None or found.startswith(f"{field}: " if field else "it ")
    assert time.process_time() - began < 1.0


def test_what_was_read_before_stays() -> None:
    description = of(("a", 3, 0, 0, ""), ("n", 1, 0, 0, "t/msg/Inner"))
    decoded = decode(description, header(b"\x05\x06"))
    assert decoded == Decoded(
        {"a": 5, "n": {"a": 6}}, Unreadable.FIELD(field="n", problem=Unreadable.ENDS_EARLY(expected=8, left=0))
    )


kinds = st.builds(
    FieldType,
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["", "t/msg/T", "t/msg/Inner", "t/msg/E"]),
)
descriptions = st.builds(
    lambda fields: TypeDescription(
        MessageType("t/msg/T", tuple(MessageField(f"f{n}", kind) for n, kind in enumerate(fields))),
        (INNER, MessageType("t/msg/E", ())),
    ),
    st.lists(kinds, max_size=6),
)


@given(descriptions, st.one_of(st.just(b"\x00\x01\x00\x00"), st.just(b"\x00\x00\x00\x00")), st.binary(max_size=200))
def test_whatever_comes_it_ends_and_raises_nothing(
    description: TypeDescription, encapsulation: bytes, content: bytes
) -> None:
    decode(description, encapsulation + content, steps=2000)


def test_description_is_proved_by_its_hash() -> None:
    text = installed_description("sensor_msgs/msg/LaserScan")
    assert text is not None
    scan_hash = hash_of_text(text)
    assert scan_hash == hash_of(installed_class("sensor_msgs/msg/LaserScan"))  # type: ignore[arg-type]
    assert text_of(read_description(text, scan_hash)) == text
    with pytest.raises(DescriptionError, match=pattern(InvalidDescription.ANOTHER_TYPE)):
        read_description(text.replace("range_min", "range_max"), scan_hash)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "\ud800", "[" * 60_000, '{"type_description": 3}', "x" * 70_000], ids=range(7)
)
def test_what_is_no_description_is_refused(text: str) -> None:
    try:
        type_hash = hash_of_text(text)
    except UnicodeEncodeError:
        type_hash = ""
    with pytest.raises(DescriptionError):
        read_description(text, type_hash)


def test_what_is_not_installed_has_no_description() -> None:
    assert installed_description("no_such_msgs/msg/Name") is None
