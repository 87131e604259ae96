"""Opens the routes of one link on both sides: proposes them, and accepts or refuses what the peer proposes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.link.link_arming import LinkArming
from rsb_bridge.link.proposals import place_of
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.tasks import in_slices
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire import messages as wire

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import RefuseCode


class RouteOpenings:
    """The openings of one link's routes.

    Attributes:
        arming: arms the open routes, and has `propose` open them again.
    """

    def __init__(self, link: BaseLink, operators: PeerOperators) -> None:
        self._link = link
        self._refused: dict[str, str] = {}  # the last reason for which a topic of the peer was refused
        self._to_propose: dict[Route, None] = {}  # in this order, in slices
        self.arming = LinkArming(link, operators, self.propose)

    def suspend(self) -> None:
        """Propose nothing more: the connection is lost."""
        self._to_propose.clear()

    def disconnected(self) -> None:
        self.suspend()
        self._refused.clear()

    def open(self, route: Route, route_id: int) -> None:
        route.open(route_id)
        self.arming.opened(route)
        route.age.accepted = None
        route.settle_age()
        self._link.ids.opened(route, route_id)

    def propose(self, route: Route, who: str = "") -> None:
        """Ask the peer to open a route, or to open it again; `who` has just added or edited it, or is empty."""
        route.close("reopened")
        self.open(route, self._link.ids.new())
        self._link.spawn(self._propose(route, route.id, who))

    def propose_soon(self, routes: Iterable[Route]) -> None:
        """Propose routes that are not open, in slices: all of a link have to be, once it is up."""

        def due() -> Iterator[Route]:
            while self._to_propose:
                route = next(iter(self._to_propose))
                del self._to_propose[route]
                # A slice before, or a message of the peer, may have opened, changed or removed it.
                if route.proposed_here and not route.id and self._link.routes.get(route.key) is route:
                    yield route

        is_under_way = bool(self._to_propose)
        self._to_propose |= dict.fromkeys(routes)
        if self._to_propose and not is_under_way:
            self._link.spawn(in_slices(due(), self.propose))

    async def _propose(self, route: Route, route_id: int, who: str) -> None:
        if not await self._prepare_port(route, route_id):
            return
        pausing = route.pausing
        opening: dict[str, Any] = {"route": route_id, "paused": pausing.paused, "pause_revision": pausing.revision}
        if route.purpose.in_graph:
            opening |= {"place": place_of(route.spec, self._link, route.pattern), "by_pattern": bool(route.pattern)}
        opening |= self.arming.demanded(route)
        # Together with the sending: each Propose advances the chain of keys on both sides (PROTOCOL.md, 1.3).
        self._link.derive_keys(route_id, proposed_here=True)
        self._link.send(msgspec.structs.replace(route.proposal, **opening, who=who))

    async def accept(self, route: Route, proposal: wire.Propose) -> None:
        if await self._prepare_port(route, proposal.route, proposal):
            own = route.arming.own
            demands = own.arm, own.deadman, own.max_age, own.on_end, own.limits
            self._link.send(wire.Accept(route.id, route.local_topic, *demands))
            self.accepted(route)

    async def _prepare_port(self, route: Route, route_id: int, theirs: wire.Propose | None = None) -> bool:
        """Prepare the port of an opening, which ends if there is none; return whether it goes on.

        Args:
            theirs: the peer's proposal of it, or None if this side proposes it.
        """
        connection, failure = self._link.connections, ""
        try:
            await self._link.end.prepare_port(route)
        except ListenError as error:
            failure = str(error)
        # It may have ended meanwhile. On the next connection another process of the peer may give the same id.
        if not self._link.linked or self._link.connections != connection or route.id != route_id:
            return False
        if failure:
            route.refuse(EventCode.ROUTE_PORT_UNAVAILABLE, Reason(failure))
            if theirs is not None:
                self.refuse(theirs, "port_taken", failure)
        return not failure

    def accepted(self, route: Route) -> None:
        if route.limit.own:
            self.tell_rate(route)
        route.on_accepted()

    def refuse(self, proposal: wire.Propose, code: RefuseCode, reason: str) -> None:
        if self._refused.get(proposal.topic) != reason:  # the other side keeps trying; one event is enough
            if len(self._refused) >= ROUTES_PER_LINK:
                self._refused.clear()
            self._refused[proposal.topic] = reason
            text = f"refused {proposal.topic}: {reason}"
            self._link.log(Level.WARNING, EventCode.ROUTE_REFUSED, text, topic=proposal.topic)
        self._link.send(wire.Refuse(route=proposal.route, code=code, reason=sanitize_text(reason)))

    def tell_rate(self, route: Route) -> None:
        if route.id:
            self._link.send(wire.Limit(route=route.id, max_rate=route.limit.own))
