"""An engine's state as differences: what a bridge sends, and what a console makes of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.control.cleaning import check_length, check_routes, clean
from rsb_bridge.control.protocol import (
    ROUTES_IN_STATE,
    ControlProtocolError,
    StateChange,
    UnexpectedMessage,
    decode_route,
    encode_route,
)
from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

if TYPE_CHECKING:
    from collections.abc import Iterator

    import msgspec

    from rsb_bridge.control.protocol import BridgeInfo
    from rsb_bridge.model.session import Session


class EncodedRoutes:
    """The routes of the newest snapshot, each encoded once, for however many consoles."""

    def __init__(self) -> None:
        self._encoded: dict[str, tuple[RouteSnapshot, msgspec.Raw]] = {}

    def of(self, route: RouteSnapshot) -> msgspec.Raw:
        """Return a route, encoded."""
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


class Sender:
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
        )
        self.sent, self._keys, self._session = snapshot, keys, session
        self._routes = {route.key: route for route in snapshot.routes}


class StateReceiver:
    """The state of a bridge as a console has received it.

    Args:
        trusted: whether the bridge is on this machine. Messages of other bridges are limited and cleaned.

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
            check_length(len(self._routes))
        if state.more:
            return False
        if state.keys is not None:
            self._keys = state.keys
            self._routes = {key: self._routes[key] for key in state.keys if key in self._routes}
        if state.session is not None:
            self.session = state.session
        try:
            routes = tuple([self._routes[key] for key in self._keys])
        except KeyError as error:
            raise ControlProtocolError(UnexpectedMessage.STATE_WITHOUT_ROUTE(key=error)) from None
        if self.session is None:
            raise ControlProtocolError(UnexpectedMessage.STATE_WITHOUT_SESSION())
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
        )
        return True


def _keys(snapshot: Snapshot) -> tuple[str, ...]:
    return tuple([route.key for route in snapshot.routes])
