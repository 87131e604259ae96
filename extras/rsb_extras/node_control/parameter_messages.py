"""The services of a node's parameters (rcl_interfaces): their requests are written here, and their answers read."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.feature_api import sanitize_text
from rsb_extras.node_control.cdr_fields import FieldReader, FieldWriter, MalformedAnswerError
from rsb_extras.node_control.parameter_records import (
    MOST_PARAMETERS,
    ParameterRange,
    ParameterValue,
)
from rsb_extras.node_control.parameter_types import PARAMETER_TYPES, ParameterType

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_extras.node_control.parameter_records import NewValue

LIST, LIST_TYPE = "/list_parameters", "rcl_interfaces/srv/ListParameters"
DESCRIBE, DESCRIBE_TYPE = "/describe_parameters", "rcl_interfaces/srv/DescribeParameters"
GET, GET_TYPE = "/get_parameters", "rcl_interfaces/srv/GetParameters"
SET, SET_TYPE = "/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically"
ALL_NAMES = FieldWriter().number("I", 0).number("Q", 0).message
"""A request of ListParameters: no prefix, any depth."""
_READ_NAMES = 4 * MOST_PARAMETERS
"""Names in an answer, of which the first by the alphabet are taken."""
_LONGEST_NAME = 255
_MOST_ELEMENTS = 1 << 24
"""Of an array: an answer has fewer bytes."""
_CODES: dict[str, str] = {"bool": "?", "integer": "q", "double": "d"}


class ReadDescriptor(NamedTuple):
    """A node's descriptor of a parameter; `NodeParameter` says what its fields mean."""

    name: str
    type: ParameterType
    read_only: bool
    dynamic: bool
    description: str
    constraints: str
    ranges: tuple[ParameterRange, ...]


NO_DESCRIPTOR = ReadDescriptor("", "not_set", False, False, "", "", ())


def read_names(answer: bytes) -> list[str]:
    """Return the names in an answer of ListParameters that a list can have, sorted; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    names = {reader.text() for _ in range(reader.count(5, _READ_NAMES))}
    return sorted(each for each in names if each and sanitize_text(each, _LONGEST_NAME) == each)[:MOST_PARAMETERS]


def names_request(names: Iterable[str]) -> bytes:
    """Return a request of DescribeParameters or GetParameters."""
    listed = [*names]
    writer = FieldWriter().number("I", len(listed))
    for each in listed:
        writer.text(each)
    return writer.message


def read_values(answer: bytes) -> list[ParameterValue]:
    """Return the values in an answer of GetParameters, which may be larger than those of a link.

    Raises:
        MalformedAnswerError: it is something else.
    """
    reader = FieldReader(answer)
    return [take_value(reader) for _ in range(reader.count(40, MOST_PARAMETERS))]


def take_value(reader: FieldReader) -> ParameterValue:
    """Take a rcl_interfaces/msg/ParameterValue; raise `MalformedAnswerError`."""
    given = _type(reader)
    fields: dict[ParameterType, Any] = {}
    for kind in PARAMETER_TYPES[1:]:
        element = kind.removesuffix("_array")
        if kind == "string":
            fields[kind] = reader.text(longest=None)
        elif kind == "byte_array":
            fields[kind] = reader.octets()
        elif kind == "string_array":
            fields[kind] = [reader.text(longest=None) for _ in range(reader.count(4, _MOST_ELEMENTS))]
        elif element == kind:
            fields[kind] = reader.number(_CODES[element])
        else:
            fields[kind] = reader.numbers(_CODES[element], _MOST_ELEMENTS)
    return ParameterValue.of(given, fields[given]) if given in fields else ParameterValue()


def _type(reader: FieldReader) -> ParameterType:
    number = int(reader.number("B"))
    if number >= len(PARAMETER_TYPES):
        raise MalformedAnswerError(f"it has a parameter of type {number}")
    return PARAMETER_TYPES[number]


def read_descriptors(answer: bytes) -> list[ReadDescriptor]:
    """Return the descriptors in an answer of DescribeParameters; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    return [_read_descriptor(reader) for _ in range(reader.count(16, MOST_PARAMETERS))]


def _read_descriptor(reader: FieldReader) -> ReadDescriptor:
    name = reader.text()
    kind = _type(reader)
    description, constraints = sanitize_text(reader.text()), sanitize_text(reader.text())
    read_only, dynamic = bool(reader.number("B")), bool(reader.number("B"))
    floating = [[reader.number("d") for _ in range(3)] for _ in range(reader.count(24, 1))]
    integer = [[reader.number(code) for code in "qqQ"] for _ in range(reader.count(24, 1))]
    ranges = [_range(*each) for each in floating]
    ranges += [ParameterRange(low, high, min(2**63 - 1, step)) for low, high, step in integer]
    return ReadDescriptor(
        name, kind, read_only, dynamic, description, constraints, tuple(each for each in ranges if each)[:1]
    )


def _range(low: float, high: float, step: float) -> ParameterRange | None:
    """Return a range of doubles with figures that cross a link, or None if one of them is no number."""
    if any(map(math.isnan, (low, high, step))):
        return None
    low, high = (max(-sys.float_info.max, min(sys.float_info.max, each)) for each in (low, high))
    return ParameterRange(low, high, min(1e300, max(0.0, step)))


def set_request(values: Sequence[NewValue]) -> bytes:
    """Return a request of SetParametersAtomically; raise ValueError if a value is none of its type."""
    writer = FieldWriter()
    write_parameters(writer, values)
    return writer.message


def write_parameters(writer: FieldWriter, values: Sequence[NewValue]) -> None:
    """Add a sequence of rcl_interfaces/msg/Parameter; raise as `set_request`."""
    writer.number("I", len(values))
    for each in values:
        writer.text(each.name)
        write_value(writer, each.value)


def write_value(writer: FieldWriter, value: ParameterValue) -> None:
    """Add a rcl_interfaces/msg/ParameterValue; raise ValueError if it is none of its type."""
    plain = value.plain()
    given = value.type if value.content else "not_set"
    writer.number("B", PARAMETER_TYPES.index(given))
    for kind in PARAMETER_TYPES[1:]:
        element, is_given = kind.removesuffix("_array"), kind == given
        if kind == "string":
            writer.text(plain if is_given else "")
        elif element == kind:
            writer.number(_CODES[element], plain if is_given else 0)
        else:
            elements = plain if is_given else ()
            writer.number("I", len(elements))
            for each in elements:
                writer.text(each) if element == "string" else writer.number(_CODES.get(element, "B"), each)


def read_set(answer: bytes) -> tuple[bool, str]:
    """Return whether an answer of SetParametersAtomically says that all are set, and the node's reason if not.

    Raises:
        MalformedAnswerError: it is something else.
    """
    reader = FieldReader(answer)
    return bool(reader.number("B")), sanitize_text(reader.text())
