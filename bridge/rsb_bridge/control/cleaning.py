"""Cleans messages of engines on other machines, because their texts reach terminals and their figures are drawn.

An engine on this machine is the user's own process and is trusted. An engine over a network may have been taken over,
and the operator's key is no reason to trust it.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import msgspec

from rsb_bridge.control.protocol import (
    CommandFailed,
    ControlProtocolError,
    Events,
    Goodbye,
    HelloRefused,
    Reply,
    UnexpectedMessage,
)
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.limits import TIME
from rsb_bridge.model.text import UNPRINTABLE, sanitize_text
from rsb_bridge.telemetry.event_log import KEPT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.control.protocol import ToConsole

M = TypeVar("M")

MOST_ITEMS: Final = 20_000
"""Of anything that a message lists, and routes of an engine. A round figure: the engine of `bench.fleet --robots 200`
has 800 routes."""
ROUTE_BYTES: Final = 32 << 10
"""Of one route in a message: the longest list of nodes, goals and figures takes a few kilobytes."""
TEXT: Final = 4096
"""Characters of a text."""
_EVENTS, _EVENTS_A_SECOND = 3 * KEPT, 50.0
"""At each start an engine sends all events that it has kept; after that, its own limit is lower than this."""
_MOST_COUNTED = 10**18
_not_in_lines = re.compile(f"(?![\\n\\t])[{UNPRINTABLE}\\ud800-\\udfff]")

_names: dict[type, tuple[str, ...]] = {}


def clean(message: M) -> M:
    """Return a decoded message, or a part of one, that is safe for terminals and drawings.

    Unprintable characters are replaced, texts are cut, figures are finite, and no count is below 0. Only the results of
    commands and the reasons of failures may have several lines.

    Raises:
        ProtocolError: it lists more than any engine does.
    """
    cleaned = _clean(message)
    match message:
        case Reply(value=str(text)):
            # As it came, since `_clean` has made one line of it, and not cut: the description of a type is long.
            cleaned = _replace(cleaned, {"value": _lines(text)})
        case CommandFailed(reason=reason) | Goodbye(reason=reason) | HelloRefused(reason=reason):
            cleaned = _replace(cleaned, {"reason": _lines(reason[:TEXT])})
    return cast("M", cleaned)


class UntrustedMessages:
    """Cleans the messages of one engine over all its connections, and limits the rate of its events.

    Args:
        now: s on a monotonic clock.
    """

    def __init__(self, now: float) -> None:
        self._events = TokenBucket(_EVENTS, _EVENTS_A_SECOND, now)

    def __call__(self, message: ToConsole, now: float) -> ToConsole:
        """Return a cleaned message; the routes of a state are not decoded yet.

        Raises:
            ProtocolError: it is more than any engine sends.
        """
        if isinstance(message, Events) and not self._events.take(len(message.events), now):
            raise ControlProtocolError(UnexpectedMessage.TOO_MANY_EVENTS())
        return clean(message)


def check_routes(messages: Sequence[msgspec.Raw]) -> None:
    """Check the sizes of routes before they are decoded.

    Raises:
        ProtocolError: one is larger than any engine's.
    """
    for each in messages:
        if (size := len(memoryview(each))) > ROUTE_BYTES:
            raise ControlProtocolError(f"a route of {size:,} bytes; at most {ROUTE_BYTES:,} are allowed")


def check_length(length: int) -> None:
    """Check how much is listed.

    Raises:
        ProtocolError: more than any engine does.
    """
    if length > MOST_ITEMS:
        raise ControlProtocolError(f"a list of {length:,}; at most {MOST_ITEMS:,} are allowed")


def _clean(value: Any) -> Any:
    kind = type(value)
    if kind is str:
        is_plain = len(value) <= TEXT and value.isascii() and value.isprintable()
        return value if is_plain else sanitize_text(value, TEXT)
    if kind is float:
        return value if value in TIME else _figure(value)  # any figure may be drawn as a date
    if kind is int:
        return min(max(value, 0), _MOST_COUNTED)
    if kind is tuple or kind is list:
        check_length(len(value))
        return kind(map(_clean, value))
    if kind is dict:
        check_length(len(value))
        return {_clean(key): _clean(each) for key, each in value.items()}
    names = _names.get(kind)
    if names is None:
        names = _names[kind] = _fields(kind)
    before = {name: getattr(value, name) for name in names}
    after = {name: _clean(each) for name, each in before.items()}
    # Also of a value without fields, such as an enum's, of which no copy could be made.
    if after == before:
        return value
    return _replace(value, after)


def _replace(value: Any, changes: dict[str, Any]) -> Any:
    kind = msgspec.structs.replace if isinstance(value, msgspec.Struct) else dataclasses.replace
    return kind(value, **changes)


def _fields(kind: type) -> tuple[str, ...]:
    """Return the fields of an object, or none for a value such as a member of an enum."""
    if issubclass(kind, msgspec.Struct):
        return kind.__struct_fields__
    return tuple(field.name for field in dataclasses.fields(kind)) if dataclasses.is_dataclass(kind) else ()


def _lines(text: str) -> str:
    return _not_in_lines.sub("\N{REPLACEMENT CHARACTER}", text)


def _figure(figure: float) -> float:
    return min(max(figure, TIME.low), TIME.high) if math.isfinite(figure) else 0.0
