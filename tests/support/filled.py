"""Messages with something in every field."""

from __future__ import annotations

from typing import Any

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from rsb_bridge.ros.native.typesupport import installed_class

_SPECIAL = {"octet": b"\x07", "boolean": True, "float": 1.5, "double": 1.5}


def filled(message_class: Any) -> Any:
    """An instance with no field at its default."""
    fields = zip(message_class.get_fields_and_field_types(), message_class.SLOT_TYPES, strict=True)
    return message_class(**{field: _value(slot) for field, slot in fields})


def _value(slot: Any) -> Any:
    if isinstance(slot, AbstractNestedType):
        return [_value(slot.value_type) for _ in range(_length(slot))]
    if isinstance(slot, NamespacedType):
        return filled(installed_class("/".join(slot.namespaced_name())))
    if isinstance(slot, AbstractGenericString):
        return "größer"
    assert isinstance(slot, BasicType)
    return _SPECIAL.get(slot.typename, 7)


def _length(slot: AbstractNestedType) -> int:
    if isinstance(slot, Array):
        return int(slot.size)
    return min(3, slot.maximum_size) if isinstance(slot, BoundedSequence) else 3
