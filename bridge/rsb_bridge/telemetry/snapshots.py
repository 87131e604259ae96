"""Keeps the snapshot that user interfaces see up to date, without making messages wait."""

from __future__ import annotations

import asyncio
import dataclasses
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.link.roles import BridgeRole
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_bridge.route.route import Route
    from rsb_bridge.telemetry.event_log import EventLog

_SLICE = 20
"""Routes handled in one go: about 0.3 ms, which no message notices."""
_AT_ONCE = 128
"""Routes renewed in one refresh; of more, the others have their turn in the next."""
_LOOKED_AT_FOR = 2.0

T = TypeVar("T")


class SnapshotPublisher:
    """Renews the snapshot, as long as anybody looks at it.

    Attributes:
        latest: the newest snapshot; replaced, never changed, so that any thread may read it.
    """

    def __init__(self, blank: Snapshot, events: EventLog, clock: Clock) -> None:
        self.latest = blank
        self._events = events
        self._clock = clock
        self._routes: dict[Route, RouteSnapshot] = {}
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

    async def refresh(self, end: BridgeRole) -> None:
        """Renew the links, and the routes or as many of them as have their turn."""
        routes = _routes_of(end)
        self._routes = {route: self._routes[route] for route in routes if route in self._routes}
        turn = [routes[(self._turn + i) % len(routes)] for i in range(min(_AT_ONCE, len(routes)))]
        self._turn += len(turn)
        await in_slices(turn, self._renew)
        self._publish(end, running=True)

    def refresh_now(self, end: BridgeRole, *, running: bool = True) -> None:
        """Renew all in one go: after a command, whose outcome is waited for."""
        self._routes = {route: route.snapshot() for route in _routes_of(end)}
        self._publish(end, running=running)

    def _renew(self, route: Route) -> None:
        self._routes[route] = route.snapshot()

    def _publish(self, end: BridgeRole, *, running: bool) -> None:
        for route in _routes_of(end):
            if route not in self._routes:
                self._renew(route)
        self.latest = dataclasses.replace(
            self.latest,
            time=self._clock.time_ns() / 1e9,
            running=running,
            links=tuple(link.snapshot() for link in end.links()),
            routes=tuple(self._routes[route] for route in _routes_of(end)),
            last_event=self._events.last,
        )


async def in_slices(items: Iterable[T], work: Callable[[T], None]) -> None:
    """Do something with each, letting the I/O loop do its own in between."""
    for index, item in enumerate(items, 1):
        work(item)
        if index % _SLICE == 0:
            await asyncio.sleep(0)


def _routes_of(end: BridgeRole) -> list[Route]:
    return [route for link in end.links() for route in link.routes.values()]
