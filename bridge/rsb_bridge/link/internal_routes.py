"""The internal routes of one purpose on one link, with their ends on this side."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Generic

from rsb_bridge.ros.internal_ends import DrainT, SourceT

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.ros.internal_ends import InternalEnds
    from rsb_bridge.ros.ros_interface import Sink
    from rsb_bridge.route.route import Route

OPENED_WITHIN = 10.0
_LOOK_EVERY = 0.05
"""s. Round figures: nothing was measured."""


class InternalRoutes(Generic[SourceT, DrainT]):
    """Finds a link's internal routes of one purpose, and waits until they are open.

    Args:
        source: as of `rsb_bridge.ros.internal_ends.InternalEnds.serve`.
        drain: likewise.
    """

    def __init__(
        self,
        link: BaseLink,
        purpose: Purpose,
        source: Callable[[Sink, Callable[[], None]], SourceT],
        drain: Callable[[Callable[[], None]], DrainT],
    ) -> None:
        self._link = link
        self._purpose = purpose
        self._ends: InternalEnds[SourceT, DrainT] = link.context.internal[purpose.name]
        self._ends.serve(link.name, source, drain)

    def proposed(self, *, here: bool) -> list[Route]:
        """Return the routes that this side has proposed, or the peer's."""
        routes = self._link.routes.values()
        return [each for each in routes if each.proposed_here == here and each.purpose is self._purpose]

    def source(self, route: Route) -> SourceT | None:
        """Return what makes a route's messages on this side, or None."""
        return self._ends.sources.get((route.local_topic, self._link.name))

    def drain(self, route: Route) -> DrainT | None:
        """Return what takes a route's messages on this side, or None."""
        return self._ends.drains.get((route.local_topic, self._link.name))

    async def opened(self, route: Route, opening: int = 0) -> bool:
        """Wait until messages can cross on a route.

        Args:
            opening: its id that the wait is for, or 0 for any opening.

        Returns:
            False if it is refused or removed, or that opening is over, or it is not opened in time.
        """
        now, end = self._link.context.now, self.source if route.outgoing else self.drain
        deadline = now() + OPENED_WITHIN
        # Looking is simpler than an event here: a channel, a pause and an end on either side may come in any order
        while not (route.flowing and end(route) is not None):
            over = route.life.refusal or route.key not in self._link.routes or (opening and route.id != opening)
            if over or now() > deadline:
                return False
            await asyncio.sleep(_LOOK_EVERY)
        return True
