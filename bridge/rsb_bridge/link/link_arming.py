"""Arming and disarming a link's routes on both sides, and the lease of its connection (PROTOCOL.md, 7 and 7.2)."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.by_hand import can_end, end_text, smallest_limits
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import account
from rsb_bridge.model.demands import (
    NO_DEMAND,
    PEER_DEMANDS,
    Demands,
    DemandSource,
    default_max_age,
    full_type,
    smallest_max_age,
)
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.arming import AGREED, ANSWERED_WITHIN, HELD, ArmingEvent, ArmingPhase, Disarmed
from rsb_bridge.route.lease import BEAT, LeaseHalf, LeasePhase
from rsb_bridge.tasks import NOT_TOO_EARLY
from rsb_bridge.wire import messages as wire
from rsb_bridge.wire.messages import Arm, Armed, Disarm

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.model.demands import Demand
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Accept, ArmingMessage, Settled

_LOOK_EVERY = 0.02
"""s between looks whether a route is open: an operator waits so much longer at most. A round figure."""
_AT_ONCE, _A_SECOND = 20.0, 1 / 30
"""Armings by one link's peer: each is in the log, so more than people need are refused."""
DROPPED: Final = "arm_dropped"
"""The cause of a `Disarm` by which a side says that its operator has dropped a demand: it disarms nothing."""


class ArmingProblem(Wording):
    """Reasons why a topic cannot be armed."""

    CANNOT = "{topic} cannot be armed: {why}"
    NOT_OPEN = (
        f"the other side has not opened it within {ANSWERED_WITHIN:g} s: look at the link with `rsb-console status`, "
        "and try again"
    )
    WITHDRAWN = "{topic} is not armed: it was disarmed meanwhile, or the console that asked for it is gone"


@dataclass(eq=False, slots=True)
class WaitingCommand:
    """A console's command that takes a while before it arms a route."""

    key: str
    console: Hashable
    withdrawn: bool = False  # it is to arm nothing: the console is gone, or the route was disarmed meanwhile


class LinkLease:
    """Keeps a link's lease as long as anything is armed (PROTOCOL.md, 7.2): numbers to and from the other side."""

    def __init__(self, link: BaseLink, arming: LinkArming) -> None:
        self.state = LeaseHalf(link.context.clock.steady, link.context.ros.turns, self._over)
        self._loop = link.context.loop
        self._link = link
        self._arming = arming
        self._was_alive = False
        self._timer: asyncio.TimerHandle | None = None

    def hold(self) -> None:
        """Keep the lease from now on, for a route that is about to be armed, and send a number at once."""
        self._end()  # if it was noticed just now: the end that `_over` has planned would hit the new arming
        if self.state.phase is LeasePhase.OFF:
            self.state.begin()
        self._send()
        if self._timer is None:
            self._timer = self._loop.call_later(BEAT, self._beat)

    def handle(self, message: wire.Lease) -> None:
        """Take a number of the other side. A side that has not heard any yet is answered at once."""
        state = self.state
        was_alive, had_begun = state.alive, state.begun
        state.hear(message.number, message.echo)
        lives = state.alive and not was_alive
        if state.phase is not LeasePhase.OFF and (lives or not message.echo):
            self._send()
        if state.alive and state.begun and not (was_alive and had_begun):  # also after each time that it has lapsed
            self._arming.lives()

    def stop(self) -> None:
        """End the lease with the connection."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.state.end()

    def _beat(self) -> None:
        self._timer = None
        if not any(route.arming.held for route in self._link.routes.values()):
            self.state.end()
            return
        self._send()
        self._watch()
        self._arming.end_overdue()
        if self.state.phase is not LeasePhase.OVER and self._timer is None:  # a number that comes late ends the lease
            self._timer = self._loop.call_later(BEAT, self._beat)

    def _watch(self) -> None:
        """Notice at once when it lapses: a beat later, a robot would have gone on for a quarter of a second."""
        left, was_alive = self.state.lasts_for, self._was_alive
        self._was_alive = left > 0
        if was_alive and not self._was_alive:
            self._arming.lapsed()
        elif 0 < left < BEAT:
            self._loop.call_later(left + NOT_TOO_EARLY, self._watch)

    def _send(self) -> None:
        lease = wire.Lease(*self.state.beat())
        # The first numbers of a lease go in order only, lest one that came late began the next lease on one side.
        if lease.echo:
            self._link.send_urgent(lease)
        else:
            self._link.send(lease)

    def _over(self) -> None:
        """Disarm all routes at the next turn of the loop: the caller may be in the midst of publishing."""
        self._loop.call_soon(self._end)

    def _end(self) -> None:
        if self.state.over is not None and self.state.phase is LeasePhase.OVER:
            # First: how long the other side may still publish is forgotten with the lease.
            self._arming.disarm_all(Disarmed.LEASE, self.state.over.value)
            self.stop()


class LinkArming:
    """Arms and disarms routes for the operators of both sides.

    Args:
        propose: reopens a route that this side proposes.
    """

    def __init__(self, link: BaseLink, peer_operators: PeerOperators, propose: Callable[[Route], None]) -> None:
        self._context = link.context
        self._link = link
        self._peer_operators = peer_operators
        self._propose = propose
        self._budget = TokenBucket(_AT_ONCE, _A_SECOND, self._context.now())
        self._waiting: list[WaitingCommand] = []
        self.lease = LinkLease(link, self)

    def _routes(self) -> tuple[Route, ...]:
        return tuple(self._link.routes.values())  # routes come and go with what is done to them

    def _held(self) -> list[Route]:
        # What has to be armed is never idle.
        return [route for route in self._link.awake if route.arming.phase in HELD]

    # --- which routes have to be armed

    def opened(self, route: Route) -> None:
        """Prepare a new opening of a route, which begins disarmed."""
        arming, proposal = route.arming, route.proposal
        arming.opened(required=proposal.arm, deadman=proposal.deadman)
        arming.lease = self.lease.state
        own = arming.own = self._own(route)
        # A proposal of this side has its own demands; the peer's come with Accept.
        arming.peer_arm = proposal.arm and not route.proposed_here
        arming.peer_on_end = "" if route.proposed_here else _suiting(route, proposal.on_end)
        arming.peer_limits = None if route.proposed_here else proposal.limits
        arming.demand(required=own.arm, deadman=own.deadman)
        self._say_who_demands(route)
        if arming.required:  # begun now, since the operator who arms it waits for it, up to a second
            self._context.load_type(full_type(route.proposal.type))

    async def load_type(self, route: Route) -> None:
        """Load the type of a route's messages before it is armed: from then on the loop must not stand still."""
        await self._context.load_type(route.half.carried.type_name or full_type(route.proposal.type))

    def demanded(self, route: Route) -> dict[str, Any]:
        """Return this side's demand for the present opening, as fields of a proposal."""
        own, max_age = route.arming.own, self.max_age(route)
        return {"arm": own.arm, "deadman": own.deadman, "max_age": max_age, "on_end": own.on_end, "limits": own.limits}

    def max_age(self, route: Route) -> float | None:
        """Return what this side's session, and the proposal of a route that it proposes, demand of messages' age."""
        return smallest_max_age((route.proposal.max_age, route.arming.own.max_age))

    def accepted(self, route: Route, message: Accept) -> None:
        """Take what the other side demands, which accepts an opening."""
        route.arming.demand(required=message.arm, deadman=message.deadman)
        route.arming.peer_arm, route.arming.peer_on_end = message.arm, _suiting(route, message.on_end)
        route.arming.peer_limits = message.limits
        self._say_who_demands(route)

    def renew_demand(self, route: Route) -> bool:
        """Apply this side's present session to a route; return whether the route has to be reopened."""
        if not route.id:
            return False
        own, before = self._own(route), route.arming.own
        if own is before is NO_DEMAND:  # as on most of hundreds of routes: there is nothing to say
            return False
        # The acceptor has named its limit in Accept, which comes once in an opening; the proposer sends an Amend.
        if not route.proposed_here and own.max_age != before.max_age:
            return True
        agreed = before.arm, before.deadman, before.on_end, before.limits
        if (own.arm, own.deadman, own.on_end, own.limits) != agreed:
            return True
        route.arming.own = own
        self._say_who_demands(route)
        return False

    def keep_demand(self, name: str, topic: Topic) -> None:
        """Demand for a name of this side what an entry demands that the other side's session lists."""
        max_age, on_end = default_max_age(topic.max_age, armed=True), end_text(topic.on_end)
        source = DemandSource(
            ("", name), name, topic.deadman_seconds, max_age=max_age, on_end=on_end, limits=topic.limits
        )
        self._context.demands.keep(source)

    def demand_dropped(self, source: DemandSource) -> None:
        """Tell the other side that an operator of this side drops a demand on names of its routes."""
        demands = Demands([source])
        for route in self._routes():
            if route.id and self.demand_on(route, demands) is not None:
                self._link.send(Disarm(route.id, DROPPED, acting_operator()))

    def demand_on(self, route: Route, demands: Demands) -> Demand | None:
        """Return what this side's session, or some lines of it, demands of a route's names."""
        if not route.purpose.in_graph:
            return None
        # A server's session may call a topic as the client does.
        client, far = ("", "") if self._link.is_client else (self._link.name, route.far_topic)
        kind, type_name = route.spec.kind, route.proposal.type
        return demands.of(kind, route.local_topic, type_name, client=client, client_name=far)

    def _own(self, route: Route) -> Demand:
        return self.demand_on(route, self._context.demands.read()) or NO_DEMAND

    def _say_who_demands(self, route: Route) -> None:
        """Name the lines that demand arming, and the limits of messages by hand, for operators."""
        arming, origin = route.arming, self._context.demands.origin
        peers = (PEER_DEMANDS,) if arming.required else ()
        arming.demanded_by = tuple(map(origin, arming.own.sources)) or peers
        found = [(origin(each), each.limits) for each in arming.own.limited_by] + [(PEER_DEMANDS, arming.peer_limits)]
        arming.limits = whole = smallest_limits((arming.own.limits, arming.peer_limits))
        arming.limited_by = tuple(line for line, each in found if whole and each and each.are_in(whole))

    # --- operators of this side

    async def arm(self, route: Route, console: Hashable, *, shared: bool = False) -> None:
        """Arm a route for a console of this side; return once both sides count it as armed.

        Args:
            shared: whether messages by hand of that operator's other consoles pass, too.

        Raises:
            LinkError: it cannot be armed now.
        """
        arming, topic = route.arming, route.local_topic
        if why_not := self._why_not(route):
            raise LinkError(ArmingProblem.CANNOT(topic=topic, why=why_not))
        answered = asyncio.Event()
        who = acting_operator()
        # In this order: `ask` notes from which number on messages count, and Lease precedes Arm (PROTOCOL.md, 7.2).
        self.lease.hold()
        arming.ask(who, console, self._context.now(), answered.set, account=account(), shared=shared)
        self._link.send(Arm(route.id, who))
        await answered.wait()
        agreed = arming.phase in AGREED
        if not (agreed and arming.console == console):
            raise LinkError(f"{topic} is not armed: {f'{arming.by} armed it' if agreed else arming.reason}")

    @contextmanager
    def waiting(self, route: Route, console: Hashable) -> Iterator[WaitingCommand]:
        """Have a console's command, which is to arm a route, withdrawn if the console goes or the route is disarmed.

        Raises:
            LinkError: at the end, if it was withdrawn.
        """
        command = WaitingCommand(route.key, console)
        self._waiting.append(command)
        try:
            yield command
        finally:
            self._waiting.remove(command)
        if command.withdrawn:
            raise LinkError(ArmingProblem.WITHDRAWN(topic=route.local_topic))

    def withdraw(self, route: Route, console: Hashable | None) -> None:
        """Withdraw the waiting commands for a route, of one console or, with None, of all."""
        for command in self._waiting:
            command.withdrawn |= command.key == route.key and console in (None, command.console)

    async def until_open(self, route: Route, command: WaitingCommand) -> None:
        """Wait until a route is open that was disarmed, or is being set up, so that it can be armed; not for long."""
        until = self._context.now() + ANSWERED_WITHIN
        while self._context.now() < until and not command.withdrawn:
            if not self._link.linked or route.life.refusal or route.pausing.paused:
                return
            opens = route.arming.phase is ArmingPhase.SPENT or not route.life.accepted
            if not (opens and route in self._routes()):
                return
            await asyncio.sleep(_LOOK_EVERY)

    def _why_not(self, route: Route) -> str:
        arming = route.arming
        if not self._link.linked:
            return self._link.down_reason or "the link is down"
        if not route.life.accepted:
            return str(route.life.refusal) or ArmingProblem.NOT_OPEN()
        if not arming.required:
            return "neither session demands arming"
        if route.pausing.paused:
            return "it is paused; resume it first"
        if arming.held:
            return f"{arming.by} has armed it already"
        return ArmingProblem.NOT_OPEN() if arming.phase is ArmingPhase.SPENT else ""

    def disarm(self, route: Route, why: Disarmed, reason: str = "") -> None:
        """Disarm a route on both sides, if it is armed."""
        if not route.arming.held:
            return
        who = acting_operator() if why is Disarmed.OPERATOR else ""
        message = Disarm(route.id, why, who)
        if why is Disarmed.PAUSED:
            self._link.send(message)  # its Pause would come after it, to an opening that is over
        else:
            self._link.send_urgent(message)
        self._ended(route, why, f"disarmed by {who}" if who else reason)
        if why is Disarmed.OPERATOR:  # recorded once the other side publishes nothing more
            route.settling.then(lambda: self._record(route, who, armed=False))

    def _ended(self, route: Route, why: Disarmed, reason: str = "") -> None:
        """Disarm it, and reopen it under another id, so that it can be armed again."""
        route.disarm(why, reason)
        if route.proposed_here:
            self._propose(route)

    # --- the lease

    def lives(self) -> None:
        """Let messages cross, as the two sides begin to hear each other."""
        for route in self._routes():
            self._open_if_begun(route)

    def _open_if_begun(self, route: Route) -> None:
        if self.lease.state.begun and route.arming.lives():
            route.armed()

    def lapsed(self) -> None:
        """Keep messages back, as the two sides do not hear each other; this disarms nothing yet."""
        for route in self._routes():
            if route.arming.phase is ArmingPhase.ARMED:
                route.half.lapse()

    def end_overdue(self) -> None:
        """Disarm overdue routes, and schedule the ones due before the next beat."""
        now = self._context.now()
        for route in self._held():
            if (why := route.arming.overdue(now)) is not None:
                self.disarm(route, why)
            elif (left := route.arming.due_at - now) < BEAT:
                self._context.loop.call_later(left + NOT_TOO_EARLY, self.end_overdue)

    # --- consoles of this side

    def seen(self, console: Hashable, *, pressed: bool) -> None:
        """Note that a console is attached; `pressed` means that its operator has pressed a key."""
        for route in self._routes():
            route.arming.seen(console, self._context.now(), pressed=pressed)

    def gone(self, console: Hashable) -> None:
        """Disarm the routes that a detached console has armed. `rsb-console arm` detaches if no key comes in time."""
        for command in self._waiting:
            command.withdrawn |= command.console == console
        for route in self._routes():
            if route.arming.held and route.arming.console == console:
                self.disarm(route, route.arming.overdue(self._context.now()) or Disarmed.CONSOLE_GONE)

    def disarm_all(self, why: Disarmed, reason: str = "") -> None:
        for route in self._routes():
            self.disarm(route, why, reason)

    def tick(self) -> None:
        """Disarm overdue routes, and tell the other side of keys, once a second."""
        self.end_overdue()
        for route in self._held():
            if route.arming.take_press():
                self._link.send(Arm(route.id, route.arming.by))

    # --- the other side

    def settled(self, message: Settled) -> None:
        """Note that the peer publishes nothing more of a disarmed opening."""
        for route in self._routes():
            route.settling.answered(message.route)

    def handle(self, route: Route, message: ArmingMessage) -> None:
        """Act on the peer's message about an open route."""
        match message:
            case Arm():
                self._armed_there(route, self._peer_operators.says(message.who))
            case Armed():
                if route.arming.phase is ArmingPhase.ASKED and self.lease.state.slow:
                    self.disarm(route, Disarmed.LINK_SLOW)
                elif route.arming.agreed(self._context.now()):
                    self._record(route, route.arming.by, armed=True)
                    self._open_if_begun(route)
            case Disarm() if message.cause == DROPPED:
                self._peer_operators.dropped_demand(route, message.who)
            case Disarm():
                if route.arming.held:
                    route_id, reason = route.id, ""
                    # An unknown cause comes from a newer version.
                    known = message.cause in Disarmed.__members__.values()
                    why = Disarmed(message.cause) if known else Disarmed.OPERATOR
                    if why is Disarmed.OPERATOR:
                        who = self._peer_operators.says(message.who)
                        reason = f"disarmed ({who})"
                        self._record(route, who, armed=False, from_peer=True)
                    self._ended(route, why, reason)
                    route.settling.answered(route_id)  # the side that disarms has stopped already, and sends no Settled

    def _armed_there(self, route: Route, who: str) -> None:
        arming, now = route.arming, self._context.now()
        arming.pressed_there(who, now)  # a further Arm tells of a key (PROTOCOL.md, 7)
        if not arming.required or not arming.admits(ArmingEvent.ARM_THERE):
            return
        if arming.phase is ArmingPhase.ASKED and self._link.is_client:
            return  # of two operators who arm it at once, the client's does
        if not self._budget.take(1, now):
            self._refuse(route, Disarmed.TOO_OFTEN)
        elif route.pausing.paused:
            why = Disarmed.PAUSED
            self._refuse(route, why)
            route.log(Level.WARNING, EventCode.ROUTE_NOT_ARMED, f"not armed: {why.text} ({who})", cause=why)
        else:
            self.lease.hold()  # first: a Lease goes right before Armed (PROTOCOL.md, 7.2)
            arming.arm_for_peer(who, now)
            self._link.send(Armed(route.id))
            self._record(route, who, armed=True, from_peer=True)
            self._open_if_begun(route)

    def _refuse(self, route: Route, why: Disarmed) -> None:
        self._link.send(Disarm(route.id, why))
        route.arming.end(why)
        if route.proposed_here:
            self._propose(route)

    def _record(self, route: Route, who: str, *, armed: bool, from_peer: bool = False) -> None:
        """Record that an operator has armed or disarmed a route. The budget of armings bounds these events."""
        code = EventCode.OPERATOR_ARMED if armed else EventCode.OPERATOR_DISARMED
        old, new = ("disarmed", "armed") if armed else ("armed", "disarmed")
        text = f"{new}, {who}" if from_peer else f"{new} by {who or 'an operator'}"
        route.log(Level.WARNING, code, text, who=who, old=old, new=new, from_peer=from_peer)


def _suiting(route: Route, on_end: str) -> str:
    """Return how the peer wants an arming to end, or an empty string if that means nothing for the route."""
    return on_end if can_end(route.spec.kind, on_end) else ""
