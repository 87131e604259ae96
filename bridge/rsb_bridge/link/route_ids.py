"""The ids by which control messages and frames name the routes of one link."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route

_CLOSED_REMEMBERED = 4
"""Closed ids that are remembered of each route: the peer's messages about one may come while the next ones come and go.

A round figure: with none, a removal that crosses a reopening would be lost; more cost memory only."""


class RouteIds:
    """The ids of a link's open routes on the present connection, and of routes that were closed lately.

    Each opening of a route has its own id, and none is used twice. A client gives odd ids, a server even ones.
    """

    def __init__(self, *, is_client: bool) -> None:
        self._is_client = is_client
        self._by_id: dict[int, Route] = {}
        self._closed: dict[int, Route] = {}  # by the ids of their last openings
        # Ids count on across connections, so that late messages from a closed connection match no route.
        self._next = 1 if is_client else 2
        self._newest_of_peer = 0

    def disconnected(self) -> None:
        """Forget all ids: messages of a closed connection cannot come late."""
        for route in self._closed.values():
            route.closed_ids.clear()
        self._by_id.clear()
        self._closed.clear()
        self._newest_of_peer = 0  # another process of the peer counts from the beginning

    def new(self) -> int:
        self._next += 2
        return self._next - 2

    def take_of_peer(self, route_id: int) -> bool:
        """Record an id that the peer gives; return False unless it is the peer's to give and newer than the last."""
        # The ids of both sides only count up, so that no pair of key and nonce repeats (PROTOCOL.md, 1.3).
        if route_id % 2 == self._is_client or route_id <= self._newest_of_peer:
            return False
        self._newest_of_peer = route_id
        return True

    def opened(self, route: Route, route_id: int) -> None:
        self._by_id[route_id] = route

    def closed(self, route_id: int) -> None:
        route = self._by_id.pop(route_id, None)
        if route is not None:
            self._closed[route_id] = route
            route.closed_ids.append(route_id)
            if len(route.closed_ids) > _CLOSED_REMEMBERED:
                del self._closed[route.closed_ids.popleft()]

    def forget(self, route: Route) -> None:
        """Forget the closed ids of a route that is removed."""
        for route_id in route.closed_ids:
            del self._closed[route_id]

    def open_route(self, route_id: int) -> Route | None:
        return self._by_id.get(route_id)

    def open_routes(self) -> tuple[Route, ...]:
        return tuple(self._by_id.values())

    def find(self, route_id: int) -> Route | None:
        """Return the route that is open under an id, or was lately, or None."""
        return self._by_id.get(route_id) or self._closed.get(route_id)

    def last_of(self, route: Route) -> int:
        """Return the id of a route's last opening on this connection, or 0 without one."""
        return route.id or next(reversed(route.closed_ids), 0)

    def awaits_channel(self, route_id: int) -> bool:
        """Whether a route is open under an id, and has no channel yet."""
        route = self._by_id.get(route_id)
        return route is not None and route.half.carried.channel is None

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under an id and is closed: what still arrives for it is late, not wrong."""
        ours = route_id % 2 == self._is_client
        newest = self._next - 2 if ours else self._newest_of_peer
        return 0 < route_id <= newest and route_id not in self._by_id
