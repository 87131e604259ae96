"""Negotiates the routes of one link: proposes, accepts, refuses, retries and removes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias, get_args

import msgspec

from rsb_bridge.config.overlaps import overlap
from rsb_bridge.link.extension import Denied, Extension, LinkError, RefusedError
from rsb_bridge.link.holder_questions import HolderQuestions
from rsb_bridge.link.link_arming import DROPPED
from rsb_bridge.link.peer_operators import PeerOperators, acting_operator
from rsb_bridge.link.proposals import (
    ARMING_KEYS,
    allow_rate,
    amended,
    amended_by_peer,
    amended_entry,
    amendment,
    authorized,
    check_room,
    denied,
    edited_entry,
    listed_differently,
    same_route,
)
from rsb_bridge.link.route_openings import RouteOpenings
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.fates import Fate, Lost
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.topic_keys import of_peer
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.route.idling import tick_if_due
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.route import Entry, Route, route_key
from rsb_bridge.route.sender import Sender
from rsb_bridge.tasks import in_slices
from rsb_bridge.wire import messages as wire

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.model.session import Identity, Topic
    from rsb_bridge.route.half import Half

_FromHalf: TypeAlias = wire.Describe | wire.Ready | wire.Publishers | wire.Provide
_FromOperator: TypeAlias = wire.ByHand | wire.ArmingMessage | wire.HolderMessage
_AboutOpenRoute: TypeAlias = wire.Accept | wire.Refuse | wire.Close | wire.Limit | _FromHalf | _FromOperator
RouteMessage: TypeAlias = wire.Propose | wire.Amend | wire.Pause | wire.LeaseMessage | _AboutOpenRoute
"""The control messages that are about routes."""

_OF_TOPIC: tuple[type[Half], type[Half]] = Sender, Receiver
_OF_CALLS: tuple[type[Half], type[Half]] = Caller, Provider
"""The halves of a route: where its messages or calls come from, and where they go."""


class RouteTable(Extension):
    """Negotiates a link's routes, which live on while the peer is away.

    Attributes:
        listed: identities of the topics that this side proposes; named ones stay even if the other side removes them.
        on_removed: is called with a route that an operator of the other side has removed.
        on_given_up: is called after the other side has given up a route.
        changed_by_peer: whether operators of the other side have changed this session, and its file may lack that.
        openings: opens them.
        peer_operators: records what operators of the other side do.
    """

    def __init__(self, link: BaseLink) -> None:
        self.messages = dict.fromkeys(get_args(RouteMessage), self.handle)
        self.listed: set[Identity] = set()
        self.on_removed: Callable[[Route], None] = lambda _: None
        self.on_given_up: Callable[[], None] = lambda: None
        self.changed_by_peer = False
        self._context = link.context
        self._link = link
        self._down_reason = ""
        self.peer_operators = PeerOperators(link.context, "server" if link.is_client else link.name)
        self.openings = RouteOpenings(link, self.peer_operators)
        self.arming = self.openings.arming
        self.questions = HolderQuestions(link, self.peer_operators)

    # --- the connection

    def connected(self) -> None:
        self.openings.propose_soon(route for route in self._link.routes.values() if route.proposed_here)

    def resume(self) -> None:
        for route in self._link.routes.values():
            if route.id and route.proposed_here and not route.life.accepted:  # opened while nobody could be asked
                route.close("reopened")
            route.resume()
        self.connected()

    def disconnected(self) -> None:
        self.openings.disconnected()
        self._link.ids.disconnected()
        _lose(Lost.ASSOCIATION, self._link)
        self.arming.lease.stop()  # after the routes, which ask how long the other side may still publish

    def suspend(self) -> None:
        self.openings.suspend()
        _lose(Lost.CONNECTION, self._link)
        self.arming.lease.stop()  # after the routes, as in `disconnected`

    # --- adding and removing

    def add(self, entry: Entry, *, proposed_here: bool) -> Route:
        """Make this side's half of a route, and ask the peer for the other half if this side proposes it.

        Raises:
            LinkError: there is such a route, or one that bridges the same service.
        """
        self.check_add(entry)
        proposal = entry.proposal
        sending, receiving = _OF_TOPIC if proposal.kind == "topic" else _OF_CALLS
        half = sending if proposal.from_client == self._link.is_client else receiving
        route = Route(half, self._context, self._link, entry, proposed_here=proposed_here)
        self._link.routes[route.key] = route
        allow_rate(route, self._link)
        if proposed_here and route.purpose.in_graph:
            self.listed.add(entry.topic.identity)
            self._context.demands.changed()
        if proposed_here and self._link.linked:
            self.openings.propose(route, acting_operator())
        return route

    def check_add(self, entry: Entry, instead_of: Route | None = None) -> None:
        """Raise `LinkError` if a topic cannot be added, or cannot replace a route."""
        if self._link.routes.get(route_key(self._link.name, entry.proposal), instead_of) is not instead_of:
            raise LinkError(Denied.EDIT_THAT_ROUTE(topic=entry.proposal.topic))
        others = (each for each in self._link.routes.values() if each is not instead_of)
        if clash := overlap(entry.topic, (each.spec for each in others if each.id or each.proposed_here)):
            raise LinkError(clash)

    def keep_demand(self, spec: Topic, key: str) -> None:
        """Keep the demand of a topic that cannot be added because the other side proposes its route."""
        route = self._link.routes.get(key)
        if spec.arm and route is not None and not route.proposed_here:
            self.arming.keep_demand(route.local_topic, spec)
            self._context.demands.apply()

    def remove(self, route: Route, reason: str, *, anonymous: bool = False) -> None:
        """Remove a route on both sides; `anonymous` keeps the operator's name from the other side."""
        self.listed.discard(route.spec.identity)
        who = "" if anonymous else acting_operator()
        self._forget(route, EventCode.ROUTE_REMOVED, reason, tell=EndCode.REMOVED, who=who)

    def change(self, route: Route, entry: Entry) -> Route:
        """Replace a route; this side proposes the new one.

        Raises:
            LinkError: there is such a route; the old one stays.
        """
        self.check_add(entry, instead_of=route)
        at = list(self._link.routes).index(route.key)
        self.listed.discard(route.spec.identity)
        same_name = route_key(self._link.name, entry.proposal) == route.key
        if route.arming.held:
            route.disarm(Disarmed.EDITED)
        tell = EndCode.EDITED if same_name else EndCode.REMOVED
        self._forget(route, EventCode.ROUTE_REMOVED, "edited", tell=tell)
        new = self.add(entry, proposed_here=True)
        new.arming.follow(route.arming)
        # A session lists its topics in this order.
        routes = [each for each in self._link.routes.values() if each is not new]
        self._link.routes = {each.key: each for each in (*routes[:at], new, *routes[at:])}
        return new

    def deny(self, route: Route, reason: str) -> None:
        """End a route that the peer has proposed and may no longer have; the peer keeps asking for it."""
        if route.id:
            self._link.send(wire.Refuse(route=route.id, code="denied", reason=sanitize_text(reason)))
        self._forget(route, EventCode.ROUTE_REFUSED, reason)

    def rights_changed(self) -> None:
        """Apply changed rights of the peer to the open routes."""
        for route, reason in denied(self._link, self._link.end.rights).items():
            self.deny(route, reason)
        for route in self._link.routes.values():
            if allow_rate(route, self._link):
                self.openings.tell_rate(route)

    def _tell_end(self, route: Route, code: EndCode, reason: str, who: str = "") -> None:
        """Tell the peer how a route ends; a closed one is named by its last id."""
        if route_id := self._link.ids.last_of(route):
            self._link.send(wire.Close(route=route_id, reason=sanitize_text(reason), code=code, who=who))

    def _forget(
        self, route: Route, code: EventCode, reason: str, *, tell: EndCode | None = None, who: str = ""
    ) -> None:
        """Remove a route on this side, and tell the peer of that end, unless it is None."""
        if tell is not None:
            self._tell_end(route, tell, reason, who)
        self._link.routes.pop(route.key, None)
        if route.pattern:
            self.listed.discard(route.spec.identity)
        if route.proposed_here or route.listed:
            self._context.demands.changed()
        if route.arming.held:  # else `destroy` would name another cause
            route.disarm(Disarmed.REMOVED)
        route.destroy()
        self._link.ids.forget(route)
        route.log(Level.INFO, code, reason)

    def amend(self, route: Route, entry: Entry) -> None:
        """Change the limits of a route that this side proposes, while it stays open."""
        spec = entry.topic
        topic = msgspec.structs.replace(spec, paused=route.pausing.paused)
        route.amend(Entry(topic, amended(route.proposal, entry.proposal)), None)
        self._context.demands.changed()
        if not self.arming.renew_demand(route):
            route.settle_age()
        if route.id:
            self._link.send(self._amendment(route, acting_operator()))
        elif self._link.linked:
            self.openings.propose(route)  # it may be what it was refused for
        if spec.paused != route.pausing.paused:
            self.pause(route, paused=spec.paused)

    def _amended(self, message: wire.Amend) -> None:
        """Take the limits of a route that the peer proposes."""
        route = self._link.ids.find(message.route)
        if route is None or route.there is None:  # it was removed here before the message arrived
            return
        old, here = route.spec, route.here
        try:
            there = amended_by_peer(route.there, message, route.purpose, self._link)
        except LinkError as error:
            self._refuse_amended(route, str(error))
            return
        if here is not None:  # this side's entry changes with the peer's, but keeps what each session has of its own
            kept = {"max_age": here.proposal.max_age, "features": of_peer(here.topic.features)}
            here = amended_entry(here, msgspec.structs.replace(message, **kept))
        route.amend(here, there)
        if message.who:
            self.peer_operators.edited(route, message.who, old)

    def _refuse_amended(self, route: Route, reason: str) -> None:
        """End a route of which the peer wants what a proposal may not have; what this side lists, too, stays listed."""
        if route.here is None:
            self.deny(route, reason)
            return
        if route.id:
            self._link.send(wire.Refuse(route=route.id, code="denied", reason=sanitize_text(reason)))
        route.refuse(EventCode.ROUTE_REFUSED, Reason(reason))

    def _amendment(self, route: Route, who: str = "") -> wire.Amend:
        """Return the message with a route's present limits."""
        proposal = msgspec.structs.replace(route.proposal, max_age=self.arming.max_age(route))
        return amendment(proposal, route.id, who)

    def pause(self, route: Route, *, paused: bool) -> None:
        """Pause or resume a route on both sides, and disarm it."""
        who = acting_operator()
        route.pausing.change(paused=paused, who=who)
        self._tell_pause(route, who)
        self.arming.disarm(route, Disarmed.PAUSED)  # which reopens the route, and names no operator

    def _tell_pause(self, route: Route, who: str = "") -> None:
        if route.id:
            paused, revision = route.pausing.paused, route.pausing.revision
            self._link.send(wire.Pause(route=route.id, paused=paused, revision=revision, who=who))

    def _take_pause(self, route: Route, *, paused: bool, revision: int, who: str = "", known: bool = True) -> None:
        """Take the peer's state of the pause; `known` means that revisions here are about its present process."""
        pausing, was = route.pausing, route.pausing.paused
        take = pausing.merge if known else pausing.adopt
        take(paused=paused, revision=revision, who=self.peer_operators.says(who))
        if route.pausing.paused != was and known:
            self.peer_operators.paused(route, who)

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""
        for route in tuple(self._link.routes.values()):
            before = route.arming.own.max_age
            if self.arming.renew_demand(route):
                if route.proposed_here:
                    self.openings.propose(route)
                else:
                    route.request_reopen(EventCode.ROUTE_AMENDED, "its demands in this side's session have changed")
            elif route.arming.own.max_age != before:
                route.settle_age()
                self._link.send(self._amendment(route))

    def retry(self) -> None:
        """Propose refused routes at once."""
        if self._link.linked:
            self.openings.propose_soon(
                each for each in self._link.routes.values() if each.proposed_here and not each.id
            )

    # --- what the peer says

    def handle(self, message: RouteMessage) -> None:
        """Act on a control message of the peer."""
        match message:
            case wire.Propose():
                self._proposed(message)
            case wire.Close(code=EndCode.REMOVED):
                self._removed(message)
            case wire.Close(code=EndCode.EDITED):
                self._edited(message)
            case wire.Amend():
                self._amended(message)
            case wire.Lease():
                self.arming.lease.handle(message)
            case wire.Settled():
                self.arming.settled(message)
            case wire.Pause():
                # It outlives openings: the end of one, by its data connection, may have come before it.
                if (route := self._link.ids.find(message.route)) is not None:
                    self.changed_by_peer |= route.listed or bool(route.pattern)
                    self._take_pause(route, paused=message.paused, revision=message.revision, who=message.who)
                    if route.pausing.paused and route.id:
                        self.arming.disarm(route, Disarmed.PAUSED)
            case _:
                route = self._link.ids.open_route(message.route)
                if route is not None:  # otherwise it was closed here before the message arrived
                    self._about_route(route, message)
                # Also for an opening that is over (PROTOCOL.md, 7.2); a dropped demand disarms nothing.
                if isinstance(message, wire.Disarm) and message.cause != DROPPED:
                    self._link.send(wire.Settled(message.route))

    def _proposed(self, proposal: wire.Propose) -> None:
        if not self._link.ids.take_of_peer(proposal.route):
            self._link.protocol_error(f"invalid route id {proposal.route} in a proposal")
            return
        self._link.derive_keys(proposal.route, proposed_here=False)  # also if it is refused below (PROTOCOL.md, 1.3)
        try:
            self._take_up(proposal)
        except RefusedError as error:
            self._link.closed(proposal.route)
            self._link.send(wire.Refuse(route=proposal.route, code=error.code, reason=sanitize_text(str(error))))
        except LinkError as error:
            self._link.closed(proposal.route)
            self.openings.refuse(proposal, "denied", str(error))

    def _take_up(self, proposal: wire.Propose) -> None:
        """Open this side's half of a route that the peer proposes, and accept it.

        Raises:
            LinkError: the peer may not have it.
        """
        link = self._link
        theirs, known = authorized(proposal, link)
        before = known = known or _listed_as(theirs, self._link.routes.values())
        if known is not None and known.proposed_here:
            self._settle_double(known, theirs)
            known = None if known.proposed_here else known
        if known is None:
            check_room(link)
            route = self.add(theirs, proposed_here=False)
        elif same_route(known.proposal, theirs.proposal):
            route = known
            if route.here is None and route.there is not None:
                route.amend(None, amended_entry(route.there, theirs.proposal))
            route.close("reopened")
        else:
            route = self._changed_by_peer(known, theirs)
        if before is not None:
            route.arming.follow(before.arming)
        same_process = route.instance == link.instance  # before it is opened, which notes the present process
        self.openings.open(route, proposal.route)
        self._take_pause(route, paused=proposal.paused, revision=proposal.pause_revision, known=same_process)
        if (route.pausing.paused, route.pausing.revision) != (proposal.paused, proposal.pause_revision):
            self._tell_pause(route)  # an operator of this side changed it while the link was down
        link.spawn(self.openings.accept(route, proposal))
        self.peer_operators.proposed(route, proposal, edited=before is not None)

    def _settle_double(self, known: Route, entry: Entry) -> None:
        """Decide about a topic that both sides propose. The peer comes to the same end.

        An entry that names a topic goes before what a pattern has made. Of two patterns, the client's counts. Two
        entries that say the same are one, which the client proposes. If they differ, neither opens.

        Raises:
            RefusedError: the peer's proposal is refused; else this side's has given way.
        """
        link, named, theirs = self._link, known.listed, entry.proposal
        named_there = purposes()[theirs.purpose].in_graph and not theirs.by_pattern
        if not named and (named_there or not link.is_client):
            self._forget(known, EventCode.ROUTE_REPLACED, "the other side lists it", tell=EndCode.REMOVED)
            return
        if named and named_there and known.here is not None:
            if text := listed_differently(known.here, theirs, self._link):
                # The peer may have it open under another key.
                self._tell_end(known, EndCode.LISTED_DIFFERENTLY, text)
                known.refuse(EventCode.ROUTE_LISTED_DIFFERENTLY, Reason(text, EndCode.LISTED_DIFFERENTLY))
                raise RefusedError("listed_differently", text)
            if not link.is_client:
                # The client may have removed its entry since, and accepted this side's.
                self._tell_end(known, EndCode.REMOVED, "the client's is open")
                known.enter(known.here, entry)
                return
            if not known.id:
                self.openings.propose(known)
        raise RefusedError("listed_too", Denied.LISTED_TOO(topic=theirs.topic))

    def _removed(self, message: wire.Close) -> None:
        """Remove a route that the peer has removed; this side may have closed or reopened it before."""
        if (route := self._link.ids.find(message.route)) is None:  # both sides removed it
            return
        # A newer opening, of which the peer hears later, would bring it back.
        tell = EndCode.REMOVED if route.id != message.route else None
        self.changed_by_peer |= route.listed or bool(route.pattern)
        self._forget(route, EventCode.ROUTE_REMOVED, f"removed by the other side: {message.reason}", tell=tell)
        if message.who:
            self.peer_operators.removed(route, message.who)
            self.on_removed(route)

    def _edited(self, message: wire.Close) -> None:
        """End an opening in whose place its proposer is about to propose another one."""
        route = self._link.ids.open_route(message.route)
        if route is not None and not route.proposed_here:
            if route.arming.held:
                route.disarm(Disarmed.EDITED)
            route.close(message.reason)

    def _changed_by_peer(self, known: Route, theirs: Entry) -> Route:
        """Put a changed proposal of the peer in the place of its earlier one; this side's entry of it follows."""
        self._forget(known, EventCode.ROUTE_REPLACED, "changed by the other side")
        route = self.add(theirs, proposed_here=False)
        if known.here is not None:
            spec = edited_entry(known.spec, known.proposal, theirs.proposal, self._link)
            demands = {name: getattr(known.here.proposal, name) for name in (*ARMING_KEYS, "max_age")}
            demands["features"] = of_peer(known.spec.features)
            here = Entry(
                msgspec.structs.replace(spec, max_age=known.spec.max_age, features=known.spec.features),
                msgspec.structs.replace(theirs.proposal, **demands),
            )
            route.enter(here, theirs)
            self._context.demands.changed()
        return route

    def _about_route(self, route: Route, message: _AboutOpenRoute) -> None:
        route.wake()
        match message:
            case wire.Accept():
                route.set_peer_topic(message.topic)
                self.arming.accepted(route, message)
                route.age.accepted = message.max_age
                route.settle_age()
                self.openings.accepted(route)
            case wire.Limit():
                route.limit.allow_there(message.max_rate)
            case wire.Refuse(code="listed_too"):
                # The peer's own proposal decides. If none comes, this side tries again.
                route.close(message.reason)
                route.reopening.failed(self._context.now(), broke=False)
            case wire.Refuse():
                reason, differs = Reason(f"refused by the other side: {message.reason}"), EndCode.LISTED_DIFFERENTLY
                if message.code == "listed_differently":  # this side may have found out already, in its own words
                    known = route.reopening.refused
                    reason = known if known.code is differs else Reason(reason.text, differs)
                route.refuse(EventCode.ROUTE_REFUSED, reason)
            # Of these, what is for the other half is ignored.
            case wire.Describe() if isinstance(route.half, Receiver):
                route.half.described(message)
            case wire.Publishers() if isinstance(route.half, Receiver):
                route.half.told_of_publishers(message)
            case wire.Ready() if isinstance(route.half, Sender):
                route.half.peer_ready(message)
            case wire.Provide() if isinstance(route.half, Caller):
                route.half.provided(message)
            case wire.Close():
                reason = Reason(message.reason, message.code)
                if not reason.broke:
                    reason = Reason(f"closed by the other side: {message.reason}", message.code)
                route.refuse(EventCode.ROUTE_CLOSED, reason)
            case wire.ByHand():
                self.peer_operators.called(route, message)
            case wire.Arm() | wire.Armed() | wire.Disarm():
                self.arming.handle(route, message)
            case wire.AskForArming() | wire.AskEnded():
                self.questions.handle(route, message)

    # --- time

    async def tick_routes(self) -> None:
        """Run the own tick of the routes that are not idle, once a second."""
        now, link = self._context.now(), self._link
        if link.down_reason != self._down_reason:
            self._down_reason = link.down_reason
            for route in link.routes.values():
                route.judge_again()
        looked_at = link.is_looked_at

        def tick(route: Route) -> None:
            link.guarded(lambda: tick_if_due(route, now, looked_at=looked_at))

        await in_slices(link.timetable.look(now), tick)

    def tick(self) -> None:
        """Propose refused routes again, and remove routes that the peer no longer wants."""
        now, link = self._context.now(), self._link
        if not link.linked:
            return
        self.arming.tick()
        for route in tuple(link.awake):  # as are all that are not open
            if route.id:
                continue
            if route.proposed_here:
                if now >= route.reopening.retry_at:
                    self.openings.propose_soon((route,))
            elif now > route.reopening.awaited_until(link.linked_at):
                if route.here is not None:  # this side's session lists it, too
                    _lead(route)
                    self.openings.propose(route)
                else:
                    self._forget(route, EventCode.ROUTE_REMOVED, "the other side no longer asks for it")
                    self.on_given_up()


def _lose(lost: Lost, link: BaseLink) -> None:
    """Suspend or close a link's routes, which have lost what carries them."""
    for route in link.routes.values():
        if route.id and route.life.accepted and route.fates[lost] is not Fate.CLOSES:
            route.suspend()
        elif route.id or lost is Lost.ASSOCIATION:
            route.close(link.status.reason)
            _lead(route)  # the peer's next session may not list it any more


def _lead(route: Route) -> None:
    """Have this side propose a route again, if its session lists it."""
    if route.here is not None:
        route.enter(route.here, None)


def _listed_as(theirs: Entry, routes: Iterable[Route]) -> Route | None:
    """Return the route that this side proposes of the same topic under another name on the server, or None."""
    identity = theirs.topic.identity
    return next((each for each in routes if each.proposed_here and each.spec.identity == identity), None)
