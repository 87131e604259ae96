"""Definitions of message types as message files (``ros2msg``), from their descriptions."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import (
    KINDS,
    NESTED,
    DescriptionError,
    hash_of_text,
    read_description,
    type_text,
)
from rsb_bridge.feature_api import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.description import MessageType

_SEPARATOR = "=" * 80
_NO_FIELDS = "uint8 structure_needs_at_least_one_member"
"""The field that rosidl gives a message without fields, which has its byte. Some readers misread what nests such a
message if they are not told, and refuse a section without any line, as of a message of constants alone."""
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*){1,2}")
_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_UNWRITABLE = ("unknown", "long double", "wchar")


class UndefinableType(Wording):
    """The reason why a type has no message file."""

    INVALID_NAME = "{name!r} is not a name of a message file"
    NO_SUCH_FIELD = "{field}: a message file has no {type}"


def message_definition(description: str) -> str:
    """Return the message file of a type, followed by those of all types that it refers to.

    A description has no constants, default values and comments, so they are missing here.

    Args:
        description: as `rsb_bridge.ros.type_descriptions.TypeDescriptions.find` returns it.

    Raises:
        DescriptionError: the text describes no type, or one that no message file can describe.
    """
    read = read_description(description, hash_of_text(description))
    others = ((f"MSG: {_short(each.type_name)}", *_fields(each)) for each in read.referenced_type_descriptions)
    return f"\n{_SEPARATOR}\n".join("\n".join(each) for each in (_fields(read.type_description), *others)) + "\n"


def _fields(message: MessageType) -> Iterator[str]:
    if not message.fields:
        yield _NO_FIELDS
    for field in message.fields:
        _check(_FIELD, field.name)
        is_nested = (field.type.type_id - 1) % KINDS + 1 == NESTED
        nested = _short(field.type.nested_type_name) if is_nested else ""
        text = type_text(field.type, nested)
        if text.startswith(_UNWRITABLE) and not is_nested:
            raise DescriptionError(UndefinableType.NO_SUCH_FIELD(field=field.name, type=text))
        yield f"{text} {field.name}"


def _short(type_name: str) -> str:
    """Return ``pkg/Name`` of a message, as message files write it."""
    _check(_TYPE, type_name)
    return type_name.replace("/msg/", "/")


def _check(pattern: re.Pattern[str], name: str) -> None:
    if not pattern.fullmatch(name):
        raise DescriptionError(UndefinableType.INVALID_NAME(name=name))
