"""Requests of a node's parameter services are those of rclpy, and answers of rclpy are read."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    Parameter,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.serialization import deserialize_message, serialize_message

from rsb_extras.node_control import parameter_records as records
from rsb_extras.node_control.cdr_fields import MalformedAnswerError
from rsb_extras.node_control.parameter_messages import (
    ALL_NAMES,
    names_request,
    read_descriptors,
    read_names,
    read_set,
    read_values,
    set_request,
)

VALUES: dict[Any, Any] = {
    "bool": True, "integer": -(2**63), "double": float("inf"), "string": "ä\n", "byte_array": [0, 255],
    "bool_array": [True, False], "integer_array": [1, 2**63 - 1], "double_array": [], "string_array": ["a", "b c", ""],
}  # fmt: skip


def message(kind: str, plain: Any) -> ParameterValue:
    number = getattr(ParameterType, f"PARAMETER_{kind.upper()}")
    shown = [bytes([each]) for each in plain] if kind == "byte_array" else plain
    return ParameterValue(type=number, **{f"{kind}_value": shown})


def packed(kind: Any, plain: Any) -> records.ParameterValue:
    return records.ParameterValue.of(kind, bytes(plain) if kind == "byte_array" else plain)


def test_values_are_those_of_ros() -> None:
    answer = GetParameters.Response(values=[*(message(*each) for each in VALUES.items()), ParameterValue()])
    read = read_values(serialize_message(answer))
    assert [(each.type, each.plain()) for each in read] == [*VALUES.items(), ("not_set", None)]
    request = set_request([records.NewValue(f"a.{kind}", packed(kind, plain)) for kind, plain in VALUES.items()])
    written = deserialize_message(request, SetParametersAtomically.Request)
    assert written.parameters == [Parameter(name=f"a.{kind}", value=message(kind, VALUES[kind])) for kind in VALUES]


def test_names_and_results_are_those_of_ros() -> None:
    assert deserialize_message(ALL_NAMES, ListParameters.Request) == ListParameters.Request()
    asked = deserialize_message(names_request(["b", "a.c"]), DescribeParameters.Request)
    assert asked.names == ["b", "a.c"]
    answer = ListParameters.Response()
    answer.result.names = ["b", "a.c", "", "x\x1b[2J", "y" * 256]
    assert read_names(serialize_message(answer)) == ["a.c", "b"]
    for result in (SetParametersResult(successful=True), SetParametersResult(reason="no\x07")):
        said = serialize_message(SetParametersAtomically.Response(result=result))
        assert read_set(said) == (result.successful, result.reason.replace("\x07", "\N{REPLACEMENT CHARACTER}"))


def test_descriptors_are_those_of_ros() -> None:
    nan, inf = float("nan"), float("inf")
    described = [
        ParameterDescriptor(
            name="speed", type=3, description="m/s\n", read_only=True,
            floating_point_range=[FloatingPointRange(from_value=-inf, to_value=2.0, step=0.5)],
        ),
        ParameterDescriptor(
            name="n", type=2, additional_constraints="even", dynamic_typing=True,
            integer_range=[IntegerRange(from_value=-2, to_value=2**63 - 1, step=2**64 - 1)],
        ),
        ParameterDescriptor(
            name="odd", floating_point_range=[FloatingPointRange(from_value=nan, to_value=nan, step=nan)]
        ),
    ]  # fmt: skip
    speed, number, odd = read_descriptors(serialize_message(DescribeParameters.Response(descriptors=described)))
    assert (speed.name, speed.type, speed.read_only, speed.dynamic) == ("speed", "double", True, False)
    assert speed.description == "m/s\N{REPLACEMENT CHARACTER}"
    assert (speed.ranges[0].high, speed.ranges[0].step) == (2.0, 0.5)
    assert speed.ranges[0].low < -1e308
    assert (number.constraints, number.dynamic) == ("even", True)
    assert number.ranges == (records.ParameterRange(-2, 2**63 - 1, 2**63 - 1),)
    assert odd.ranges == ()


@pytest.mark.parametrize("cut", [0, 3, 5, 9, 30, 60])
def test_a_cut_answer_is_no_answer(cut: int) -> None:
    answer = serialize_message(GetParameters.Response(values=[message("string", "x" * 100)]))
    with pytest.raises(MalformedAnswerError):
        read_values(answer[:cut])
    with pytest.raises(MalformedAnswerError, match="of type 12"):
        read_values(serialize_message(GetParameters.Response(values=[ParameterValue(type=12)])))
