"""The ids of a link's routes: each opening of a route has its own, and none is used twice."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route

_CLOSED_REMEMBERED = 4
"""Ids of a route's closed incarnations: what the peer says of one may be under way while the next ones come and go."""


class RouteIds:
    """Which route is open under which id on the present connection, and which was.

    A client gives odd ids, a server even ones.
    """

    def __init__(self, *, is_client: bool) -> None:
        self._is_client = is_client
        self._by_id: dict[int, Route] = {}
        self._closed: dict[int, Route] = {}  # by the ids of its last incarnations on this connection
        # Ids count on across connections, so that late messages from a closed connection match no route.
        self._next = 1 if is_client else 2
        self._newest_of_peer = 0

    def disconnected(self) -> None:
        """The connection is over, and nothing can be late any more."""
        for route in self._closed.values():
            route.closed_ids.clear()
        self._by_id.clear()
        self._closed.clear()
        self._newest_of_peer = 0

    def new(self) -> int:
        """An id for a route that this side opens."""
        self._next += 2
        return self._next - 2

    def take_of_peer(self, route_id: int) -> bool:
        """Take note of an id that the peer gives; whether it may: it is one of the peer's, and newer than the last."""
        if route_id % 2 == self._is_client or route_id <= self._newest_of_peer:
            return False
        self._newest_of_peer = route_id
        return True

    def opened(self, route: Route, route_id: int) -> None:
        """A route is open under an id."""
        self._by_id[route_id] = route

    def closed(self, route_id: int) -> None:
        """An incarnation of a route is over."""
        route = self._by_id.pop(route_id, None)
        if route is not None:
            self._closed[route_id] = route
            route.closed_ids.append(route_id)
            if len(route.closed_ids) > _CLOSED_REMEMBERED:
                del self._closed[route.closed_ids.popleft()]

    def forget(self, route: Route) -> None:
        """A route is removed."""
        for route_id in route.closed_ids:
            del self._closed[route_id]

    def open_route(self, route_id: int) -> Route | None:
        """The open route of that id."""
        return self._by_id.get(route_id)

    def open_routes(self) -> tuple[Route, ...]:
        """All of them."""
        return tuple(self._by_id.values())

    def find(self, route_id: int) -> Route | None:
        """The route that is open under that id, or was lately."""
        return self._by_id.get(route_id) or self._closed.get(route_id)

    def last_of(self, route: Route) -> int:
        """The id of a route's present or last incarnation; 0: the peer has not heard of it on this connection."""
        return route.id or next(reversed(route.closed_ids), 0)

    def is_closed(self, route_id: int) -> bool:
        """Whether a route was open under that id and is no longer: what still arrives for it is late, not wrong."""
        ours = route_id % 2 == self._is_client
        newest = self._next - 2 if ours else self._newest_of_peer
        return 0 < route_id <= newest and route_id not in self._by_id
