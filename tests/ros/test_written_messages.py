"""An operator's text becomes the message that rclpy would make of it, or an error with the right form."""

from __future__ import annotations

import array
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from tests.cdr.decoder_helpers import TYPES
from tests.support.filled import filled
from tests.support.wording import pattern

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.config.fields_text import read_fields, write_fields
from rsb_bridge.model.calls import FIELDS_LENGTH, FieldError
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.ros.written_messages import Misfit, serialize

NOW = 1_700_000_000_000_000_005
EVENT, VALUE = "rcl_interfaces/msg/ParameterEvent", "rcl_interfaces/msg/ParameterValue"
PARTS = [
    "std_srvs/srv/Trigger_Request", "std_srvs/srv/SetBool_Response", "nav_msgs/srv/GetPlan_Response",
    "lifecycle_msgs/srv/GetAvailableTransitions_Response", "rcl_interfaces/srv/DescribeParameters_Response",
    "action_msgs/srv/CancelGoal_Request", "sensor_msgs/srv/SetCameraInfo_Request",
]  # fmt: skip


def made(type_name: str, text: str) -> Any:
    return deserialize_message(serialize(type_name, read_fields(text), NOW), installed_class(type_name))


def fields_of(value: Any) -> Any:
    """Return rclpy's fields of a message, as an operator would write them."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: fields_of(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, list | array.array | np.ndarray):
        return [fields_of(each) for each in value]
    if isinstance(value, bytes):
        return str(value[0])
    return str(value).lower() if isinstance(value, bool) else str(value)


@pytest.mark.parametrize("type_name", [*TYPES, *PARTS])
def test_every_installed_type_is_made_with_every_field(type_name: str) -> None:
    message_class: Any = installed_class(type_name)
    for message in (message_class(), filled(message_class)):
        assert deserialize_message(serialize(type_name, fields_of(message), NOW), message_class) == message
    assert deserialize_message(serialize(type_name, {}, NOW), message_class) == message_class()


@pytest.mark.parametrize("type_name", [*TYPES, *PARTS])
def test_what_is_written_of_message_makes_same_message(type_name: str) -> None:
    message_class: Any = installed_class(type_name)
    message = filled(message_class)
    description = installed_description(type_name)
    assert description is not None
    payload = serialize(type_name, fields_of(message), NOW)
    text = write_fields(decode(read_description(description, hash_of_text(description)), payload))
    assert "#" not in text
    if len(text.encode()) < FIELDS_LENGTH:
        assert made(type_name, text) == message
    else:
        assert type_name == "visualization_msgs/msg/InteractiveMarkerUpdate"


@settings(deadline=None)
@given(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
    st.floats(),
    st.integers(-(2**63), 2**63 - 1),
    st.lists(st.floats(), max_size=4),
    st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=10), max_size=4),
)
def test_every_value_survives_writing_and_reading(
    text: str, number: float, integer: int, numbers: list[float], texts: list[str]
) -> None:
    message_class: Any = installed_class(VALUE)
    message = message_class(
        string_value=text,
        double_value=number,
        integer_value=integer,
        double_array_value=numbers,
        string_array_value=texts,
        byte_array_value=[b"\0", b"\xff"],
    )
    payload = serialize(VALUE, fields_of(message), NOW)
    description = installed_description(VALUE)
    assert description is not None
    written = write_fields(decode(read_description(description, hash_of_text(description)), payload))
    assert repr(made(VALUE, written)) == repr(message)  # NaN equals NaN there


def test_a_text_stays_as_it_was_written() -> None:
    for text in ("no", "1.10", "0x10", "12:30:00", "2024-01-01", "true", "''", "'~'"):
        assert made("std_msgs/msg/String", f"data: {text}").data == text.strip("'")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", 1.0), ("-1.5e3", -1500.0), (".5", 0.5), ("0x10", 16.0), (".inf", math.inf), ("-inf", -math.inf),
     ("nan", None), (".NaN", None)],
)  # fmt: skip
def test_number_is_written_as_in_yaml_or_ros(text: str, value: float | None) -> None:
    number = made("std_msgs/msg/Float32", f"data: {text}").data
    assert math.isnan(number) if value is None else number == value


def test_defaults_are_those_of_the_type() -> None:
    assert made("geometry_msgs/msg/Pose", "position: {x: 2}").orientation.w == 1.0


def test_now_and_auto_are_the_time() -> None:
    stamp = made("builtin_interfaces/msg/Time", "{sec: 3}")
    assert (stamp.sec, stamp.nanosec) == (3, 0)
    for text in ("header: auto", "header: {stamp: now}"):
        stamp = made("geometry_msgs/msg/PoseStamped", text).header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == NOW
    assert made(EVENT, "stamp: now").stamp.nanosec == 5


def test_a_goal_is_named_as_it_is_shown() -> None:
    digits = "00112233445566778899aabbccddeeff"
    for text in (digits, "00112233-4455-6677-8899-AABBCCDDEEFF"):
        request = made("action_msgs/srv/CancelGoal_Request", f"goal_info: {{goal_id: {text}}}")
        assert bytes(request.goal_info.goal_id.uuid).hex() == digits


@pytest.mark.parametrize(
    ("type_name", "text", "code", "parameters"),
    [
        ("std_srvs/srv/SetBool_Request", "data: yes", Misfit.ANOTHER_KIND,
         {"location": "data", "value": "'yes'", "expected": "true or false (bool)"}),
        ("std_srvs/srv/SetBool_Request", "dat: true", Misfit.FIELD_MISTYPED, {"name": "'dat'", "close": "data"}),
        ("std_srvs/srv/SetBool_Request", "{x: 1}", Misfit.FIELD_UNKNOWN, {"name": "'x'", "known": "data"}),
        ("std_srvs/srv/Trigger_Request", "{x: 1}", Misfit.FIELD_UNKNOWN, {"name": "'x'", "known": "no fields"}),
        ("std_srvs/srv/SetBool_Request", "data:", Misfit.NO_VALUE, {"location": "data"}),
        ("std_srvs/srv/SetBool_Request", "true", Misfit.ANOTHER_KIND,
         {"location": "the request", "value": "'true'", "expected": "a mapping of data"}),
        ("std_srvs/srv/SetBool_Request", "- true", Misfit.ANOTHER_KIND,
         {"location": "the request", "value": "a list", "expected": "a mapping of data"}),
        ("std_msgs/msg/UInt8", "data: 256", Misfit.OUT_OF_RANGE,
         {"location": "data", "value": 256, "low": 0, "high": 255, "type_name": "uint8"}),
        ("std_msgs/msg/Byte", "data: -1", Misfit.OUT_OF_RANGE,
         {"location": "data", "value": -1, "low": 0, "high": 255, "type_name": "byte"}),
        ("std_msgs/msg/Int64", "data: 1.0", Misfit.ANOTHER_KIND,
         {"location": "data", "value": "'1.0'", "expected": "a whole number (int64)"}),
        ("std_msgs/msg/Int64", f"data: {'9' * 39}", Misfit.OUT_OF_RANGE, {"low": -(2**63)}),
        ("std_msgs/msg/Int64", f"data: {'9' * 5000}", Misfit.ANOTHER_KIND,
         {"value": f"'{'9' * 60}…'", "expected": "a whole number (int64)"}),
        ("std_msgs/msg/Float32", "data: 1e39", Misfit.TOO_LARGE,
         {"location": "data", "value": "1e39", "type_name": "float32"}),
        ("std_msgs/msg/Float64", "data: 1_0", Misfit.ANOTHER_KIND,
         {"location": "data", "value": "'1_0'", "expected": "a number (float64)"}),
        ("std_msgs/msg/Float64", "data: [1]", Misfit.ANOTHER_KIND,
         {"location": "data", "value": "a list", "expected": "a number (float64)"}),
        ("std_msgs/msg/String", "data: {a: b}", Misfit.ANOTHER_KIND,
         {"location": "data", "value": "a mapping", "expected": "text"}),
        ("std_msgs/msg/String", 'data: "\\0"', Misfit.NUL_CHARACTER, {"location": "data"}),
        ("std_msgs/msg/String", 'data: "\\uD800"', Misfit.HALF_A_SURROGATE_PAIR, {"location": "data"}),
        ("geometry_msgs/msg/Pose", "position: {x: 1, q: 2}", Misfit.FIELD_UNKNOWN,
         {"place": "position has", "name": "'q'", "known": "x, y, z"}),
        ("geometry_msgs/msg/Pose", "position: here", Misfit.ANOTHER_KIND,
         {"location": "position", "value": "'here'", "expected": "a mapping of x, y, z"}),
        ("geometry_msgs/msg/PoseArray", "poses: [{}, {position: {x: a}}]", Misfit.ANOTHER_KIND,
         {"location": "poses[1].position.x", "value": "'a'", "expected": "a number (float64)"}),
        ("geometry_msgs/msg/PoseArray", "header: {stamp: then}", Misfit.ANOTHER_KIND,
         {"location": "header.stamp", "value": "'then'", "expected": "a mapping of sec, nanosec"}),
        ("sensor_msgs/msg/CameraInfo", "k: [1, 2]", Misfit.WRONG_LENGTH,
         {"location": "k", "length": 2, "unit": "elements", "expected": 9}),
        ("sensor_msgs/msg/CameraInfo", "k: 5", Misfit.ANOTHER_KIND,
         {"location": "k", "value": "'5'", "expected": "a list"}),
        ("rcl_interfaces/msg/ParameterDescriptor", "integer_range: [{}, {}]", Misfit.TOO_LONG,
         {"location": "integer_range", "length": 2, "limit": 1}),
        ("unique_identifier_msgs/msg/UUID", "uuid: 0011", Misfit.ANOTHER_KIND,
         {"location": "uuid", "value": "'0011'", "expected": "a list"}),
    ],
)  # fmt: skip
def test_unfitting_value_names_place_and_remedy(
    type_name: str, text: str, code: Misfit, parameters: dict[str, object]
) -> None:
    with pytest.raises(FieldError, match=pattern(code, **parameters)) as refused:
        serialize(type_name, read_fields(text), NOW)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize(
    "type_name", ["no_such_msgs/srv/Name_Request", "std_srvs/srv/Nope_Request", "std_srvs/srv/SetBool", "std_srvs"]
)
def test_a_type_that_is_not_installed_is_refused(type_name: str) -> None:
    with pytest.raises(RosError, match=r"install|write it as"):
        serialize(type_name, {}, NOW)


def test_numbers_are_serialized_as_rclpy_serializes_them() -> None:
    payload = serialize("std_msgs/msg/UInt32", {"data": "258"}, NOW)
    assert payload[:8] == b"\0\1\0\0" + struct.pack("<I", 258)
