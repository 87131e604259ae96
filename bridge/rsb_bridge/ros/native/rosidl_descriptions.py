"""Descriptions of installed message types.

rosidl compiles a type's description into its type support: structs of
type_description_interfaces as C (rosidl_runtime_c/type_description/*__struct.h, ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

from rsb_bridge.cdr.description import (
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    text_of,
)
from rsb_bridge.ros.native.typesupport import FIND_DESCRIPTION, installed_class, type_support_of

if TYPE_CHECKING:
    from collections.abc import Iterator


class _String(ctypes.Structure):
    """A rosidl_runtime_c__String."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))

    def __str__(self) -> str:
        return ctypes.string_at(self.data, self.size).decode() if self.size else ""


class _Sequence(ctypes.Structure):
    """A sequence of structs."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))

    def of(self, kind: type[Any]) -> Iterator[Any]:
        """Its elements."""
        for number in range(self.size):
            yield kind.from_address(self.data + number * ctypes.sizeof(kind))


class _FieldType(ctypes.Structure):
    _fields_ = (
        ("type_id", ctypes.c_uint8),
        ("capacity", ctypes.c_uint64),
        ("string_capacity", ctypes.c_uint64),
        ("nested_type_name", _String),
    )


class _Field(ctypes.Structure):
    _fields_ = (("name", _String), ("type", _FieldType), ("default_value", _String))


class _MessageType(ctypes.Structure):
    _fields_ = (("type_name", _String), ("fields", _Sequence))


class _TypeDescription(ctypes.Structure):
    _fields_ = (("type_description", _MessageType), ("referenced_type_descriptions", _Sequence))


def installed_description(type_name: str) -> str | None:
    """Return the text of an installed type's description, or None if the type is not installed.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/msg/Name``.
    """
    found = installed_class(type_name)
    if found is None:
        return None
    type_support = type_support_of(found)
    if not type_support.get_description:
        return None
    address = FIND_DESCRIPTION(type_support.get_description)(ctypes.addressof(type_support))
    if not address:
        return None
    described = _TypeDescription.from_address(address)
    types = [message_type(each, [*each.fields.of(_Field)]) for each in _all(described)]
    return text_of(TypeDescription(types[0], tuple(types[1:])))


def _all(described: _TypeDescription) -> Iterator[_MessageType]:
    yield described.type_description
    yield from described.referenced_type_descriptions.of(_MessageType)


def message_type(described: Any, fields: list[Any]) -> MessageType:
    """Return a type, from its C struct or its Python message, which have the same attributes."""
    return MessageType(
        str(described.type_name), tuple(MessageField(str(each.name), _field_type(each.type)) for each in fields)
    )


def _field_type(described: Any) -> FieldType:
    return FieldType(
        int(described.type_id),
        int(described.capacity),
        int(described.string_capacity),
        str(described.nested_type_name),
    )
