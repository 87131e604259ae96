"""Descriptions of message types (REP 2016), as the text whose SHA-256 is the type's hash.

So a description shows by itself that it is the right one, wherever it came from.
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording

HASH_PREFIX = "RIHS01_"
DESCRIPTION_LIMIT = 64 << 10
"""Bytes of a description; the longest of the common interfaces has 10 kB."""
KINDS = 48
"""Type ids of each container (type_description_interfaces/msg/FieldType); the following are of the first one."""
NESTED = 1
STRINGS, WIDE_STRINGS, BOUNDED_STRINGS = {17, 19, 21}, {18, 20, 22}, {19, 20, 21, 22}
WIDE_CHARACTER = 4
"""Bytes: rosidl_typesupport_fastrtps_cpp/serialization_helpers.hpp."""
_NAME_LENGTH = 255


class InvalidDescription(Wording):
    """The reason why a text does not describe a type."""

    TOO_LONG = "the description has {length:,} characters; at most {limit:,} are read"
    ANOTHER_TYPE = "the description's hash differs from the type's"
    INVALID = "the description is invalid: {error}"


class DescriptionError(ValueError):
    """A text does not describe its type; the message says why."""


_Name: TypeAlias = Annotated[str, Meta(max_length=_NAME_LENGTH)]
_Capacity: TypeAlias = Annotated[int, Meta(ge=0, le=2**32 - 1)]


class FieldType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The type of a field, as type_description_interfaces/msg/FieldType.

    Attributes:
        type_id: what it is, and whether it is an array or a sequence of that.
        capacity: elements of an array, or of a bounded sequence at most.
        string_capacity: characters of a bounded string at most.
        nested_type_name: ``pkg/msg/Name`` where it is a message.
    """

    type_id: Annotated[int, Meta(ge=0, le=255)]
    capacity: _Capacity
    string_capacity: _Capacity
    nested_type_name: _Name


class MessageField(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A field of a message."""

    name: _Name
    type: FieldType


class MessageType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One message type, without the types of its fields."""

    type_name: _Name
    fields: tuple[MessageField, ...]


class TypeDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A message type, and all that it refers to."""

    type_description: MessageType
    referenced_type_descriptions: tuple[MessageType, ...]


_decoder = msgspec.json.Decoder(TypeDescription)


def text_of(description: TypeDescription) -> str:
    """Return the text of a description, as rosidl writes it for the hash."""
    return json.dumps(msgspec.to_builtins(description), separators=(", ", ": "))


def hash_of_text(text: str) -> str:
    """Return the hash of the type that a text describes: ``RIHS01_`` and 64 hex digits."""
    return HASH_PREFIX + hashlib.sha256(text.encode()).hexdigest()


def read_description(text: str, type_hash: str) -> TypeDescription:
    """Read the text of a type's description.

    Raises:
        DescriptionError: it is none, or another type's.
    """
    if len(text) > DESCRIPTION_LIMIT:
        raise DescriptionError(InvalidDescription.TOO_LONG(length=len(text), limit=DESCRIPTION_LIMIT))
    try:
        if hash_of_text(text) != type_hash:
            raise DescriptionError(InvalidDescription.ANOTHER_TYPE())
        return _decoder.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
        raise DescriptionError(sanitize_text(InvalidDescription.INVALID(error=error))) from None
