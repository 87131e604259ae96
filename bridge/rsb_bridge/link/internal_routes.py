"""The internal routes of a link's features, which join no topic of ROS."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Generic

from rsb_bridge.config.topic_rules import internal_problems, transport_of
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.internal_ends import DrainT, SourceT
from rsb_bridge.route.route import Entry

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Literal

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.session import Direction, Priority
    from rsb_bridge.model.transport_traits import Compression
    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.ros.internal_ends import InternalEnds
    from rsb_bridge.ros.ros_interface import Sink
    from rsb_bridge.route.route import Route

OPENED_WITHIN = 10.0  # s. A round figure: nothing was measured


class InternalRoutes(Generic[SourceT, DrainT]):
    """Proposes and finds a link's internal routes of one purpose, and waits until they are open.

    Args:
        source: see `rsb_bridge.ros.internal_ends.InternalEnds.serve`, and so for `drain`.
    """

    def __init__(
        self,
        link: BaseLink,
        table: RouteTable,
        purpose: Purpose,
        source: Callable[[Sink, Callable[[], None]], SourceT],
        drain: Callable[[Callable[[], None]], DrainT],
    ) -> None:
        self._link = link
        self._table = table
        self._purpose = purpose
        self._ends: InternalEnds[SourceT, DrainT] = link.context.internal[purpose.name]
        self._ends.serve(link.name, source, drain)

    def open(
        self,
        name: str,
        direction: Direction,
        *,
        depth: int,
        compression: Compression,
        transport: Protocol | Literal[""] = "",
        priority: Priority = "normal",
    ) -> Route:
        """Propose a route to the peer, which has to permit it.

        Args:
            name: a `Purpose.route_name`.
            transport: its transport, or an empty string for the link's.

        Raises:
            LinkError: the link cannot carry it, or there is such a route.
        """
        link, session = self._link, self._link.context.session
        entry = Topic(
            name, direction, type=self._purpose.type_name, protocol=transport or None, qos=depth,
            compression=compression, stale_after=0.0, late_after=0.0, priority=priority,
        )  # fmt: skip
        for problem in internal_problems(entry, self._purpose, session):
            raise LinkError(str(problem))
        carrier = link.context.transports[transport_of(entry, session).name]
        proposal = proposal_of(
            entry, carrier, client_name=link.name, use_name=False, profile=link.profile, purpose=self._purpose
        )
        return self._table.add(Entry(entry, proposal), proposed_here=True)

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
        end = self.source if route.outgoing else self.drain
        try:
            async with asyncio.timeout(OPENED_WITHIN):
                # A channel, a pause and an end on either side may come in any order: each of them advances the route.
                while not (route.crossing.flows and end(route) is not None):
                    if route.life.refusal or route.key not in self._link.routes or (opening and route.id != opening):
                        return False
                    await route.waiters.wait()
        except TimeoutError:
            return False
        return True
