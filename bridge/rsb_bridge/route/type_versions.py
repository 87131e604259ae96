"""Versions of message types, and the texts for types that differ between the two sides."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.cdr.type_difference import in_half
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


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
    HASHES = "{there} there, {here} here"


CompareTypes: TypeAlias = "Callable[[int, Sequence[TypeVersion], Callable[[str], None]], None]"
"""Tells how the other side's versions of types differ from the installed ones, now or in some seconds: takes the id of
the route, the types there, and a function to be called with the differences, or with an empty string."""


def unknown_difference(_route_id: int, _types: Sequence[TypeVersion], tell: Callable[[str], None]) -> None:
    """Tell at once that nobody can be asked."""
    tell("")


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
        in_half(theirs.name, TypeClash.HASHES(there=theirs.type_hash, here=ours.type_hash))
        for theirs, ours in pairs
        if theirs != ours
    )
