"""Messages of every type pass; lengths that do not fit are refused, in a time that the message's size bounds."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosidl_parser.definition import AbstractGenericString as AnyString
from rosidl_parser.definition import AbstractNestedType, Array, BasicType, BoundedSequence, NamespacedType
from tests.cdr.decoder_helpers import TYPES, described, of
from tests.support.filled import filled
from tests.support.steps import counted
from tests.support.wording import says

from rsb_bridge.cdr.checker import STEPS, Checker, Malformed, MalformedError, TooComplexError, UncheckableError
from rsb_bridge.cdr.decoder import Unreadable, decode
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription
from rsb_bridge.ros.native.typesupport import installed_class

EVERYTHING = 1 << 30
CHECKERS: dict[str, Checker] = {}
INT, DOUBLE, STRING, NESTED = 6, 11, 17, 1
ARRAY, BOUNDED, SEQUENCE = 48, 96, 144
"""Added to a type's id."""


def checker(name: str) -> Checker:
    if name not in CHECKERS:
        CHECKERS[name] = Checker(described(name))
    return CHECKERS[name]


VARYING = [name for name in TYPES if checker(name).loops or "Image" in name]
"""Types whose messages have lengths in them."""


def field_of(payload: bytes, description: TypeDescription) -> str:
    """The field that shows that a message is malformed."""
    with pytest.raises(MalformedError) as caught:
        Checker(description).check(payload)
    return caught.value.field


def drawn(draw: Callable[[Any], Any], message_class: Any, depth: int = 0) -> Any:
    slots = zip(message_class.get_fields_and_field_types(), message_class.SLOT_TYPES, strict=True)
    return message_class(**{name: _value(draw, slot, depth) for name, slot in slots})


def _value(draw: Callable[[Any], Any], slot: Any, depth: int) -> Any:
    if isinstance(slot, AbstractNestedType):
        most = slot.maximum_size if isinstance(slot, BoundedSequence) else 4 - min(depth, 3)
        count = slot.size if isinstance(slot, Array) else draw(st.integers(0, min(most, 4)))
        values = [_value(draw, slot.value_type, depth + 1) for _ in range(count)]
        kind = slot.value_type
        return np.array(values) if isinstance(kind, BasicType) and kind.typename == "double" and count else values
    if isinstance(slot, NamespacedType):
        return drawn(draw, installed_class("/".join(slot.namespaced_name())), depth + 1)
    if isinstance(slot, AnyString):
        most = slot.maximum_size if slot.has_maximum_size() else 12
        return draw(st.text("aé0", max_size=min(most // 2, 12)))
    assert isinstance(slot, BasicType)
    if slot.typename == "octet":
        return bytes([draw(st.integers(0, 255))])
    return {"boolean": True, "float": 1.5, "double": -math.pi}.get(slot.typename, 1)


@pytest.mark.parametrize("name", VARYING)
@settings(max_examples=4, deadline=None)
@given(st.data())
def test_what_rclpy_serializes_passes(name: str, data: st.DataObject) -> None:
    payload = bytes(serialize_message(drawn(data.draw, installed_class(name))))
    checker(name).check(payload)
    checker(name).check(payload + b"more")


@pytest.mark.parametrize("name", TYPES)
def test_cut_message_passes_only_if_readable(name: str) -> None:
    """The decoder reads field by field what the checker skips at once; both find the same end."""
    description = described(name)
    for message in (installed_class(name)(), filled(installed_class(name))):  # type: ignore[misc]
        payload = bytes(serialize_message(message))
        for length in range(max(0, len(payload) - 100), len(payload) + 1):
            readable = not decode(description, payload[:length], items=0, steps=EVERYTHING).problem
            assert passes(checker(name), payload[:length]) == readable, length


def passes(of_type: Checker, payload: bytes) -> bool:
    try:
        of_type.check(payload)
    except MalformedError:
        return False
    return True


@pytest.mark.parametrize("name", VARYING)
@settings(max_examples=20, deadline=None)
@given(st.data())
def test_changed_word_passes_only_if_readable(name: str, data: st.DataObject) -> None:
    """For all announced lengths, an accepted message reserves nothing beyond its bytes."""
    payload = bytearray(serialize_message(filled(installed_class(name))))
    at = data.draw(st.integers(1, len(payload) // 4 - 1)) * 4
    value = data.draw(st.one_of(st.integers(0, 64), st.integers(0, 2**32 - 1), st.sampled_from([2**28, 2**32 - 1])))
    struct.pack_into("<I", payload, at, value)
    decoded = decode(described(name), bytes(payload), items=0, steps=EVERYTHING)
    if passes(checker(name), bytes(payload)):
        assert not decoded.problem or says(decoded.problem, Unreadable.STRING_WITHOUT_END)
    else:
        assert decoded.problem


def test_eight_bytes_are_refused() -> None:
    payload = bytes.fromhex("00 01 00 00 00 00 00 10")
    with pytest.raises(MalformedError) as caught:
        checker("rcl_interfaces/srv/SetParameters_Request").check(payload)
    assert caught.value.field == "parameters"


@pytest.mark.parametrize(
    ("value", "field"), [((2, 4), "in.some"), ((1, 8, 1, 30), "names[]"), ((1, 8, 2**30), "names"), ((1, 8), "names")]
)
def test_the_field_is_named(value: tuple[int, ...], field: str) -> None:
    inner = MessageType("t/msg/In", (MessageField("some", FieldType(INT + SEQUENCE, 0, 0, "")),))
    fields = (
        MessageField("in", FieldType(NESTED, 0, 0, "t/msg/In")),
        MessageField("names", FieldType(STRING + SEQUENCE, 0, 0, "")),
    )
    description = TypeDescription(MessageType("t/msg/T", fields), (inner,))
    payload = b"\x00\x01\x00\x00" + struct.pack(f"<{len(value)}I", *value)
    assert field_of(payload, description) == field


@pytest.mark.parametrize("header", ["", "00", "00 01 00", "00 02 00 00", "00 07 00 00", "01 01 00 00"])
def test_another_encapsulation_is_refused(header: str) -> None:
    payload = bytes.fromhex(header) + bytes(64 if header.count(" ") == 3 else 0)
    assert field_of(payload, described("geometry_msgs/msg/Twist")) == ""
    assert field_of(payload, described("std_msgs/msg/String")) == ""


def test_bounds_hold() -> None:
    description = of(("few", INT + BOUNDED, 3, 0, ""), ("brief", 21, 0, 4, ""))
    head = b"\x00\x01\x00\x00"
    Checker(description).check(head + struct.pack("<4iI", 3, 1, 2, 3, 5) + b"four\0")
    assert field_of(head + struct.pack("<5iI", 4, 1, 2, 3, 4, 0), description) == "few"
    assert field_of(head + struct.pack("<iI", 0, 6) + b"fiver\0", description) == "brief"


@pytest.mark.parametrize(
    ("field", "content"),
    [
        (("it", 21, 0, 4, ""), b"fiver\0"),
        (("it", 3 + BOUNDED, 4, 0, ""), b"fiver\0"),
        (("it", 22, 0, 4, ""), bytes(24)),
    ],
)
def test_a_bound_is_that_of_the_type(field: Any, content: bytes) -> None:
    """The length of a string counts its terminating zero, too."""
    with pytest.raises(MalformedError) as found:
        Checker(of(field)).check(b"\x00\x01\x00\x00" + struct.pack("<I", 6) + content)
    assert Malformed.ABOVE_BOUND(bound=4) in str(found.value)


def test_strings_need_no_zero_at_their_end() -> None:
    """Fast CDR reads them, and strings of length 0."""
    of_string = checker("std_msgs/msg/String")
    of_string.check(b"\x00\x01\x00\x00" + struct.pack("<I", 3) + b"abc")
    of_string.check(b"\x00\x01\x00\x00" + struct.pack("<I", 0))


def test_big_endian() -> None:
    of_array = Checker(of(("names", STRING + SEQUENCE, 0, 0, ""), ("values", DOUBLE + SEQUENCE, 0, 0, "")))
    payload = b"\x00\x00\x00\x00" + struct.pack(">2I2s2xI", 1, 2, b"a\0", 1) + struct.pack(">d", 1.5)
    of_array.check(payload)
    for length in range(len(payload)):
        assert not passes(of_array, payload[:length])
    assert not passes(of_array, b"\x00\x01" + payload[2:])


def test_padding_between_elements_repeats() -> None:
    """One byte and a double: elements begin at different places, so that their padding differs."""
    odd = MessageType("t/msg/Odd", (MessageField("a", FieldType(3, 0, 0, "")),
                                    MessageField("b", FieldType(DOUBLE, 0, 0, "")),
                                    MessageField("c", FieldType(3, 0, 0, ""))))  # fmt: skip
    fields = (
        MessageField("lead", FieldType(3, 0, 0, "")),
        MessageField("odds", FieldType(NESTED + SEQUENCE, 0, 0, "t/msg/Odd")),
    )
    description = TypeDescription(MessageType("t/msg/T", fields), (odd,))
    for count in range(20):
        payload = b"\x00\x01\x00\x00\x07\x00\x00\x00" + struct.pack("<I", count)
        at = 8
        for _ in range(count):
            pad = -(at + 1) % 8
            payload += bytes(1 + pad + 9)
            at += 1 + pad + 9
        Checker(description).check(payload)
        assert not decode(description, payload, steps=EVERYTHING).problem
        if count:
            assert field_of(payload[:-1], description) == "odds"


# --- descriptions that no ROS type has, and time


@pytest.mark.parametrize(
    "fields",
    [
        [("a", 12, 0, 0, "")],
        [("a", 200, 0, 0, "")],
        [("a", NESTED, 0, 0, "t/msg/Gone")],
        [("a", NESTED, 0, 0, "t/msg/T")],
        [("a", INT + ARRAY, 0, 0, "")],
        [("a", 0, 0, 0, "")],
    ],
)
def test_types_that_cannot_be_checked_are_named(fields: list[tuple[str, int, int, int, str]]) -> None:
    with pytest.raises(UncheckableError):
        Checker(of(*fields))


def test_types_within_types_within_types() -> None:
    """Twice the same in each of 60 levels: 2^60 strings, which no message has."""
    types = [MessageType("t/msg/L0", (MessageField("s", FieldType(STRING, 0, 0, "")),))]
    for level in range(1, 60):
        inner = FieldType(NESTED, 0, 0, f"t/msg/L{level - 1}")
        types.append(MessageType(f"t/msg/L{level}", (MessageField("a", inner), MessageField("b", inner))))

    def pass_one() -> bool:
        return passes(Checker(TypeDescription(types[-1], tuple(types[:-1]))), b"\x00\x01\x00\x00" + bytes(1000))

    passed, calls = counted(pass_one)
    assert not passed
    assert calls < 1000 * len(types)


@settings(max_examples=settings().max_examples * 2, deadline=None)
@given(
    st.lists(st.sampled_from([3, 4, INT, DOUBLE, STRING]), min_size=1, max_size=5),
    st.lists(st.text("ab", max_size=9), max_size=12),
    st.sampled_from([3, INT, DOUBLE]),
    st.integers(0, 12),
)
def test_elements_with_strings_end_where_they_end(kinds: list[int], texts: list[str], after: int, cut: int) -> None:
    """The checker agrees with the decoder: some are skipped by words, and the next element may begin at any byte."""
    element = MessageType(
        "t/msg/E", tuple(MessageField(f"f{n}", FieldType(kind, 0, 0, "")) for n, kind in enumerate(kinds))
    )
    fields = (
        MessageField("all", FieldType(NESTED + SEQUENCE, 0, 0, "t/msg/E")),
        MessageField("after", FieldType(after + SEQUENCE, 0, 0, "")),
    )
    description = TypeDescription(MessageType("t/msg/T", fields), (element,))
    body, strings = struct.pack("<I", len(texts)), iter(texts * len(kinds))
    for _ in texts:
        for kind in kinds:
            size = {3: 1, 4: 2, DOUBLE: 8}.get(kind, 4)
            body += bytes(-len(body) % size)
            words = next(strings).encode() + b"\0"
            body += struct.pack("<I", len(words)) + words if kind == STRING else bytes(size)
    size = {3: 1, DOUBLE: 8}.get(after, 4)
    body += bytes(-len(body) % 4) + struct.pack("<I", 3)
    body += bytes(-len(body) % size) + bytes(3 * size)
    payload = b"\0\1\0\0" + body
    made = Checker(description)
    made.check(payload)
    if cut:
        short = payload[:-cut]
        assert passes(made, short) == (not decode(description, short, steps=EVERYTHING).problem)


def test_an_array_of_strings_may_begin_anywhere() -> None:
    fields = (MessageField("lead", FieldType(3, 0, 0, "")), MessageField("three", FieldType(STRING + ARRAY, 3, 0, "")))
    description = TypeDescription(MessageType("t/msg/T", fields), ())
    payload = b"\0\1\0\0\7\0\0\0" + struct.pack("<I1s3xI2s2xI3s", 1, b"\0", 2, b"a\0", 3, b"bc\0")
    Checker(description).check(payload)
    for length in range(len(payload)):
        assert field_of(payload[:length], description) in ("", "three", "three[]")


def test_an_empty_message_has_a_byte() -> None:
    fields = (MessageField("all", FieldType(NESTED + SEQUENCE, 0, 0, "t/msg/Empty")),)
    made = Checker(TypeDescription(MessageType("t/msg/T", fields), (MessageType("t/msg/Empty", ()),)))
    made.check(b"\x00\x01\x00\x00" + struct.pack("<I", 10) + bytes(10))
    assert not passes(made, b"\x00\x01\x00\x00" + struct.pack("<I", 11) + bytes(10))


def test_the_number_of_lengths_is_bounded() -> None:
    of_array = Checker(of(("names", STRING + SEQUENCE, 0, 0, "")))
    head = b"\x00\x01\x00\x00"
    assert of_array.check(head + struct.pack("<I", STEPS) + bytes(4 * STEPS)) == STEPS
    with pytest.raises(TooComplexError):
        of_array.check(head + struct.pack("<I", STEPS + 1) + bytes(4 * STEPS + 4))


KINDS = st.sampled_from([2, 4, 6, 8, 11, 17, 18, 21, NESTED])
NAMES = ("t/msg/A", "t/msg/B", "t/msg/C")


@st.composite
def descriptions(draw: Callable[[Any], Any]) -> TypeDescription:
    """Three types, each of which may contain those after it."""
    types = []
    for number in range(3):
        fields = []
        for index in range(draw(st.integers(0, 4))):
            base, container = draw(KINDS), draw(st.sampled_from([0, ARRAY, BOUNDED, SEQUENCE]))
            if base == NESTED and number == 2:
                base = INT
            inner = draw(st.sampled_from(NAMES[number + 1 :])) if base == NESTED else ""
            capacity = draw(st.sampled_from([1, 2, 3, 1000, 2**32 - 1]))
            fields.append(MessageField(f"f{index}", FieldType(base + container, capacity, capacity, inner)))
        fields = fields or [MessageField("d", FieldType(3, 0, 0, ""))]
        types.append(MessageType(NAMES[number], tuple(fields)))
    return TypeDescription(types[0], tuple(types[1:]))


@settings(max_examples=settings().max_examples * 2, deadline=None)
@given(descriptions(), st.binary(max_size=64), st.lists(st.integers(0, 5), max_size=40), st.booleans())
def test_nothing_else_is_raised_whatever_comes(
    description: TypeDescription, noise: bytes, words: list[int], little: bool
) -> None:
    made = Checker(description)
    head = b"\x00\x01\x00\x00" if little else b"\x00\x00\x00\x00"
    for payload in (noise, head + noise, head + struct.pack(f"{'<' if little else '>'}{len(words)}I", *words) + noise):
        found = passes(made, payload)
        problem = decode(description, payload, items=0, steps=20_000).problem
        if found:
            assert not problem or "without its end" in problem or "16 bits" in problem
        elif payload[:2] in (b"\x00\x00", b"\x00\x01"):
            assert problem
