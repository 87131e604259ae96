"""The differences between two versions of a message type, field by field, as operators read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import KINDS, NESTED, DescriptionError, hash_of_text, read_description
from rsb_bridge.model.text import join_first, sanitize_text
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.description import FieldType, MessageType, TypeDescription

_NAMES = {
    2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64", 9: "uint64", 10: "float32",
    11: "float64", 12: "long double", 13: "char", 14: "wchar", 15: "bool", 16: "byte", 17: "string", 18: "wstring",
    19: "string", 20: "wstring", 21: "string", 22: "wstring",
}  # fmt: skip
_NAMED = 3
"""Differences that a text names; it counts the others."""
_LONGEST = 60
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
        return difference(*(read_description(text, hash_of_text(text)) for text in (here, there)))
    except DescriptionError:
        return ""


def difference(here: TypeDescription, there: TypeDescription) -> str:
    """Return the first differences between a type here and on the other side."""
    # Types of one name in two packages may differ alike, and are named without their package.
    found = list(dict.fromkeys(_differences(here, there))) or [TypeDifference.NO_FIELD()]
    return in_half(here.type_description.type_name, join_first(found, _NAMED))


def in_half(type_name: str, difference: str) -> str:
    """Return a difference with the half of a service that has it, if the type is a request or a response."""
    for half, text in _HALVES.items():
        if type_name.endswith(half):
            return text(difference=difference)
    return difference


def _differences(here: TypeDescription, there: TypeDescription) -> Iterator[str]:
    yield from _of_message(here.type_description, there.type_description, "")
    others = {each.type_name: each for each in there.referenced_type_descriptions}
    for each in here.referenced_type_descriptions:
        if (other := others.get(each.type_name)) is not None:
            yield from _of_message(each, other, f"{each.type_name.rpartition('/')[2]}.")


def _of_message(here: MessageType, there: MessageType, prefix: str) -> Iterator[str]:
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


def type_text(kind: FieldType) -> str:
    """Return a field's type as message files write it: ``float32[]``, ``string<=10``."""
    container, base = divmod(kind.type_id - 1, KINDS)
    base += 1
    if (base not in _NAMES and base != NESTED) or container not in range(4):
        return "unknown"
    name = _shown(kind.nested_type_name) if base == NESTED else _NAMES[base]
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
    return sanitize_text(name, _LONGEST)
