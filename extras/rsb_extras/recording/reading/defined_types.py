"""Types that a recording defines by message files (``ros2msg``), as descriptions."""

from __future__ import annotations

import re

from rsb_bridge.cdr.description import (
    KINDS,
    NESTED,
    PRIMITIVE_NAMES,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
)

_LONGEST = 256 << 10  # characters of a definition; the longest of the common interfaces has 60,000
_SEPARATOR = re.compile(r"^={80,}[ \t]*$", re.MULTILINE)
_FIELD = re.compile(
    r"(?P<type>[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=(?P<characters>\d{1,9}))?"
    r"(?P<array>\[(?:<=)?\d{0,9}\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)
_IDS = {name: number for number, name in reversed(PRIMITIVE_NAMES.items()) if name != "wchar"}
_BOUNDED_TEXT = {"string": 21, "wstring": 22}
_ARRAY, _BOUNDED, _SEQUENCE = KINDS, 2 * KINDS, 3 * KINDS
_MOST = (1 << 32) - 1


class DefinitionError(ValueError):
    """A text defines no type."""


def defined_type(type_name: str, text: str) -> TypeDescription:
    """Read a message file, with those of all types that it refers to behind it.

    Args:
        type_name: ``pkg/msg/Name``, or without ``msg``.

    Raises:
        DefinitionError: it is none.
    """
    if len(text) > _LONGEST:
        raise DefinitionError
    first, *others = _SEPARATOR.split(text)
    types = [_message(_short(type_name), first)]
    for each in others:
        head, _, fields = each.strip().partition("\n")
        if not head.startswith("MSG: "):
            raise DefinitionError
        types.append(_message(_short(head.removeprefix("MSG: ").strip()), fields))
    return TypeDescription(types[0], tuple(types[1:]))


def _short(type_name: str) -> str:
    """Return ``pkg/Name``: names of messages in services and actions differ without their kind, too."""
    package, _, name = type_name.partition("/")
    return f"{package}/{name.rpartition('/')[2]}"


def _message(type_name: str, text: str) -> MessageType:
    package = type_name.partition("/")[0]
    fields = []
    for line in text.splitlines():
        declared = line.partition("#")[0].strip()
        if not declared:
            continue
        found = _FIELD.fullmatch(declared)
        if found is None:
            raise DefinitionError
        if not found["rest"].startswith("="):  # else it is a constant
            fields.append(MessageField(found["name"], _type(package, found)))
    return MessageType(type_name, tuple(fields))


def _type(package: str, found: re.Match[str]) -> FieldType:
    name, array = found["type"], found["array"] or ""
    characters = int(found["characters"] or 0)
    if characters:
        if (kind := _BOUNDED_TEXT.get(name)) is None:
            raise DefinitionError
    else:
        kind = _IDS.get(name, NESTED)
    nested = ""
    if kind == NESTED:
        # ROS 1 has a short name for one type of another package, which converted recordings keep.
        nested = _short(name) if "/" in name else "std_msgs/Header" if name == "Header" else f"{package}/{name}"
    digits = array.strip("[<=]")
    if array and not digits:
        return FieldType(kind + _SEQUENCE, 0, characters, nested)
    return FieldType(
        kind + (0 if not array else _BOUNDED if "<" in array else _ARRAY), int(digits or 0), characters, nested
    )


_CHAR, _UINT8 = 13, 3
_NO_FIELD = MessageField("structure_needs_at_least_one_member", FieldType(_UINT8, 0, 0, ""))
"""The field that rosidl gives a type without fields."""


def rosidl_description(described: TypeDescription) -> TypeDescription:
    """Return what `defined_type` has read as rosidl describes it, so that its text has the hash that nodes tell.

    Raises:
        DefinitionError: a type that it refers to is missing.
    """
    known = {each.type_name for each in described.referenced_type_descriptions}
    messages = described.type_description, *described.referenced_type_descriptions
    if not {field.type.nested_type_name for each in messages for field in each.fields} <= {"", *known}:
        raise DefinitionError
    others = sorted(described.referenced_type_descriptions, key=lambda each: each.type_name)
    return TypeDescription(_of_rosidl(described.type_description), tuple(_of_rosidl(each) for each in others))


def _of_rosidl(message: MessageType) -> MessageType:
    fields = (MessageField(each.name, _field_type(each.type)) for each in message.fields)
    return MessageType(_long(message.type_name), tuple(fields) or (_NO_FIELD,))


def _field_type(kind: FieldType) -> FieldType:
    container, base = divmod(kind.type_id - 1, KINDS)
    is_char = base + 1 == _CHAR  # in a message file, another word for uint8
    type_id = container * KINDS + _UINT8 if is_char else kind.type_id
    nested = _long(kind.nested_type_name) if kind.nested_type_name else ""
    return FieldType(type_id, kind.capacity, kind.string_capacity, nested)


def _long(name: str) -> str:
    package, _, short = name.partition("/")
    return f"{package}/msg/{short}"
