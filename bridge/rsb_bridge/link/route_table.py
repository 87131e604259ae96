"""The routes of one link: proposed, accepted, refused, tried again, removed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeAlias

import msgspec
from msgspec import UNSET

from rsb_bridge.link.errors import Denied, LinkError
from rsb_bridge.link.link_arming import DROPPED, LinkArming
from rsb_bridge.link.peer_operators import PeerOperators, acting_operator
from rsb_bridge.link.proposals import (
    Authority,
    allow_rate,
    amended,
    amended_topic,
    amendment,
    authorized,
    check_overlap,
    check_room,
    denied,
    same_route,
    topic_of,
    unsupported_change,
)
from rsb_bridge.model.calls import FEATURE
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.providing import ProvidingRoute
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.route import Owner, route_key
from rsb_bridge.tasks import in_slices
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import (
    Accept,
    Amend,
    Arm,
    Armed,
    ArmingMessage,
    ByHand,
    Close,
    Describe,
    Disarm,
    Lease,
    LeaseMessage,
    Limit,
    Pause,
    Propose,
    Provide,
    Publishers,
    Ready,
    Refuse,
    Settled,
)

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Container, Coroutine

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Identity, Topic
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.fields import RefuseCode

_HalfMessage: TypeAlias = Describe | Ready | Publishers | Provide
"""The control messages that one half has for the other, by what they carry."""
_CLOSED_REMEMBERED = 4
"""Ids of a route's closed incarnations: what the peer says of one may be under way while the next ones come and go."""
_AboutOpenRoute: TypeAlias = Accept | Refuse | _HalfMessage | Close | Limit | Pause | ByHand | ArmingMessage
RouteMessage: TypeAlias = Propose | Amend | LeaseMessage | _AboutOpenRoute
"""The control messages that are about routes."""


class RouteOwner(Owner, Authority, Protocol):
    """The link, as far as its route table and the parts that work with it know it."""

    @property
    def linked_at(self) -> float:
        """s, when the present connection was made."""
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


def _half_of(proposal: Propose, *, is_client: bool) -> type[Route]:
    """Return the class of a route's half on this side."""
    sending, receiving = (OutgoingRoute, IncomingRoute) if proposal.kind == "topic" else (CallingRoute, ProvidingRoute)
    return sending if proposal.from_client == is_client else receiving


def _unsupported(proposal: Propose, features: Container[str]) -> str:
    """Why a peer with these features cannot be asked for that; empty: it can."""
    if proposal.kind == "topic" or FEATURE in features:
        return ""
    return "the other side's rsb-console is too old for services, actions and parameters: update it"


def _dispatch(message: _HalfMessage, route: Route) -> None:
    """Give a message to this side's half; one that such a half does not take is ignored."""
    match message:
        case Describe() if isinstance(route, IncomingRoute):
            route.described(message)
        case Ready() if isinstance(route, OutgoingRoute):
            route.peer_ready(message)
        case Publishers() if isinstance(route, IncomingRoute):
            route.publishers_present(message.present)
        case Provide() if isinstance(route, CallingRoute):
            route.provided(message)


class RouteIds:
    """Which route is open under which id on the present connection, and which was.

    Each opening of a route has an id of its own, and none is used twice. A client gives odd ids, a server even ones.
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


class Pausing:
    """Pauses and resumes routes on both sides, whoever asks for it.

    Args:
        peer: the other side.
        peer_operators: record what is paused and resumed there.
    """

    def __init__(self, peer: Peer, peer_operators: PeerOperators) -> None:
        self._peer = peer
        self._peer_operators = peer_operators

    def pause(self, route: Route, *, paused: bool) -> None:
        """Pause or resume a route on both sides."""
        who = acting_operator()
        route.pause(paused, who)
        self._send(route, who)

    def taken_up(self, route: Route, proposal: Propose, *, known: bool) -> None:
        """The peer proposes a route, paused or not; this side's operators may have changed that since.

        Args:
            route: this side's half.
            proposal: the peer's.
            known: whether this side's revisions are about the peer's present process.
        """
        self.from_peer(route, proposal, known=known)
        if (route.paused, route.pausing.revision) != (proposal.paused, proposal.pause_revision):
            self._send(route)  # an operator of this side changed it while the link was down

    def from_peer(self, route: Route, message: Pause | Propose, *, known: bool = True) -> None:
        """The peer tells its state of the pause; what an operator there has changed is recorded here, too."""
        was, who = route.paused, message.who if isinstance(message, Pause) else ""
        revision = message.revision if isinstance(message, Pause) else message.pause_revision
        route.pause_from_peer(message.paused, revision, self._peer_operators.says(who), known=known)
        if route.paused != was and known:
            self._peer_operators.paused(route, who)

    def _send(self, route: Route, who: str = "") -> None:
        if route.id:
            self._peer.send(Pause(route=route.id, paused=route.paused, revision=route.pausing.revision, who=who))


class RouteTable:
    """A link's routes, which live on while the peer is away.

    Attributes:
        routes: by key.
        ids: of their openings.
        arming: arms and disarms them.
        ages: how old their messages may be, by this side's session.
        yielded: the topics that this side proposed until the other side's own took their places; by their routes' keys.
        listed: identities of the topics that this side proposes; named ones stay though the other side removes them.
        on_removed: called with a route that an operator of the other side has removed.
    """

    def __init__(self, context: Context, owner: RouteOwner) -> None:
        self.routes: dict[str, Route] = {}
        self.yielded: dict[str, Topic] = {}
        self.listed: set[Identity] = set()
        self.on_removed: Callable[[Route], None] = lambda _: None
        self._context = context
        self._owner = owner
        self.ids = RouteIds(is_client=owner.is_client)
        self._refused: dict[str, str] = {}
        peer_name = "server" if owner.is_client else owner.name
        self._peer_operators = PeerOperators(context, peer_name)
        self._pausing = Pausing(owner, self._peer_operators)
        self.arming = LinkArming(
            context, owner, self._peer_operators, lambda: tuple(self.routes.values()), self.propose
        )

    # --- the connection

    def connected(self) -> None:
        """The peer is connected: propose what this side wants."""
        for route in tuple(self.routes.values()):
            if route.proposed_here:
                self.propose(route)

    def disconnected(self, reason: str) -> None:
        """The connection is over: every route is closed until the next one."""
        self.ids.disconnected()
        self._refused.clear()
        for route in self.routes.values():
            route.close(reason)
        self.arming.lease.stop()

    def destroy(self) -> None:
        """End all routes for good."""
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    # --- adding and removing

    def add(
        self, spec: Topic, proposal: Propose, *, proposed_here: bool, edited: bool = False, by_pattern: bool = False
    ) -> Route:
        """Make a route's half on this side; if this side proposes it, ask the peer for the other half.

        Args:
            spec: the topic, validated.
            proposal: of it, with this side's names.
            proposed_here: whether this side proposes it.
            edited: it takes the place of a route that was removed right before.
            by_pattern: a pattern wants it, which demands by itself what it demands.

        Raises:
            LinkError: there is such a route, or one that bridges the same service.
        """
        key = route_key(self._owner.name, proposal)
        if not by_pattern:
            self.keep_demand(spec, key)
        self.check_add(spec, proposal, key)
        half = _half_of(proposal, is_client=self._owner.is_client)
        route = self.routes[key] = half(self._context, self._owner, spec, proposal, proposed_here=proposed_here)
        allow_rate(route, self._owner)
        if proposed_here:
            self.listed.add(spec.identity)
            self._context.demands.changed()
        if proposed_here and self._owner.linked:
            self.propose(route, acting_operator(), edited=edited)
        return route

    def check_add(self, spec: Topic, proposal: Propose, key: str, instead_of: Route | None = None) -> None:
        """Raise `LinkError` where a topic cannot be added, or not in a route's place."""
        if self.routes.get(key, instead_of) is not instead_of:
            raise LinkError(Denied.EDIT_THAT_ROUTE(topic=proposal.topic))
        check_overlap(spec, [each for each in self.routes.values() if each is not instead_of])

    def keep_demand(self, spec: Topic, key: str) -> None:
        """Keep what a topic demands that cannot be added because the other side proposes the route with its key."""
        route = self.routes.get(key)
        if spec.arm and route is not None and not route.proposed_here:
            self.arming.keep_demand(route, spec)
            self._context.demands.apply()

    def move(self, route: Route, at: int) -> None:
        """Give a route its place among the others, in whose order a session has its topics."""
        routes = [each for each in self.routes.values() if each is not route]
        routes.insert(at, route)
        self.routes = {each.key: each for each in routes}

    def remove(self, route: Route, reason: str, *, told: bool = True) -> None:
        """Remove a route on both sides; `told`: the other side's operators are told who does it."""
        self.listed.discard(route.spec.identity)
        self._tell_removed(route, reason, acting_operator() if told else "")
        self._forget(route, EventCode.ROUTE_REMOVED, reason)

    def deny(self, route: Route, reason: str) -> None:
        """End a route that the peer proposed and may not have any more; the peer goes on asking for it."""
        if route.id:
            self._owner.send(Refuse(route=route.id, code="denied", reason=sanitize_text(reason)))
        self._forget(route, EventCode.ROUTE_REFUSED, reason)

    def rights_changed(self) -> None:
        """Hold the open routes to what the peer may do now."""
        routes = tuple(self.routes.values())
        for route, reason in denied(routes, self._owner.rights, is_client=self._owner.is_client).items():
            self.deny(route, reason)
        for route in self.routes.values():
            if allow_rate(route, self._owner):
                self._tell_rate(route)

    def _tell_rate(self, route: Route) -> None:
        if route.id:
            self._owner.send(Limit(route=route.id, max_rate=route.limit.here))

    def _tell_removed(self, route: Route, reason: str, who: str = "") -> None:
        """Tell the peer, by the last id that the route had where it is closed for now."""
        if route_id := self.ids.last_of(route):
            self._owner.send(Close(route=route_id, reason=sanitize_text(reason), removed=True, who=who))

    def _forget(self, route: Route, code: EventCode, reason: str) -> None:
        """Remove a route on this side."""
        self.routes.pop(route.key, None)
        self.listed -= {route.spec.identity} if route.pattern else set()
        yielded = self.yielded.pop(route.key, None) if code is EventCode.ROUTE_REMOVED else None
        if route.proposed_here or yielded is not None:
            self._context.demands.changed()
        if route.arming.held:
            route.disarm(Disarmed.REMOVED)
        route.destroy()
        self.ids.forget(route)
        route.log(Level.INFO, code, reason)

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
            self._context.demands.changed()
        if route.id:
            self._owner.send(self._amendment(route, changed, acting_operator()))
        if spec.paused != route.paused:
            self.pause(route, paused=spec.paused)

    def unsupported_change(self, route: Route, proposal: Propose) -> str:
        """Return why the peer, which proposes the route, is too old for other limits, or an empty string."""
        return unsupported_change(route.proposal, proposal, self._owner.features)

    def _amended(self, message: Amend) -> None:
        """The peer has changed the limits of a route, or asks for that."""
        route = self.ids.find(message.route)
        if route is None:
            return  # it was removed here while the message was under way
        proposal, old = amended(route.proposal, message), route.spec
        route.amend(amended_topic(route.spec, proposal), proposal)
        if route.proposed_here and route.spec.max_age != old.max_age:
            self._context.demands.changed()
            if not self.arming.renew_demand(route):
                route.settle_age()
        if message.who:
            self._peer_operators.edited(route, message.who, old)
            route.pattern = ""
        if route.proposed_here and route.id:
            self._owner.send(self._amendment(route, proposal))

    def _amendment(self, route: Route, proposal: Propose, who: str = "") -> Amend:
        """Return the message that changes a route's limits to a proposal's."""
        if route.proposed_here:
            proposal = msgspec.structs.replace(proposal, max_age=self.arming.max_age(route, proposal))
        message = amendment(proposal, route.id, who)
        if not route.proposed_here and proposal.max_age == route.proposal.max_age:
            # The proposer's entry may set none: then its limit comes from another line, which is not to be copied.
            message = msgspec.structs.replace(message, max_age=UNSET)
        return message

    def pause(self, route: Route, *, paused: bool) -> None:
        """Pause or resume a route on both sides; what was armed has to be armed again."""
        self._pausing.pause(route, paused=paused)  # first: what is disarmed opens anew, and that names nobody
        self.arming.disarm(route, Disarmed.PAUSED)

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""
        for route in tuple(self.routes.values()):
            before = route.arming.own.max_age
            if self.arming.renew_demand(route):
                if route.proposed_here:
                    self.propose(route)
                else:
                    route.request_reopen(EventCode.ROUTE_AMENDED, "its demands in this side's session have changed")
            elif route.arming.own.max_age != before:
                route.settle_age()
                self._owner.send(self._amendment(route, route.proposal))

    def retry(self) -> None:
        """Propose at once what was refused."""
        for route in tuple(self.routes.values()):
            if self._owner.linked and route.proposed_here and not route.id:
                self.propose(route)

    # --- ids

    def closed(self, route_id: int) -> None:
        """An incarnation of a route is over."""
        self.ids.closed(route_id)

    def _reopen(self, route: Route, route_id: int) -> None:
        route.close("opened anew")
        route.open(route_id)
        self.arming.opened(route)
        route.age.accepted = None
        route.settle_age()
        self.ids.opened(route, route_id)

    # --- proposing

    def propose(self, route: Route, who: str = "", *, edited: bool = False) -> None:
        """Ask the peer to open a route; if it is open, it is closed and opened again.

        Args:
            route: which.
            who: has just added or edited it; empty: nobody has.
            edited: it takes the place of a route that was removed right before.
        """
        self._reopen(route, self.ids.new())
        if refusal := _unsupported(route.proposal, self._owner.features):
            route.refuse(EventCode.ROUTE_REFUSED, refusal)
            return
        self._owner.spawn(self._propose(route, route.id, who, edited=edited))

    async def _propose(self, route: Route, route_id: int, who: str, *, edited: bool) -> None:
        try:
            await self._owner.prepare_port(route)
        except ListenError as error:
            if route.id == route_id:
                route.refuse(EventCode.ROUTE_PORT_UNAVAILABLE, str(error))
        if route.id == route_id:
            pausing = route.pausing
            opening = {"route": route_id, "paused": pausing.paused, "pause_revision": pausing.revision}
            opening |= self.arming.demanded(route)
            self._owner.send(msgspec.structs.replace(route.proposal, **opening, who=who, edited=edited))

    # --- what the peer says

    def handle(self, message: RouteMessage) -> None:
        """Do what a control message says."""
        match message:
            case Propose():
                self._proposed(message)
            case Close(removed=True):
                self._removed(message)
            case Amend():
                self._amended(message)
            case Lease():
                self.arming.lease.handle(message)
            case Settled():
                self.arming.settled(message)
            case _:
                route = self.ids.open_route(message.route)
                if route is not None:  # else it was closed here while the message was under way
                    self._about_route(route, message)
                if isinstance(message, Disarm) and message.cause != DROPPED and self.arming.lease.supported:
                    self._owner.send(Settled(message.route))

    def _proposed(self, proposal: Propose) -> None:
        if not self.ids.take_of_peer(proposal.route):
            self._owner.protocol_error(f"invalid route id {proposal.route} in a proposal")
            return
        try:
            route = self._take_up(proposal)
        except LinkError as error:
            self._refuse(proposal, "denied", str(error))
        else:
            self._owner.spawn(self._accept(route, proposal))
            self._peer_operators.proposed(route, proposal)

    def _take_up(self, proposal: Propose) -> Route:
        """This side's half of what the peer proposes.

        Raises:
            LinkError: the peer may not have it.
        """
        owner = self._owner
        ours = authorized(proposal, owner, self._context.session)
        known = self.routes.get(route_key(owner.name, ours))
        if known is None:
            check_room(self.routes.values(), self._context.session)
        elif known.proposed_here and owner.is_client:
            raise LinkError(Denied.BRIDGED_ALREADY(topic=ours.topic))
        if known is not None and (known.proposed_here or not same_route(known.proposal, ours)):
            # Where both propose, the client's is the one that stays. The client may have removed it since, and taken up
            # this side's.
            if known.proposed_here:
                self._tell_removed(known, "replaced by the client's")
                self.yielded |= {} if known.pattern else {known.key: known.spec}
            self._forget(known, EventCode.ROUTE_REPLACED, "replaced by the other side's")
            known = None
        if known is not None:
            known.amend(amended_topic(known.spec, ours), amended(known.proposal, ours))
        route = known or self.add(topic_of(ours), ours, proposed_here=False)
        same_process = route.instance == owner.instance
        self._reopen(route, proposal.route)
        self._pausing.taken_up(route, proposal, known=same_process)
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
            arming = route.arming
            max_age = arming.own.max_age
            self._owner.send(Accept(route.id, route.local_topic, arming.required, arming.deadman, max_age))
            self._accepted(route)

    def _accepted(self, route: Route) -> None:
        if route.limit.here:
            self._tell_rate(route)
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
        route = self.ids.find(message.route)
        if route is None:
            return  # both sides removed it
        reason = f"removed by the other side: {message.reason}"
        if route.id != message.route:
            self._tell_removed(route, reason)
        self._forget(route, EventCode.ROUTE_REMOVED, reason)
        if message.who:
            self._peer_operators.removed(route, message.who)
            self.on_removed(route)

    def _about_route(self, route: Route, message: _AboutOpenRoute) -> None:
        match message:
            case Accept():
                route.set_peer_topic(message.topic)
                self.arming.accepted(route, required=message.arm, deadman=message.deadman)
                route.age.accepted = message.max_age
                route.settle_age()
                self._accepted(route)
            case Limit():
                route.limit.allow_there(message.max_rate)
            case Refuse():
                route.refuse(EventCode.ROUTE_REFUSED, f"refused by the other side: {message.reason}")
            case Describe() | Ready() | Publishers() | Provide():
                _dispatch(message, route)
            case Close():
                route.refuse(EventCode.ROUTE_CLOSED, f"closed by the other side: {message.reason}")
            case Pause():
                self._pausing.from_peer(route, message)
                if route.paused:
                    self.arming.disarm(route, Disarmed.PAUSED)
            case ByHand():
                self._peer_operators.called(route, message)
            case Arm() | Armed() | Disarm():
                self.arming.handle(route, message)

    # --- time

    async def tick_routes(self) -> None:
        """Once a second: the routes' own tick."""
        await in_slices(tuple(self.routes.values()), lambda route: self._owner.guarded(route.tick))

    async def advance(self) -> None:
        """Have the open routes do what can be done next."""

        def advance(route: Route) -> None:
            if route.id:  # a slice before this one may have closed it
                route.advance()

        await in_slices(self.ids.open_routes(), advance)

    def tick(self) -> None:
        """Once a second while linked: propose again what was refused, and remove what the peer no longer wants."""
        now, owner = self._context.now(), self._owner
        self.arming.tick()
        for route in tuple(self.routes.values()):
            if route.proposed_here and not route.id and now >= route.retry_at:
                self.propose(route)
            elif not route.proposed_here and not route.id and now > route.awaited_until(owner.linked_at):
                self._forget(route, EventCode.ROUTE_ABANDONED, "the other side no longer asks for it")
