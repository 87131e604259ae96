"""Descriptions of message types (REP 2016), versions of types, and their differences as operators read them.

The text of a description has the type's hash as its SHA-256, so it shows by itself that it is the right one.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.text import join_first, sanitize_text
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

HASH_PREFIX = "RIHS01_"
DESCRIPTION_LIMIT = 64 << 10
"""Bytes of a description; the longest of the common interfaces has 10 kB."""
KINDS = 48
"""Type ids of each container (type_description_interfaces/msg/FieldType); the following are of the first one."""
NESTED = 1
PRIMITIVE_SIZES = {2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 8, 9: 8, 10: 4, 11: 8, 13: 1, 15: 1, 16: 1}
"""Bytes of a value, by its type id."""
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


PRIMITIVE_NAMES = {
    2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64", 9: "uint64", 10: "float32",
    11: "float64", 12: "long double", 13: "char", 14: "wchar", 15: "bool", 16: "byte", 17: "string", 18: "wstring",
    19: "string", 20: "wstring", 21: "string", 22: "wstring",
}  # fmt: skip
"""As message files write them, by type id. Of a string, the first id is that without a bound."""
_DIFFERENCES_NAMED = 3
"""Differences that a text names; it counts the others."""
_SHOWN_LENGTH = 60
"""Characters of a field's name and type."""


class TypeDifference(Wording):
    """The ways in which a field can differ."""

    ONLY_HERE = "{field} ({type}) only here"
    ONLY_THERE = "{field} ({type}) only there"
    OTHER_TYPE = "{field} is {there} there, {here} here"
    ORDER = "the order of the fields of {type}"
    NO_FIELD = "the same fields under another name of a type"
    IN_REQUEST = "request: {difference}"
    IN_RESPONSE = "response: {difference}"


_HALVES = {"_Request": TypeDifference.IN_REQUEST, "_Response": TypeDifference.IN_RESPONSE}
"""By the end of the type's name. A name of a message has no underscore."""


def difference_of_texts(here: str, there: str) -> str:
    """Return the differences between the texts of two descriptions, or an empty string if one is invalid."""
    try:
        return difference_of_types(*(read_description(text, hash_of_text(text)) for text in (here, there)))
    except DescriptionError:
        return ""


def difference_of_types(here: TypeDescription, there: TypeDescription) -> str:
    """Return the first differences between a type here and on the other side."""
    # Types of one name in two packages may differ alike, and are named without their package.
    found = list(dict.fromkeys(_differences(here, there))) or [TypeDifference.NO_FIELD()]
    return _in_half(here.type_description.type_name, join_first(found, _DIFFERENCES_NAMED))


def _in_half(type_name: str, difference: str) -> str:
    """Return a difference with the half of a service that has it, if the type is a request or a response."""
    for half, text in _HALVES.items():
        if type_name.endswith(half):
            return text(difference=difference)
    return difference


def _differences(here: TypeDescription, there: TypeDescription) -> Iterator[str]:
    yield from _message_differences(here.type_description, there.type_description, "")
    others = {each.type_name: each for each in there.referenced_type_descriptions}
    for each in here.referenced_type_descriptions:
        if (other := others.get(each.type_name)) is not None:
            yield from _message_differences(each, other, f"{each.type_name.rpartition('/')[2]}.")


def _message_differences(here: MessageType, there: MessageType, prefix: str) -> Iterator[str]:
    ours, theirs = ({each.name: each.type for each in message.fields} for message in (here, there))
    for name, kind in theirs.items():
        if name not in ours:
            yield TypeDifference.ONLY_THERE(field=_shown(prefix + name), type=type_text(kind))
        elif ours[name] != kind:
            yield TypeDifference.OTHER_TYPE(
                field=_shown(prefix + name), there=type_text(kind), here=type_text(ours[name])
            )
    for name, kind in ours.items():
        if name not in theirs:
            yield TypeDifference.ONLY_HERE(field=_shown(prefix + name), type=type_text(kind))
    if list(ours) != list(theirs) and ours.keys() == theirs.keys():
        yield TypeDifference.ORDER(type=_shown(here.type_name))


def type_text(kind: FieldType, nested: str = "") -> str:
    """Return a field's type as message files write it: ``float32[]``, ``string<=10``.

    Args:
        nested: its name where it is a message, or empty for the full one, printable and short.
    """
    container, base = divmod(kind.type_id - 1, KINDS)
    base += 1
    if (base not in PRIMITIVE_NAMES and base != NESTED) or container not in range(4):
        return "unknown"
    name = (nested or _shown(kind.nested_type_name)) if base == NESTED else PRIMITIVE_NAMES[base]
    if kind.string_capacity:
        name += f"<={kind.string_capacity}"
    match container:
        case 1:
            return f"{name}[{kind.capacity}]"
        case 2:
            return f"{name}[<={kind.capacity}]"
        case 3:
            return f"{name}[]"
    return name


def _shown(name: str) -> str:
    """Return a name, which may come from a peer, printable and short."""
    return sanitize_text(name, _SHOWN_LENGTH)


class TypeVersion(NamedTuple):
    """A message type and its version.

    Attributes:
        name: ``pkg/msg/Name``, or empty if unknown.
        type_hash: ``RIHS01_...``, or empty if unknown.
    """

    name: str = ""
    type_hash: str = ""


class TypeClash(Wording):
    """The reasons why the type that the other side has can't be published or offered here."""

    NOT_AGREED = "the other side sends {there}, though {agreed} was agreed on: correct the type"
    VERSIONS = (
        "{type} differs between the two sides ({difference}): install the same version on both, and restart the bridge "
        "that had another"
    )
    KEYED = "{type} has a key (@key), of which neither its hash nor its description tells: install {package} here"
    HASHES = "{there} there, {here} here"


CompareTypes: TypeAlias = "Callable[[int, Sequence[TypeVersion], Callable[[str], None]], None]"
"""Tells how the other side's versions of types differ from the installed ones, now or in some seconds: takes the id of
the route, the types there, and a function to be called with the differences, or with an empty string."""


def messages_of(type_name: str, type_hash: str) -> tuple[TypeVersion, ...]:
    """Return the request and the response of a service's type, whose hash has both theirs, or a message's type."""
    request, is_service, response = type_hash.partition("+")
    if not is_service:
        return (TypeVersion(type_name, type_hash),)
    return TypeVersion(f"{type_name}_Request", request), TypeVersion(f"{type_name}_Response", response)


def hashes_text(type_name: str, there: str, here: str) -> str:
    """Return the hashes of two versions of a type, or of its request and response where those differ."""
    pairs = zip(messages_of(type_name, there), messages_of(type_name, here), strict=False)
    return "; ".join(
        _in_half(theirs.name, TypeClash.HASHES(there=theirs.type_hash, here=ours.type_hash))
        for theirs, ours in pairs
        if theirs != ours
    )
