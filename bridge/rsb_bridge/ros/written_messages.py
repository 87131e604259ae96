"""Messages of installed types, serialized from fields that an operator wrote.

A type's Python class has its fields and their defaults, which descriptions of types lack.
"""

from __future__ import annotations

import difflib
import re
import struct
from typing import TYPE_CHECKING, Any

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.text import escape_text, plural
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.native.librcl import serialize_message
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_bridge.ros.raw_types import remedy
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from rsb_bridge.model.calls import Fields

_INTEGERS = {
    f"{sign}int{bits}": (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"octet": (0, 255), "char": (0, 255)}
_FLOATS = {"float": "<f", "double": "<d"}
_BOOLS = {"true": True, "false": False}
_ROS_NAMES = {"float": "float32", "double": "float64", "octet": "byte", "boolean": "bool"}
_NOUNS = {"boolean": "true or false", "float": "a number", "double": "a number"}

# As YAML 1.2 writes them (core schema, section 10.3.2), and `nan` and `inf` as ROS prints them, without the point.
# 40 digits are more than any type holds; Python raises another error beyond 4,300.
_INTEGER = re.compile(r"[-+]?[0-9]{1,40}|0x[0-9a-fA-F]{1,40}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NO_NUMBER = re.compile(r"([-+]?)\.?(inf|nan)", re.IGNORECASE)

_TIME, _NOW = "builtin_interfaces/msg/Time", "now"
_HEADER, _AUTO = "std_msgs/msg/Header", "auto"
_UUID, _UUID_DIGITS = "unique_identifier_msgs/msg/UUID", re.compile(r"[0-9a-fA-F]{32}")
_SHOWN = 60


class Misfit(Wording):
    """The reasons why a value that an operator wrote does not fit into its field."""

    ANOTHER_KIND = "{location}: {value} is not {expected}"
    NO_VALUE = "{location} has no value: give one, or leave the field out for its default"
    WRONG_LENGTH = "{location} has {length} {unit}: it takes {expected}"
    TOO_LONG = "{location} has {length} {unit}: it takes {limit} at most"
    NUL_CHARACTER = "{location} has a character of code 0, which no text in ROS holds: leave it out"
    HALF_A_SURROGATE_PAIR = "{location} has half of a surrogate pair: leave it out"
    TOO_LARGE = "{location}: {value} is too large for a {type_name}"
    OUT_OF_RANGE = "{location}: {value} is not in {low} to {high} ({type_name})"
    FIELD_MISTYPED = "{place} no field {name}: did you mean {close}?"
    FIELD_UNKNOWN = "{place} no field {name}: it has {known}"


def serialize(type_name: str, fields: Fields, now: int) -> bytes:
    """Serialize a message.

    Args:
        type_name: ``pkg/msg/Name``; of a service's request, ``pkg/srv/Name_Request``.
        fields: values by name; a missing field has its default. As for ``ros2 topic pub``, a time may be
            ``now``, and a header ``auto``; a goal's id may be its 32 hexadecimal digits.
        now: ns since the epoch.

    Returns:
        CDR with its encapsulation header.

    Raises:
        RosError: the type is not installed.
        FieldError: a value does not fit into its field.
    """
    try:
        message_class: Any = installed_class(type_name)
    except ValueError as error:
        raise RosError(str(error)) from None
    if message_class is None:
        what = type_name.removesuffix("_Request")
        raise RosError(f"{what} is not installed here, and a message by hand needs it: {remedy(what)}")
    message = message_class()
    _Filling(now).fill(message, fields, "")
    return serialize_message(message)


class _Filling:
    """Fills messages with the values that the operator wrote.

    Args:
        now: ns since the epoch.
    """

    def __init__(self, now: int) -> None:
        self._now: Fields = dict(zip(("sec", "nanosec"), map(str, divmod(now, 10**9)), strict=True))

    def fill(self, message: Any, fields: Fields, location: str) -> None:
        """Set fields of a message; errors name its `location`."""
        slots = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
        if not isinstance(fields, dict):
            raise _misfit(location, fields, f"a mapping of {', '.join(slots) or 'no fields'}")
        for name, value in fields.items():
            if name not in slots:
                raise FieldError(_unknown(name, list(slots), location))
            there = f"{location}.{name}" if location else name
            setattr(message, name, self._value(value, slots[name], there))

    def _value(self, value: Fields, slot: Any, location: str) -> Any:
        if value is None:
            raise FieldError(Misfit.NO_VALUE(location=location))
        if isinstance(slot, AbstractNestedType):
            return self._list(value, slot, location)
        if isinstance(slot, NamespacedType):
            return self._message(value, "/".join(slot.namespaced_name()), location)
        if isinstance(slot, AbstractGenericString):
            return _text(value, slot, location)
        assert isinstance(slot, BasicType)
        return _scalar(value, slot.typename, location)

    def _list(self, value: Fields, slot: Any, location: str) -> list[Any]:
        if not isinstance(value, list):
            raise _misfit(location, value, "a list")
        length = len(value)
        if isinstance(slot, Array) and length != slot.size:
            raise FieldError(
                Misfit.WRONG_LENGTH(
                    location=location, length=length, unit=plural(length, "element"), expected=slot.size
                )
            )
        if isinstance(slot, BoundedSequence) and length > slot.maximum_size:
            raise FieldError(
                Misfit.TOO_LONG(location=location, length=length, unit="elements", limit=slot.maximum_size)
            )
        return [self._value(each, slot.value_type, f"{location}[{number}]") for number, each in enumerate(value)]

    def _message(self, value: Fields, type_name: str, location: str) -> Any:
        if type_name == _TIME and value == _NOW:
            value = self._now
        elif type_name == _HEADER and value == _AUTO:
            value = {"stamp": _NOW}
        elif type_name == _UUID and isinstance(value, str) and _UUID_DIGITS.fullmatch(digits := value.replace("-", "")):
            value = {"uuid": [str(byte) for byte in bytes.fromhex(digits)]}
        message_class: Any = installed_class(type_name)
        message = message_class()
        self.fill(message, value, location)
        return message


def _text(value: Fields, slot: Any, location: str) -> str:
    if not isinstance(value, str):
        raise _misfit(location, value, "text")
    if "\0" in value:
        raise FieldError(Misfit.NUL_CHARACTER(location=location))
    try:
        encoded = value.encode()
    except UnicodeEncodeError:
        raise FieldError(Misfit.HALF_A_SURROGATE_PAIR(location=location)) from None
    length = len(value) if isinstance(slot, AbstractWString) else len(encoded)
    if slot.has_maximum_size() and length > slot.maximum_size:
        noun = "characters" if length == len(value) else "bytes"
        raise FieldError(Misfit.TOO_LONG(location=location, length=length, unit=noun, limit=slot.maximum_size))
    return value


def _scalar(value: Fields, kind: str, location: str) -> bool | int | float | bytes:
    name = _ROS_NAMES.get(kind, kind)
    if isinstance(value, str):
        if kind == "boolean" and value.lower() in _BOOLS:
            return _BOOLS[value.lower()]
        if kind in _INTEGERS and _INTEGER.fullmatch(value):
            return _integer(int(value, 16 if value.startswith("0x") else 10), kind, location)
        if kind in _FLOATS and (number := _number(value)) is not None:
            try:
                struct.pack(_FLOATS[kind], number)
            except OverflowError:
                raise FieldError(Misfit.TOO_LARGE(location=location, value=value, type_name=name)) from None
            return number
    raise _misfit(location, value, f"{_NOUNS.get(kind, 'a whole number')} ({name})")


def _integer(number: int, kind: str, location: str) -> int | bytes:
    low, high = _INTEGERS[kind]
    if not low <= number <= high:
        raise FieldError(
            Misfit.OUT_OF_RANGE(
                location=location, value=number, low=low, high=high, type_name=_ROS_NAMES.get(kind, kind)
            )
        )
    return bytes((number,)) if kind == "octet" else number  # rclpy has a byte as bytes


def _number(text: str) -> float | None:
    """Return the number that a text denotes, which may be an integer, or None if it denotes none."""
    if match := _NO_NUMBER.fullmatch(text):
        return float("".join(match.groups()))
    if _INTEGER.fullmatch(text):
        return float(int(text, 16 if text.startswith("0x") else 10))
    return float(text) if _FLOAT.fullmatch(text) else None


def _misfit(location: str, value: Fields, takes: str) -> FieldError:
    match value:
        case dict():
            shown = "a mapping"
        case list():
            shown = "a list"
        case None:
            shown = "nothing"
        case str():
            shown = f"'{escape_text(value[:_SHOWN])}{'…' * (len(value) > _SHOWN)}'"
    return FieldError(Misfit.ANOTHER_KIND(location=location or "the request", value=shown, expected=takes))


def _unknown(name: str, known: list[str], location: str) -> str:
    shown = f"'{escape_text(name[:_SHOWN])}'"
    where = f"{location} has" if location else "there is"
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return Misfit.FIELD_MISTYPED(place=where, name=shown, close=close[0])
    return Misfit.FIELD_UNKNOWN(place=where, name=shown, known=", ".join(known) or "no fields")
