"""An engine's messages to a console: its state as differences, and all of them cleaned if they come from elsewhere.

An engine of this user's or root's on this machine is trusted. One over a network, or a service that root attaches to,
may have been taken over, and the operator's key is no reason to trust it: its texts reach terminals, and its figures
are drawn.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import msgspec

from rsb_bridge.config.file_form import with_types
from rsb_bridge.control.protocol import (
    ROUTES_IN_STATE,
    CommandFailed,
    ControlProtocolError,
    Events,
    Goodbye,
    HelloRefused,
    Reply,
    StateChange,
    UnexpectedMessage,
    decode_route,
    encode_route,
)
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.limits import TIME
from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
from rsb_bridge.model.text import UNPRINTABLE, sanitize_text
from rsb_bridge.telemetry.event_log import KEPT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.control.protocol import BridgeInfo, ToConsole
    from rsb_bridge.model.session import Session

M = TypeVar("M")

MOST_ITEMS: Final = 20_000
"""Of anything that a message lists, and routes of an engine. A round figure: the engine of `bench.fleet --robots 200`
has 800 routes."""
ROUTE_BYTES: Final = 32 << 10
"""Of one route in a message: the longest list of nodes, goals and figures takes a few kilobytes."""
LONGEST_TEXT: Final = 4096
"""Characters of a text."""
_EVENTS, _EVENTS_A_SECOND = 3 * KEPT, 50.0
"""At each start an engine sends all events that it has kept; after that, its own limit is lower than this."""
_MOST_COUNTED = 10**18  # bytes of 30 years at 1 GB/s
_not_in_lines = re.compile(f"(?![\\n\\t])[{UNPRINTABLE}\\ud800-\\udfff]")

_fields_of: dict[type, tuple[str, ...]] = {}


class EncodedRoutes:
    """The routes of the newest snapshot, each encoded once, for however many consoles."""

    def __init__(self) -> None:
        self._encoded: dict[str, tuple[RouteSnapshot, msgspec.Raw]] = {}

    def of(self, route: RouteSnapshot) -> msgspec.Raw:
        known = self._encoded.get(route.key)
        # Snapshots are immutable: the same object has not changed.
        if known is not None and known[0] is route:
            return known[1]
        raw = encode_route(route)
        self._encoded[route.key] = (route, raw)
        return raw

    def keep_only(self, snapshot: Snapshot) -> None:
        """Forget the routes that are gone."""
        if len(self._encoded) > len(snapshot.routes):
            self._encoded = {key: self._encoded[key] for key in _keys(snapshot) if key in self._encoded}


class StateSender:
    """The state that one console has received, and the differences from it.

    Attributes:
        sent: the newest snapshot that was sent, or None if none was.
    """

    def __init__(self) -> None:
        self.sent: Snapshot | None = None
        self._routes: dict[str, RouteSnapshot] = {}
        self._keys: tuple[str, ...] | None = None
        self._session: Session | None = None

    def differences(
        self, snapshot: Snapshot, session: Session, *, waits_for_operator: bool, encoded: EncodedRoutes
    ) -> Iterator[StateChange]:
        """Yield the changes since `sent`, in messages that take little time to make. All of them have to be sent.

        Args:
            snapshot: newer than `sent`.
            encoded: shared by all consoles.
        """
        # An object that is the same has not changed: snapshots are immutable.
        changed = [route for route in snapshot.routes if self._routes.get(route.key) is not route]
        while len(changed) > ROUTES_IN_STATE:
            yield StateChange(routes=tuple(map(encoded.of, changed[:ROUTES_IN_STATE])), more=True)
            del changed[:ROUTES_IN_STATE]
        keys = _keys(snapshot)
        yield StateChange(
            routes=tuple(map(encoded.of, changed)),
            keys=None if keys == self._keys else keys,
            time=snapshot.time,
            domain_id=snapshot.domain_id,
            address=snapshot.address,
            running=snapshot.running,
            links=snapshot.links,
            last_event=snapshot.last_event,
            session=None if session == self._session else session,
            waits_for_operator=waits_for_operator,
            refused=snapshot.refused,
            unsaved=snapshot.unsaved,
        )
        self.sent, self._keys, self._session = snapshot, keys, session
        self._routes = {route.key: route for route in snapshot.routes}


class StateReceiver:
    """The state of a bridge as a console has received it.

    Args:
        trusted: as in `rsb_bridge.api.EngineApi`. Messages of other bridges are limited and cleaned.

    Attributes:
        snapshot: the newest, or None if none is complete yet.
        session: the newest, or None if none is complete yet.
        waits_for_operator: as in the newest state.
    """

    def __init__(self, bridge: BridgeInfo, *, trusted: bool = True) -> None:
        self._trusted = trusted
        self.snapshot: Snapshot | None = None
        self.session: Session | None = None
        self.waits_for_operator = False
        self._bridge = bridge
        self._routes: dict[str, RouteSnapshot] = {}
        self._keys: tuple[str, ...] = ()

    def receive(self, state: StateChange) -> bool:
        """Take a message; whether it completes a state.

        Raises:
            ProtocolError: it contradicts itself or the ones before, or is more than any engine tells.
        """
        if not self._trusted:
            check_routes(state.routes)
        for raw in state.routes:
            route = decode_route(raw) if self._trusted else clean(decode_route(raw))
            self._routes[route.key] = route
        if not self._trusted:
            # Over all messages: a rogue bridge may send ever new routes, and list none of them in `keys`.
            _check_length(len(self._routes))
        if state.more:
            return False
        if state.keys is not None:
            self._keys = state.keys
            self._routes = {key: self._routes[key] for key in state.keys if key in self._routes}
        if state.session is not None:
            try:
                self.session = with_types(state.session)
            except msgspec.ValidationError as error:
                raise ControlProtocolError(str(error)) from None
        try:
            routes = tuple([self._routes[key] for key in self._keys])
        except KeyError as error:
            raise ControlProtocolError(f"a state without the route {error}") from None
        if self.session is None:
            raise ControlProtocolError("a state without a session")
        if len(self._routes) != len(self._keys):
            raise ControlProtocolError(UnexpectedMessage.ROUTES_NOT_AS_LISTED())
        self.waits_for_operator = state.waits_for_operator
        self.snapshot = Snapshot(
            time=state.time,
            name=self._bridge.name,
            role=self._bridge.role,
            address=state.address,
            domain_id=state.domain_id,
            running=state.running,
            links=state.links,
            routes=routes,
            last_event=state.last_event,
            refused=state.refused,
            unsaved=state.unsaved,
        )
        return True


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
            raise ControlProtocolError("more events than any bridge reports")
        return clean(message)


def clean(message: M) -> M:
    """Return a decoded message, or a part of one, that is safe for terminals and drawings.

    Unprintable characters are replaced, texts are cut, figures are finite, and no count is below 0. Only the results of
    commands and the reasons of failures may have several lines.

    Raises:
        ProtocolError: it lists more than any engine does, or in more levels.
    """
    try:
        cleaned = _clean(message)
    except RecursionError:  # plain data of a few levels less than the decoder takes
        raise ControlProtocolError("a message of too many levels") from None
    match message:
        case Reply(value=str(text)):
            # As it came, since `_clean` has made one line of it, and not cut: the description of a type is long.
            cleaned = _replace(cleaned, {"value": _lines(text)})
        case CommandFailed(reason=reason) | Goodbye(reason=reason) | HelloRefused(reason=reason):
            cleaned = _replace(cleaned, {"reason": _lines(reason[:LONGEST_TEXT])})
    return cast("M", cleaned)


def check_routes(messages: Sequence[msgspec.Raw]) -> None:
    """Check the sizes of routes before they are decoded.

    Raises:
        ProtocolError: one is larger than any engine's.
    """
    for each in messages:
        if (size := len(memoryview(each))) > ROUTE_BYTES:
            raise ControlProtocolError(f"a route of {size:,} bytes; at most {ROUTE_BYTES:,} are allowed")


def _check_length(length: int) -> None:
    """Check how much is listed.

    Raises:
        ProtocolError: more than any engine does.
    """
    if length > MOST_ITEMS:
        raise ControlProtocolError(f"a list of {length:,}; at most {MOST_ITEMS:,} are allowed")


def _clean(value: Any) -> Any:
    kind = type(value)
    if kind is str:
        is_plain = len(value) <= LONGEST_TEXT and value.isascii() and value.isprintable()
        return value if is_plain else sanitize_text(value, LONGEST_TEXT)
    if kind is float:
        return value if value in TIME else _figure(value)  # any figure may be drawn as a date
    if kind is int:
        return min(max(value, 0), _MOST_COUNTED)
    if kind is tuple or kind is list:
        _check_length(len(value))
        return kind(map(_clean, value))
    if kind is dict:
        _check_length(len(value))
        return {_clean(key): _clean(each) for key, each in value.items()}
    names = _fields_of.get(kind)
    if names is None:
        names = _fields_of[kind] = _fields(kind)
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


def _keys(snapshot: Snapshot) -> tuple[str, ...]:
    return tuple([route.key for route in snapshot.routes])
