"""Arming and disarming a link's routes on both sides (PROTOCOL.md, 7)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.lease import LinkLease
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.route.arming import SAID, Disarmed
from rsb_bridge.wire.arming import Arm, Armed, Disarm

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.context import Context
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.lease import Standstill
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.arming import ArmingMessage
    from rsb_bridge.wire.lease import Settled

_AT_ONCE, _A_SECOND = 20.0, 1 / 30
"""Armings by one link's peer: each is in the log, so more than people need are refused."""


class LinkArming:
    """Arms routes for this side's operators and for the other's, and disarms them.

    Args:
        context: has the clock and the log.
        peer: the other side.
        peer_operators: know how this side's operators call those of the other one.
        routes: the link's.
        propose: opens a route anew that this side proposes.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        peer_operators: PeerOperators,
        routes: Callable[[], tuple[Route, ...]],
        propose: Callable[[Route], None],
    ) -> None:
        self._context = context
        self._peer = peer
        self._peer_operators = peer_operators
        self._routes = routes
        self._propose = propose
        self._budget = TokenBucket(_AT_ONCE, _A_SECOND, context.now())
        self._demands: dict[tuple[bool, str], float] = {}
        self.lease = LinkLease(
            context, peer, lambda: any(route.arming.held for route in routes()), self._disarm_as_it_stood_still
        )

    # --- which routes have to be armed

    def demand(self, route: Route, topic: Topic) -> None:
        """This side's session has a topic of its own for a route: it counts whoever proposes the route later.

        A peer that removes the topic, or proposes it itself, under whatever name on its own side, changes nothing.
        """
        demands = {key: value for key, value in self._demands.items() if key != _local(route)}
        if topic.arm:
            demands[_local(route)] = topic.deadman_seconds
        if demands != self._demands:
            self._demands = demands
            for other in self._routes():
                if other.id and not other.proposed_here and _local(other) == _local(route):
                    other.request_reopen(EventCode.ROUTE_AMENDED, "this side's session says anew whether to arm it")

    def forget(self, route: Route) -> None:
        """An operator of this side has removed a topic."""
        self._demands.pop(_local(route), None)

    def opened(self, route: Route) -> None:
        """A route is opened anew, disarmed."""
        proposal, own = route.proposal, self._demands.get(_local(route))
        route.arming.opened(required=proposal.arm, deadman=proposal.deadman)
        route.arming.demand(required=own is not None, deadman=own or 0.0)
        route.arming.lease = self.lease.state

    # --- operators of this side

    async def arm(self, route: Route, console: Hashable) -> None:
        """Arm a route for a console of this side; returns once both sides hold it for armed.

        Raises:
            LinkError: it cannot be armed now.
        """
        arming, topic = route.arming, route.local_topic
        if why_not := self._why_not(route):
            raise LinkError(f"{topic} cannot be armed: {why_not}")
        answered = asyncio.Event()
        who = acting_operator()
        self.lease.hold()
        arming.ask(who, console, self._context.now(), answered.set)
        self._peer.send(Arm(route.id, who))
        await answered.wait()
        if not (arming.armed and arming.console == console):
            raise LinkError(f"{topic} is not armed: {f'{arming.by} armed it' if arming.armed else arming.reason}")

    def _why_not(self, route: Route) -> str:
        arming = route.arming
        if not self._peer.linked:
            return self._peer.down_reason or "the link is down"
        if not route.accepted:
            return route.refusal or "it is being set up"
        if not arming.required:
            return "it need not be; its topic has no arm: true in either session"
        if not self.lease.supported:
            return SAID[Disarmed.PEER_TOO_OLD]
        if route.paused:
            return "it is paused; resume it first"
        if arming.held:
            return f"{arming.by} has armed it already"
        return "it is being set up anew; try again in a moment" if arming.spent else ""

    def disarm(self, route: Route, why: Disarmed, reason: str = "") -> None:
        """Disarm a route on both sides; nothing happens where it is not armed."""
        if not route.arming.held:
            return
        who = acting_operator() if why is Disarmed.OPERATOR else ""
        self._peer.send(Disarm(route.id, why, who))
        self._ended(route, why, reason)
        if why is Disarmed.OPERATOR:
            route.settling.then(lambda: self._disarmed_by(route, who))

    def _ended(self, route: Route, why: Disarmed, reason: str = "") -> None:
        """It is disarmed: have it opened under another id, so that it can be armed again."""
        route.disarm(why, reason)
        if route.proposed_here:
            self._propose(route)

    def _disarm_as_it_stood_still(self, where: Standstill) -> None:
        for route in self._routes():
            self.disarm(route, Disarmed.LEASE, where.value)

    # --- consoles of this side

    def seen(self, console: Hashable, *, pressed: bool) -> None:
        """A console is there; `pressed`: its operator has pressed a key."""
        for route in self._routes():
            route.arming.seen(console, self._context.now(), pressed=pressed)

    def gone(self, console: Hashable) -> None:
        """A console is gone: disarm what it armed. `rsb-console arm` goes because no key came in time, too."""
        for route in self._routes():
            if route.arming.held and route.arming.console == console:
                self.disarm(route, route.arming.overdue(self._context.now()) or Disarmed.CONSOLE_GONE)

    def disarm_all(self, why: Disarmed) -> None:
        """Disarm whatever is armed."""
        for route in self._routes():
            self.disarm(route, why)

    def tick(self) -> None:
        """Once a second: disarm what is overdue, and tell the other side of keys."""
        now = self._context.now()
        for route in self._routes():
            arming = route.arming
            if (why := arming.overdue(now)) is not None:
                self.disarm(route, why)
            elif arming.take_press():
                self._peer.send(Arm(route.id, arming.by))

    # --- the other side

    def settled(self, message: Settled) -> None:
        """The peer publishes nothing of an opening any more that was disarmed."""
        for route in self._routes():
            route.settling.answered(message.route)

    def handle(self, route: Route, message: ArmingMessage) -> None:
        """Do what the peer says of an open route."""
        match message:
            case Arm():
                self._armed_there(route, self._peer_operators.says(message.who))
            case Armed():
                if route.arming.asked and self.lease.state.slow:
                    self.disarm(route, Disarmed.LINK_SLOW)
                elif route.arming.agreed(self._context.now()):
                    self._armed_by(route, route.arming.by)
                    route.armed()
            case Disarm():
                if route.arming.held:
                    route_id, why = route.id, _reason(message.cause)
                    if why is Disarmed.OPERATOR:
                        self._disarmed_by(route, self._peer_operators.says(message.who), from_peer=True)
                    self._ended(route, why)
                    route.settling.answered(route_id)

    def _armed_there(self, route: Route, who: str) -> None:
        """An operator there arms it, or has pressed a key."""
        arming, now = route.arming, self._context.now()
        if arming.held and arming.console is None:
            if arming.stands(now):
                arming.take(who, now)
            return
        if not arming.required or arming.spent or arming.armed or (arming.asked and self._peer.is_client):
            return  # of two operators who arm it at once, the client's does
        if not self._budget.take(1, now):
            self._refuse(route, Disarmed.TOO_OFTEN)
        elif not self.lease.supported:
            self._refuse(route, Disarmed.PEER_TOO_OLD)
        elif route.paused:
            self._refuse(route, Disarmed.PAUSED)
        else:
            self.lease.hold()
            arming.take(who, now)
            self._peer.send(Armed(route.id))
            self._armed_by(route, who, from_peer=True)
            route.armed()

    def _refuse(self, route: Route, why: Disarmed) -> None:
        self._peer.send(Disarm(route.id, why))
        route.arming.end(why)
        if route.proposed_here:
            self._propose(route)

    def _armed_by(self, route: Route, who: str, *, from_peer: bool = False) -> None:
        self._record(EventCode.OPERATOR_ARMED, route, who, "disarmed", "armed", from_peer=from_peer)

    def _disarmed_by(self, route: Route, who: str, *, from_peer: bool = False) -> None:
        self._record(EventCode.OPERATOR_DISARMED, route, who, "armed", "disarmed", from_peer=from_peer)

    def _record(self, code: EventCode, route: Route, who: str, old: str, new: str, *, from_peer: bool) -> None:
        """An operator's doing. The budget of armings bounds these events; what the other side says is marked so."""
        text = f"{new}, {who}" if from_peer else f"{new} by {who or 'an operator'}"
        route.log(Level.WARNING, code, text, who=who, old=old, new=new, from_peer=from_peer)


def _local(route: Route) -> tuple[bool, str]:
    """What this side's operators call it, whatever the other side's do."""
    return route.outgoing, route.local_topic


def _reason(cause: str) -> Disarmed:
    """Why the peer disarms; one that is not known is a newer peer's."""
    return Disarmed(cause) if cause in Disarmed.__members__.values() else Disarmed.OPERATOR
