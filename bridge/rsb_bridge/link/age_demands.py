"""What this side's session says of the age of messages, for routes that the other side proposes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route


class AgeDemands:
    """One link's `max_age` by name and direction.

    Args:
        routes: gives the link's.
    """

    def __init__(self, routes: Callable[[], tuple[Route, ...]]) -> None:
        self._routes = routes
        self._demands: dict[tuple[bool, str], float] = {}

    def demand(self, route: Route, topic: Topic) -> None:
        """Take what this side's entry for a route says: it counts whoever proposes the route later."""
        key = _local(route)
        if self._demands.get(key) == topic.max_age:
            return
        if topic.max_age is None:
            del self._demands[key]
        else:
            self._demands[key] = topic.max_age
        for other in self._routes():
            if other.id and not other.proposed_here and _local(other) == key:
                other.request_reopen(EventCode.ROUTE_AMENDED, "max_age was changed in this side's session")

    def forget(self, route: Route) -> None:
        """Forget what an entry said that an operator of this side has removed."""
        self._demands.pop(_local(route), None)

    def of(self, route: Route) -> float | None:
        """Return s that this side's session sets for a route, 0 for no limit, or None if it sets nothing."""
        return self._demands.get(_local(route))


def _local(route: Route) -> tuple[bool, str]:
    """What this side's operators call a route, whatever the other side's do."""
    return route.outgoing, route.local_topic
