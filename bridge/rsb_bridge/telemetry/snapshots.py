"""Keeps the snapshot for user interfaces up to date, without delaying messages."""

from __future__ import annotations

import asyncio
import dataclasses
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.tasks import in_slices

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot
    from rsb_bridge.telemetry.event_log import EventLog

_AT_ONCE, _REFRESHES = 128, 4
"""Routes renewed in one refresh, at the least; the others follow in the next ones. Refreshes until each had its turn,
while somebody looks at more than so many: then no route's is older than a second."""
_LOOKED_AT_FOR = 2.0
_EVERY, _EVERY_LOOKED_AT = 1.0, 0.25
"""s from one renewal to the next."""


class ShownRoute(Protocol):
    """A route, as far as its snapshot goes."""

    def snapshot(self) -> RouteSnapshot:
        """The route as it is now."""
        ...


class ShownLink(Protocol):
    """A link, likewise."""

    @property
    def routes(self) -> Mapping[str, ShownRoute]:
        """Its routes, by key."""
        ...

    def snapshot(self) -> LinkSnapshot:
        """The link as it is now."""
        ...


class ShownBridge(Protocol):
    """A bridge's links, likewise."""

    def links(self) -> Sequence[ShownLink]:
        """All of them, up or down."""
        ...


class SnapshotPublisher:
    """Renews the snapshot, as long as anybody looks at it.

    Attributes:
        latest: the newest snapshot; replaced, never changed, so that any thread may read it.
    """

    def __init__(self, blank: Snapshot, events: EventLog, clock: Clock) -> None:
        self.latest = blank
        self._events = events
        self._clock = clock
        self._routes: dict[ShownRoute, RouteSnapshot] = {}
        self._looks = self._looks_seen = 0
        self._looked_at = float("-inf")
        self._turn = 0

    def look(self) -> Snapshot:
        """The newest snapshot; called on any thread."""
        self._looks += 1
        return self.latest

    def looked_at(self, now: float) -> bool:
        """Whether anybody has looked during the last 2 s before `now` (s), as far as is noticed when this is called."""
        if self._looks != self._looks_seen:
            self._looks_seen = self._looks
            self._looked_at = now
        return now - self._looked_at < _LOOKED_AT_FOR

    async def run(self, bridge: ShownBridge) -> None:
        """Renew the snapshot for ever: four times a second while somebody looks, else once a second."""
        now = asyncio.get_running_loop().time
        while True:
            await self.refresh(bridge)
            await asyncio.sleep(_EVERY_LOOKED_AT if self.looked_at(now()) else _EVERY)

    async def refresh(self, bridge: ShownBridge) -> None:
        """Renew the links, and a part of the routes, in turn."""
        routes = _routes_of(bridge)
        at_once = max(_AT_ONCE, -(-len(routes) // _REFRESHES))
        self._routes = {route: self._routes[route] for route in routes if route in self._routes}
        turn = [routes[(self._turn + i) % len(routes)] for i in range(min(at_once, len(routes)))]
        self._turn += len(turn)
        await in_slices(turn, self._renew)
        self._publish(bridge, running=True)

    def refresh_now(self, bridge: ShownBridge, *, running: bool = True) -> None:
        """Renew everything at once: after a command, whose outcome a user waits for."""
        self._routes = {route: route.snapshot() for route in _routes_of(bridge)}
        self._publish(bridge, running=running)

    def _renew(self, route: ShownRoute) -> None:
        self._routes[route] = route.snapshot()

    def _publish(self, bridge: ShownBridge, *, running: bool) -> None:
        for route in _routes_of(bridge):
            if route not in self._routes:
                self._renew(route)
        self.latest = dataclasses.replace(
            self.latest,
            time=self._clock.time_ns() / 1e9,
            running=running,
            links=tuple(link.snapshot() for link in bridge.links()),
            routes=tuple(self._routes[route] for route in _routes_of(bridge)),
            last_event=self._events.last,
        )


def _routes_of(bridge: ShownBridge) -> list[ShownRoute]:
    return [route for link in bridge.links() for route in link.routes.values()]
