"""The routes of one link: proposed, accepted, refused, tried again, removed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeAlias

import msgspec

from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.proposals import amended, amended_topic, amendment, same_route, topic_of
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.route import Owner, Route, route_key
from rsb_bridge.tasks import in_slices
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import Accept, Amend, Close, Describe, Pause, Propose, Publishers, Ready, Refuse, Report

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Coroutine

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.wire.fields import RefuseCode
    from rsb_bridge.wire.records import ReceivedReport, SentReport

_CLOSED_REMEMBERED = 4
"""Ids of a route's closed incarnations: what the peer says of one may be under way while the next ones come and go."""

_REPORTED_AT_ONCE = 250
"""Routes in one message, whatever long texts are in it (PROTOCOL.md section 1)."""

RouteMessage: TypeAlias = Propose | Accept | Refuse | Describe | Ready | Publishers | Close | Amend | Pause | Report
"""The control messages that are about routes."""


class RouteOwner(Owner, Protocol):
    """What the table asks of its link."""

    @property
    def linked_at(self) -> float:
        """s, when the present connection was made."""
        ...

    def authorize(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic.

        Raises:
            LinkError: the peer may not have this topic.
        """
        ...

    async def prepare_port(self, route: Route) -> None:
        """Have the port that a route names ready for the client.

        Raises:
            ListenError: it cannot be bound.
        """
        ...

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine beside."""
        ...

    def guarded(self, work: Callable[[], None]) -> None:
        """Do regular work; if it fails, this link's connection ends, not the others'."""
        ...

    def protocol_error(self, reason: str) -> None:
        """The peer broke the protocol: end the connection."""
        ...

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "") -> None:
        """Add an event about this link."""
        ...


class RouteTable:
    """A link's routes, which live on while the peer is away.

    Attributes:
        routes: by key.
        yielded: the topics that this side proposed until the other side's own took their places; by their routes' keys.
    """

    def __init__(self, context: Context, owner: RouteOwner) -> None:
        self.routes: dict[str, Route] = {}
        self.yielded: dict[str, Topic] = {}
        self._context = context
        self._owner = owner
        self._by_id: dict[int, Route] = {}
        self._closed: dict[int, Route] = {}  # by the ids of its last incarnations on this connection
        # Ids count on across connections, so that late messages from a closed connection match no route.
        self._next_id = 1 if owner.is_client else 2
        self._newest_of_peer = 0
        self._refused: dict[str, str] = {}

    # --- the connection

    def connected(self) -> None:
        """The peer is connected: propose what this side wants."""
        for route in tuple(self.routes.values()):
            if route.proposed_here:
                self.propose(route)

    def disconnected(self, reason: str) -> None:
        """The connection is over: every route is closed until the next one."""
        self._by_id.clear()
        self._closed.clear()
        self._refused.clear()
        self._newest_of_peer = 0
        for route in self.routes.values():
            route.close(reason)
            route.closed_ids.clear()

    def destroy(self) -> None:
        """End all routes for good."""
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    # --- adding and removing

    def add(self, spec: Topic, proposal: Propose, *, proposed_here: bool) -> Route:
        """Make a route's half on this side; if this side proposes it, ask the peer for the other half.

        Args:
            spec: the topic, validated.
            proposal: of it, with this side's names.
            proposed_here: whether this side proposes it.

        Raises:
            LinkError: there is such a route.
        """
        key = route_key(self._owner.name, proposal)
        if key in self.routes:
            raise LinkError(f"{proposal.topic} is bridged in that direction already: edit or remove that route")
        kind = OutgoingRoute if proposal.from_client == self._owner.is_client else IncomingRoute
        route = kind(self._context, self._owner, spec, proposal, proposed_here=proposed_here)
        self.routes[key] = route
        if proposed_here and self._owner.linked:
            self.propose(route)
        return route

    def move(self, route: Route, at: int) -> None:
        """Give a route its place among the others, in whose order a session has its topics."""
        routes = [each for each in self.routes.values() if each is not route]
        routes.insert(at, route)
        self.routes = {each.key: each for each in routes}

    def remove(self, route: Route, reason: str) -> None:
        """Remove a route on both sides."""
        self._tell_removed(route, reason)
        self._forget(route, EventCode.ROUTE_REMOVED, reason)

    def deny(self, route: Route, reason: str) -> None:
        """End a route that the peer proposed and may not have any more; the peer goes on asking for it."""
        if route.id:
            self._owner.send(Refuse(route=route.id, code="denied", reason=sanitize_text(reason)))
        self._forget(route, EventCode.ROUTE_REFUSED, reason)

    def _tell_removed(self, route: Route, reason: str) -> None:
        """Tell the peer, by the last id that the route had where it is closed for now."""
        if route_id := route.id or next(reversed(route.closed_ids), 0):
            self._owner.send(Close(route=route_id, reason=sanitize_text(reason), removed=True))

    def _forget(self, route: Route, code: EventCode, reason: str) -> None:
        """Remove a route on this side."""
        self.routes.pop(route.key, None)
        if code is EventCode.ROUTE_REMOVED:
            self.yielded.pop(route.key, None)
        route.destroy()
        for route_id in route.closed_ids:
            del self._closed[route_id]
        route.log(Level.INFO, code, reason)

    def can_amend(self, route: Route, proposal: Propose) -> bool:
        """Whether a route can go on as this is proposed: nothing but limits change, and its proposer can be asked."""
        return same_route(route.proposal, proposal) and bool(route.proposed_here or route.id)

    def amend(self, route: Route, spec: Topic, proposal: Propose) -> None:
        """Change the limits of a route on both sides, while it stays open.

        Args:
            route: to change.
            spec: the topic as it is wanted, validated.
            proposal: of it, with this side's names.
        """
        changed = amended(route.proposal, proposal)
        if route.proposed_here:
            route.amend(msgspec.structs.replace(spec, paused=route.paused), changed)
        if route.id:
            self._owner.send(amendment(changed, route.id))
        if spec.paused != route.paused:
            self.pause(route, paused=spec.paused)

    def _amended(self, message: Amend) -> None:
        """The peer has changed the limits of a route, or asks for that."""
        route = self._by_id.get(message.route) or self._closed.get(message.route)
        if route is None:
            return  # it was removed here while the message was under way
        proposal = amended(route.proposal, message)
        route.amend(amended_topic(route.spec, proposal), proposal)
        if route.proposed_here and route.id:
            self._owner.send(amendment(proposal, route.id))

    def pause(self, route: Route, *, paused: bool) -> None:
        """Pause or resume a route on both sides."""
        route.pause(paused)
        self._send_pause(route)

    def _send_pause(self, route: Route) -> None:
        if route.id:
            self._owner.send(Pause(route=route.id, paused=route.paused, revision=route.pausing.revision))

    def retry(self) -> None:
        """Propose at once what was refused."""
        for route in tuple(self.routes.values()):
            if self._owner.linked and route.proposed_here and not route.id:
                self.propose(route)

    # --- ids

    def open_route(self, route_id: int) -> Route | None:
        """The open route of that id."""
        return self._by_id.get(route_id)

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under that id and is no longer: what still arrives for it is late, not wrong."""
        ours = route_id % 2 == self._owner.is_client
        newest = self._next_id - 2 if ours else self._newest_of_peer
        return 0 < route_id <= newest and route_id not in self._by_id

    def closed(self, route_id: int) -> None:
        """An incarnation of a route is over."""
        route = self._by_id.pop(route_id, None)
        if route is not None:
            self._closed[route_id] = route
            route.closed_ids.append(route_id)
            if len(route.closed_ids) > _CLOSED_REMEMBERED:
                del self._closed[route.closed_ids.popleft()]

    def _reopen(self, route: Route, route_id: int) -> None:
        route.close("opened anew")
        route.open(route_id)
        self._by_id[route_id] = route

    # --- proposing

    def propose(self, route: Route) -> None:
        """Ask the peer to open a route; if it is open, it is closed and opened again."""
        self._reopen(route, self._next_id)
        self._next_id += 2
        self._owner.spawn(self._propose(route, route.id))

    async def _propose(self, route: Route, route_id: int) -> None:
        try:
            await self._owner.prepare_port(route)
        except ListenError as error:
            if route.id == route_id:
                route.refuse(EventCode.ROUTE_PORT_UNAVAILABLE, str(error))
        if route.id == route_id:
            pausing = route.pausing
            self._owner.send(
                msgspec.structs.replace(
                    route.proposal, route=route_id, paused=pausing.paused, pause_revision=pausing.revision
                )
            )

    # --- what the peer says

    def handle(self, message: RouteMessage) -> None:
        """Do what a control message says."""
        match message:
            case Propose():
                self._proposed(message)
            case Report():
                self._take_report(message)
            case Close(removed=True):
                self._removed(message)
            case Amend():
                self._amended(message)
            case _:
                route = self._by_id.get(message.route)
                if route is not None:  # else it was closed here while the message was under way
                    self._about_route(route, message)

    def _proposed(self, proposal: Propose) -> None:
        if proposal.route % 2 == self._owner.is_client or proposal.route <= self._newest_of_peer:
            self._owner.protocol_error(f"invalid route id {proposal.route} in a proposal")
            return
        self._newest_of_peer = proposal.route
        try:
            route = self._take_up(proposal)
        except LinkError as error:
            self._refuse(proposal, "denied", str(error))
        else:
            self._owner.spawn(self._accept(route, proposal))

    def _take_up(self, proposal: Propose) -> Route:
        """This side's half of what the peer proposes.

        Raises:
            LinkError: the peer may not have it.
        """
        owner, session = self._owner, self._context.session
        for problem in validate_topic(topic_of(proposal)):  # first: a prefix can make a valid name of an invalid one
            raise LinkError(str(problem))
        authorized = owner.authorize(proposal)
        for problem in validate_topic(topic_of(authorized), session):
            raise LinkError(str(problem))
        incoming = authorized.from_client != owner.is_client
        if incoming and authorized.remote_topic == session.shutdown_topic:
            raise LinkError(
                f"{authorized.remote_topic} is this side's shutdown topic: only its own domain may publish on it"
            )
        if len(self.routes) >= ROUTES_PER_LINK:
            raise LinkError(f"this link has {ROUTES_PER_LINK} topics already, which is the limit")
        known = self.routes.get(route_key(owner.name, authorized))
        if known is not None and known.proposed_here and owner.is_client:
            raise LinkError(f"{authorized.topic} is bridged in that direction already")
        if known is not None and (known.proposed_here or not same_route(known.proposal, authorized)):
            # Where both propose, the client's is the one that stays. The client may have removed it since, and taken up
            # this side's.
            if known.proposed_here:
                self._tell_removed(known, "replaced by the client's")
                self.yielded[known.key] = known.spec
            self._forget(known, EventCode.ROUTE_REPLACED, "replaced by the other side's")
            known = None
        if known is not None:
            known.amend(amended_topic(known.spec, authorized), amended(known.proposal, authorized))
        route = known or self.add(topic_of(authorized), authorized, proposed_here=False)
        same_process = route.instance == owner.instance
        self._reopen(route, proposal.route)
        route.pause_from_peer(proposal.paused, proposal.pause_revision, known=same_process)
        if (route.paused, route.pausing.revision) != (proposal.paused, proposal.pause_revision):
            self._send_pause(route)  # an operator of this side changed it while the link was down
        return route

    async def _accept(self, route: Route, proposal: Propose) -> None:
        connection = self._owner.connections

        def current() -> bool:
            return self._owner.linked and self._owner.connections == connection and route.id == proposal.route

        try:
            await self._owner.prepare_port(route)
        except ListenError as error:
            if current():
                route.refuse(EventCode.ROUTE_PORT_UNAVAILABLE, str(error))
                self._refuse(proposal, "port_taken", str(error))
            return
        if current():  # else it was closed while its port was being bound
            self._owner.send(Accept(route=route.id, topic=route.local_topic))
            route.on_accepted()

    def _refuse(self, proposal: Propose, code: RefuseCode, reason: str) -> None:
        if self._refused.get(proposal.topic) != reason:  # the other side keeps trying; one event is enough
            if len(self._refused) >= ROUTES_PER_LINK:
                self._refused.clear()
            self._refused[proposal.topic] = reason
            text = f"refused {proposal.topic}: {reason}"
            self._owner.log(Level.WARNING, EventCode.ROUTE_REFUSED, text, topic=proposal.topic)
        self._owner.send(Refuse(route=proposal.route, code=code, reason=sanitize_text(reason)))

    def _removed(self, message: Close) -> None:
        """The peer has removed a route, which may have been closed or opened again on this side meanwhile."""
        route = self._by_id.get(message.route) or self._closed.get(message.route)
        if route is None:
            return  # both sides removed it
        reason = f"removed by the other side: {message.reason}"
        if route.id != message.route:
            self._tell_removed(route, reason)
        self._forget(route, EventCode.ROUTE_REMOVED, reason)

    def _about_route(
        self, route: Route, message: Accept | Refuse | Describe | Ready | Publishers | Close | Pause
    ) -> None:
        match message:
            case Accept():
                route.set_peer_topic(message.topic)
                route.on_accepted()
            case Refuse():
                route.refuse(EventCode.ROUTE_REFUSED, f"refused by the other side: {message.reason}")
            case Describe() if isinstance(route, IncomingRoute):
                route.described(message)
            case Ready() if isinstance(route, OutgoingRoute):
                route.peer_ready(message)
            case Publishers() if isinstance(route, IncomingRoute):
                route.publishers_present(message.present)
            case Close():
                route.refuse(EventCode.ROUTE_CLOSED, f"closed by the other side: {message.reason}")
            case Pause():
                route.pause_from_peer(message.paused, message.revision)

    def _take_report(self, report: Report) -> None:
        for sent in report.sent:
            route = self._by_id.get(sent.route)
            if isinstance(route, IncomingRoute):
                route.reported(sent)
        for received in report.received:
            route = self._by_id.get(received.route)
            if isinstance(route, OutgoingRoute):
                route.reported(received)

    # --- time

    async def tick_routes(self) -> None:
        """Once a second: the routes' own tick."""
        await in_slices(tuple(self.routes.values()), lambda route: self._owner.guarded(route.tick))

    async def advance(self) -> None:
        """Have the open routes that nothing flows on do what can be done next."""

        def advance(route: Route) -> None:
            if route.id and not route.flowing:
                route.advance()

        await in_slices(tuple(self._by_id.values()), advance)

    def report(self) -> None:
        """Tell the peer this side's counts, as far as it does not know them."""
        sent: list[SentReport] = []
        received: list[ReceivedReport] = []
        for route in self.routes.values():
            if not route.accepted:
                continue  # the other side may not know it yet
            if isinstance(route, OutgoingRoute):
                if (sending := route.news()) is not None:
                    sent.append(sending)
            elif isinstance(route, IncomingRoute) and (receiving := route.news()) is not None:
                received.append(receiving)
        for first in range(0, max(len(sent), len(received)), _REPORTED_AT_ONCE):
            part = slice(first, first + _REPORTED_AT_ONCE)
            self._owner.send(Report(sent=tuple(sent[part]), received=tuple(received[part])))

    def tick(self) -> None:
        """Once a second while linked: propose again what was refused, and remove what the peer no longer wants."""
        now, owner = self._context.now(), self._owner
        for route in tuple(self.routes.values()):
            if route.proposed_here and not route.id and now >= route.retry_at:
                self.propose(route)
            elif not route.proposed_here and not route.id and now > route.awaited_until(owner.linked_at):
                self._forget(route, EventCode.ROUTE_ABANDONED, "the other side no longer asks for it")
