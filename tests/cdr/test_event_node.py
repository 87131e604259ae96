"""Parameter events are distinguished by their node, and get its other name, with all values unchanged."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from tests.support.steps import counted
from tests.support.wording import pattern

from rsb_bridge.cdr.event_node import LONGEST, InvalidEvent, ParameterEventError, node_of, with_node

NAMES = st.from_regex(r"(/[a-z_][a-z0-9_]{0,11}){1,3}", fullmatch=True)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
INT64 = st.integers(-(2**63), 2**63 - 1)
FLOATS = st.floats()
VALUES = st.builds(
    ParameterValue,
    type=st.integers(0, 255),
    bool_value=st.booleans(),
    integer_value=INT64,
    double_value=FLOATS,
    string_value=TEXTS,
    byte_array_value=st.lists(st.binary(min_size=1, max_size=1), max_size=5),
    bool_array_value=st.lists(st.booleans(), max_size=5),
    integer_array_value=st.lists(INT64, max_size=3),
    double_array_value=st.lists(FLOATS, max_size=3),
    string_array_value=st.lists(TEXTS, max_size=3),
)
PARAMETERS = st.lists(st.builds(Parameter, name=TEXTS, value=VALUES), max_size=3)
EVENTS = st.builds(
    ParameterEvent, node=NAMES, new_parameters=PARAMETERS, changed_parameters=PARAMETERS, deleted_parameters=PARAMETERS
)


@given(EVENTS, NAMES)
def test_event_gets_another_name_and_keeps_everything_else(event: Any, name: str) -> None:
    event.stamp.sec, event.stamp.nanosec = -5, 999_999_999
    payload = serialize_message(event)
    assert node_of(payload) == event.node
    renamed = with_node(payload, name)
    assert node_of(renamed) == name
    again = deserialize_message(renamed, ParameterEvent)
    assert again.node == name
    again.node = event.node
    assert repr(again) == repr(event)  # NaN equals NaN there


@given(EVENTS, NAMES)
def test_so_does_one_of_the_other_byte_order(event: Any, name: str) -> None:
    payload = big_endian(event)
    assert node_of(payload) == event.node
    event.node = name
    assert with_node(payload, name) == big_endian(event)


def big_endian(event: Any) -> bytes:
    """An event as a big-endian machine serializes it."""
    out = bytearray(b"\0\0\0\0")

    def put(code: str, *values: Any) -> None:
        size = struct.calcsize(f">{code}")
        out.extend(bytes(-(len(out) - 4) % size))
        out.extend(struct.pack(f">{len(values)}{code}", *values))

    def text(words: str) -> None:
        content = words.encode() + b"\0"
        put("I", len(content))
        out.extend(content)

    def array(code: str, values: Any) -> None:
        put("I", len(values))
        if len(values):
            put(code, *values)

    put("i", event.stamp.sec)
    put("I", event.stamp.nanosec)
    text(event.node)
    for parameters in (event.new_parameters, event.changed_parameters, event.deleted_parameters):
        put("I", len(parameters))
        for parameter in parameters:
            value = parameter.value
            text(parameter.name)
            put("B", value.type)
            put("?", value.bool_value)
            put("q", value.integer_value)
            put("d", value.double_value)
            text(value.string_value)
            array("B", b"".join(value.byte_array_value))
            array("?", value.bool_array_value)
            array("q", value.integer_array_value)
            array("d", value.double_array_value)
            put("I", len(value.string_array_value))
            for each in value.string_array_value:
                text(each)
    return bytes(out)


GOOD = serialize_message(ParameterEvent(node="/a", new_parameters=[Parameter(name="b")]))


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x00\x01",
        b"\x00\x07\x00\x00" + GOOD[4:],  # another encoding
        GOOD[:4],
        GOOD[:14],
        GOOD[:12] + b"\xff\xff\xff\xff" + GOOD[16:],
        GOOD[:12] + bytes(4) + GOOD[16:],  # a name of no bytes
        GOOD[:12] + b"\x02\x00\x00\x00/a" + GOOD[18:],  # one without its end
    ],
    ids=range(8),
)
def test_what_is_no_event_is_refused(payload: bytes) -> None:
    with pytest.raises(ParameterEventError):
        node_of(payload)


@pytest.mark.parametrize("end", range(20, len(with_node(GOOD, "/a"))))
def test_an_event_that_is_cut_off_is_refused(end: int) -> None:
    with pytest.raises(ParameterEventError):
        with_node(GOOD[:end], "/b")


@given(st.binary(max_size=300))
def test_whatever_stands_in_it_nothing_else_is_raised(content: bytes) -> None:
    for order in (b"\0\0\0\0", b"\0\1\0\0"):
        with suppress(ParameterEventError):
            node_of(order + content)
        with suppress(ParameterEventError):
            with_node(order + content, "/a")


def test_largest_take_moments_larger_are_refused() -> None:
    event = ParameterEvent(node="/a", new_parameters=[Parameter()] * 4000)
    payload = serialize_message(event)
    assert 0.9 * LONGEST < len(payload) < LONGEST
    node, calls = counted(lambda: node_of(with_node(payload, "/another")))
    assert node == "/another"
    assert calls < 100 * len(event.new_parameters)
    with pytest.raises(ParameterEventError, match=pattern(InvalidEvent.TOO_LONG)):
        with_node(payload + bytes(LONGEST), "/another")
