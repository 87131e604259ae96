"""A route: the bridging of one name over one link. This module has the part that all kinds of routes share.

A topic's two halves are `rsb_bridge.route.outgoing` and `rsb_bridge.route.incoming`, which share `TopicRoute`. The two
halves of a service, an action or a node's parameters are in `rsb_bridge.route.calls`. `advance` does every step that is
possible now and may be called at any time, so ROS, the peer and the sockets may become ready in any order.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Unpack

import msgspec

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.reason import NO_REASON, Reason
from rsb_bridge.model.session import HIGHEST, weight_of
from rsb_bridge.model.snapshot import Level, RouteSnapshot, State
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import LASTING
from rsb_bridge.route.age import MessageAge
from rsb_bridge.route.arming import AGREED, Arming, Disarmed, Settling
from rsb_bridge.route.blocking_rules import LossyPath, judge
from rsb_bridge.route.combined_verdict import CombinedVerdict
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.idling import Idling
from rsb_bridge.route.lifecycle import Lifecycle, PauseState, Reopening, RouteEvent
from rsb_bridge.route.notices import ChannelLosses, Notices
from rsb_bridge.route.peer import Peer
from rsb_bridge.route.rate_limit import RateLimit, limits_changed
from rsb_bridge.telemetry.meters import RateMeter
from rsb_bridge.wire.messages import Close, Propose

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.cdr.description import CompareTypes
    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.channel.channel import DataChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import Stage
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.blocking_rules import Rules
    from rsb_bridge.route.idling import Signs, Timetable
    from rsb_bridge.telemetry.event_log import About
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.records import CallsReport, ReceivedReport, SentReport


_LASTS = frozenset({State.OK, State.WAITING, State.UNHEARD, State.PAUSED, State.STALE, State.STOPPED, State.DOWN})
"""States that last until something happens, or until silence has lasted too long."""


class Owner(Peer, Protocol):
    """The link that a route belongs to."""

    timetable: Timetable[Route]

    def report_soon(self, route: Route) -> None:
        """Send a route's counts before the next regular report. May be called for every batch."""

    def open_channel(self, route: Route) -> None:
        """Begin to open `route.channel`. For streams, a server waits for the client's instead."""

    @property
    def compare_types(self) -> CompareTypes:
        """Asks the other side how its versions of a route's types differ."""


class Route:
    """A route's half on this side. Lives across reconnects; `id` is that of the present opening.

    It has more than 40 methods because 23 of them are hooks, which each kind of half fills in or leaves as they are.
    The others act on several of its parts at once; a question about one part goes to the part.

    Attributes:
        key: its name in commands.
        spec: the topic's entry, as the client sees it.
        topic: its name on the sending side; for calls, here and below, the callers' side.
        remote_topic: its name on the receiving side.
        local_topic: its name on this side.
        far_topic: its name on the other side.
        from_client: whether the client sends.
        proposed_here: whether this side opens it again after a reconnect.
        pattern: pattern of this side's session that created it, or an empty string.
        id: route id on the present connection, or 0 if it is not open.
        own: this side's proposal of it, which waits because the same proposal of the other side is open, or None.
        instance: id of the peer's process in its present or last opening.
        life: phase of the agreement between the two sides.
        pausing: whether an operator of either side has paused it.
        settling: whether the other side may still publish messages from before it was disarmed.
        closed_ids: ids of its last openings on the present connection, the oldest first.
        endpoints: others' publishers of the topic on the sending side, their subscriptions on the receiving side; of
            calls, the clients and the servers.
        weight: of its share of the link.
        idle: whether it needs no tick now, as nothing has happened: then it is neither reported nor shown again.
        peer_report: type of the reports that the other side's half sends.
        rules: of its verdict.
        never_idle: whether it is ticked each second, whatever happens.
    """

    peer_report: ClassVar[type[SentReport | ReceivedReport | CallsReport]]
    rules: ClassVar[Rules[Any]]
    outgoing: ClassVar[bool]
    duplex: ClassVar[bool] = False
    never_idle: ClassVar[bool] = False

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        self.context = context
        self.peer = peer
        self.spec = spec
        self.proposal = proposal
        self.purpose = purposes()[proposal.purpose]
        self.ends = context.ends(self.purpose)
        self.topic = proposal.topic
        self.remote_topic = proposal.remote_topic
        ends = self.topic, self.remote_topic
        self.local_topic, self.far_topic = ends if self.outgoing else ends[::-1]
        self.weight = route_weight(proposal, armed=False)
        self.from_client = proposal.from_client
        self.transport = context.transports[proposal.transport]
        self.proposed_here = proposed_here
        self.key = route_key(peer.name, proposal)
        self.pattern = ""
        self.id = 0
        self.own: Propose | None = None
        self.instance = ""
        self.life = Lifecycle()
        self.opened_at = 0.0
        self.closed_ids: deque[int] = deque()
        self.reopening = Reopening()
        self.notices = Notices(self.log, context.wall)
        self.limit = RateLimit(proposal.max_rate, self.log)
        self.pausing = PauseState(peer.revisions, paused=proposal.paused, is_client=peer.is_client)
        self.pausing.changed = self._paused
        self.arming = Arming()
        self.settling = Settling(context.loop, self.judge_again)
        self.age = MessageAge(context, peer)
        self.channel: DataChannel | None = None
        self.type_name = ""
        self.type_hash = ""
        self.endpoints: Sequence[Endpoint] = ()
        self.losses = ChannelLosses()
        self.idle = False
        self.idling = Idling(context.now())
        peer.timetable.add(self)
        self._verdict: Verdict | None = None  # None: it has to be judged
        self._lossy_path = LossyPath()
        self._shown_of_features: dict[str, Any] = {}
        self.judged = CombinedVerdict(sends=self.outgoing, peer_name="server" if peer.is_client else peer.name)
        self.meter = RateMeter(context.now())
        self.release_port: Callable[[], None] | None = None
        self._waiters: list[asyncio.Future[None]] = []

    # --- differences between the halves

    def _advance(self) -> None:
        """Do what can be done next."""
        raise NotImplementedError

    def flush(self) -> None:
        """Send more, as the channel has room again. A half that sends nothing ignores it."""

    def deliver(self, messages: Sequence[Message]) -> None:
        """Take whole, authentic messages. A half that only sends gets none: the peer does not even have its key."""

    def news(self) -> SentReport | ReceivedReport | CallsReport | None:
        """Return the report for the peer, or None if the peer knows everything."""
        raise NotImplementedError

    def reported(self, report: Any) -> None:
        """Take a report of the peer, a `peer_report`."""
        raise NotImplementedError

    def _may_flow(self) -> None:
        """Restart all measurements over time, because messages may cross from now on."""

    def stages(self) -> tuple[Stage, ...]:
        """Return the steps of a message's or a call's path."""
        raise NotImplementedError

    @property
    def came(self) -> bool:
        """Whether messages or calls came in this opening, or the receiving side keeps some of a latched topic."""
        raise NotImplementedError

    @property
    def came_before(self) -> bool:
        """Whether messages or calls came in an earlier opening, and none in this one."""
        raise NotImplementedError

    @property
    def owing(self) -> bool:
        """Whether messages or answers are on their way to the other side, or wait for the channel."""
        return False

    @property
    def large_vanish(self) -> bool:
        """Whether none of its last large datagrams has arrived, while smaller ones do."""
        return False

    @property
    def breaking(self) -> str:
        """The reason why its channel breaks before anything arrives, or an empty string."""
        return self.losses.repeated

    def _measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        """Update what the verdict follows from. Called first in a tick."""

    def _follow(self, now: float, crossing: Crossing) -> None:
        """Do what follows from the new verdict. Called last in a tick."""

    def snapshot(self) -> RouteSnapshot:
        """Return the present state of the route."""
        raise NotImplementedError

    # --- common to all routes

    def advance(self) -> None:
        """Do what can be done next: ROS, the peer, the sockets or an operator may have changed something."""
        self._advance()
        if self.idling.missed(self._signs, self.context.now()):
            self.wake()
        self._tell_waiters()

    async def changed(self) -> None:
        """Wait until it has advanced or is closed. Whether messages can cross changes with nothing else."""
        self._waiters.append(waiter := self.context.loop.create_future())
        await waiter

    def _tell_waiters(self) -> None:
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)
        self._waiters.clear()

    def on_accepted(self) -> None:
        """Go on after both sides have accepted the route."""
        if self.life.handle(RouteEvent.ACCEPT):
            self.advance()

    def set_peer_topic(self, topic: str) -> None:
        """Take the topic's name on the peer's side."""
        self.far_topic = topic
        if self.outgoing:
            self.remote_topic = topic
        else:
            self.topic = topic

    @property
    def on_end(self) -> str:
        """The message that the receiving side publishes once an arming ends, or an empty string until it names one."""
        return ""

    @property
    def velocity(self) -> Velocity | None:
        """The velocity that the receiving side has published last, or None if it is unknown."""
        return None

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        """The types of its messages; of calls, also the types of their requests and responses."""
        return (TypeVersion(self.type_name, self.type_hash),)

    # --- opening and closing

    def open(self, route_id: int) -> None:
        """Begin a new opening on the present connection."""
        self.id = route_id
        self.instance = self.peer.instance
        self.opened_at = self.context.now()
        self.limit.opened()
        self.judge_again()
        self.life.handle(RouteEvent.OPEN)
        # The other side's verdict belongs to the opening before.
        self.judged.receive(None, self.context.now())
        self._may_flow()

    @property
    def listed(self) -> bool:
        """Whether this side's session lists it by its name."""
        return self.own is not None or (self.proposed_here and not self.pattern and self.purpose.in_graph)

    def follow(self, proposal: Propose) -> None:
        """Have the other side's proposal open it, as both sessions list the same."""
        self.own, self.proposal, self.proposed_here = self.proposal, proposal, False

    def lead(self) -> None:
        """Propose it from this side again, if its session lists it."""
        if self.own is not None:
            self.proposal, self.own, self.proposed_here = self.own, None, True

    def close(self, reason: str) -> None:
        """End the present opening; state that outlives openings stays."""
        # First, while the opening has its id: the other side's `Settled` names it.
        if self.arming.held:
            self.disarm(Disarmed.REOPENED if self.peer.linked else Disarmed.LINK_LOST)
        if self.channel is not None:
            path, self.channel = self.channel, None
            path.close(reason)
        if self.release_port is not None:
            self.release_port()
            self.release_port = None
        self.peer.closed(self.id)
        self.id = 0
        self.notices.closed()
        self.judged.receive(None, self.context.now())
        self.judge_again()
        self.life.handle(RouteEvent.CLOSE)
        self.reopening.closed_at = self.context.now()
        self._tell_waiters()

    def destroy(self) -> None:
        """End it for good, with its endpoints."""
        self.close("removed")
        self.losses.forget_report()
        self.peer.timetable.remove(self)

    def refuse(self, code: EventCode, reason: Reason) -> None:
        """Refuse the route; this side tries again later if it proposed it."""
        self.notices.error(code, str(reason))
        self._end(reason)
        # A Close is no refusal: the route opens again, which usually solves the problem.
        self.reopening.refused = NO_REASON if code == EventCode.ROUTE_CLOSED else reason

    def _end(self, reason: Reason) -> None:
        """End the present opening and show the reason; this side opens it again later if it proposed it."""
        # One that another program refuses, or that lacks a descriptor, has a cause of its own.
        broke = reason.broke and (self.connected or reason.timed_out)
        self.close(str(reason))
        self.life.handle(RouteEvent.REFUSE, reason)
        self.reopening.failed(self.context.now(), broke=broke)

    def away(self) -> None:
        """Wait, as the link has no connection and its session goes on."""
        self.judge_again()

    def back(self) -> None:
        """Go on, as the session has another connection."""
        self.judge_again()

    @property
    def outlives(self) -> bool:
        """Whether it stays open while the link is away."""
        return self.life.accepted and self.resumes

    @property
    def resumes(self) -> bool:
        """Whether it stays open when its connection is lost, and goes on on the next one."""
        return not self.arming.required  # a break disarms what moves robots

    @property
    def resends(self) -> bool:
        """Whether it sends lost messages again, as calls and reliable topics do."""
        return True

    @property
    def lossy(self) -> bool:
        """Whether its channel may lose messages of an opening for good."""
        return not self.transport.reliable and not (self.resumes and self.resends)

    def channel_lost(self, reason: Reason) -> None:
        """Open the route again after its channel broke. It is an error only if the link survives."""
        if self.id:
            # Asked first: a closed opening owes nothing.
            connection, owing = self.peer.connections, self.owing
            # A side that disarms closes the channel; the closed channel may be noticed before the message about it.
            ends_with_arming = self.arming.required and not reason.timed_out
            if self.arming.held:
                self.disarm(Disarmed.CHANNEL_LOST)
            self._end_on_both_sides(reason)
            if ends_with_arming:
                return

            def report() -> None:
                if self.peer.linked and self.peer.connections == connection:
                    self.notices.error(EventCode.ROUTE_CHANNEL_LOST, str(reason))

            self.losses.add(reason, self.context.loop, report, owing=owing)

    def request_reopen(self, code: EventCode, reason: str, level: Level = Level.WARNING) -> None:
        """Close the route on both sides; its proposer opens it again, which usually solves the problem."""
        if self.id:
            self.notices.error(code, reason, level)
            self._end_on_both_sides(Reason(reason))

    def _end_on_both_sides(self, reason: Reason) -> None:
        route_id = self.id
        self._end(reason)
        self.peer.send(Close(route=route_id, reason=sanitize_text(reason.text), code=reason.code))

    def _paused(self, was: bool) -> None:
        """Go on after an operator has paused or resumed it; it stays set up."""
        paused = self.pausing.paused
        if paused != was:
            self.spec = msgspec.structs.replace(self.spec, paused=paused)
            self._may_flow()
            code = EventCode.ROUTE_PAUSED if paused else EventCode.ROUTE_RESUMED
            self.log(Level.INFO, code, "paused" if paused else "resumed")
        self.judge_again()
        self.advance()

    def armed(self) -> None:
        """Let messages cross, as both sides now agree that it is armed."""
        self.judge_again()
        self._may_flow()
        self.advance()

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Disarm this opening for good; `reason` replaces the usual text of `why`."""
        arming, lease = self.arming, self.arming.lease
        if arming.phase in AGREED and self.outgoing and lease is not None:
            self.settling.begin(self.id, lease.left)
        # `LinkArming` records an operator's disarm. Other causes are logged once nothing is published any more.
        if why is not Disarmed.OPERATOR:
            text = f"disarmed: {reason or why.text} ({arming.by} armed it)"
            self.settling.then(lambda: self.log(Level.WARNING, EventCode.ROUTE_DISARMED, text, cause=why))
        arming.end(why, reason)
        self.judge_again()

    def lapsed(self) -> None:
        """Act on the fact that nothing passes for now although it is armed: the sides do not hear each other."""

    def amend(self, spec: Topic, proposal: Propose) -> None:
        """Apply new limits; counts, endpoints and messages in transit stay."""
        changes = limits_changed(self.proposal, proposal)
        self.spec, self.proposal = spec, proposal
        self.weight = route_weight(proposal, armed=self.arming.required)
        self.limit.set_max_rate(proposal.max_rate)
        self.settle_age()
        self.judge_again()
        if changes:
            self.log(Level.INFO, EventCode.ROUTE_AMENDED, changes)

    def settle_age(self) -> None:
        """Apply both sides' age limits; called after each change of them."""
        demands = self.proposal.max_age, self.age.accepted, self.arming.own.max_age
        self.age.settle(demands, armed=self.arming.required, lifespan=self._lifespan)

    @property
    def _lifespan(self) -> float:
        """Lifespan (s) of what it carries, or 0 for none."""
        return 0.0

    def set_check(self) -> None:
        """Take over `check_messages` of the session."""

    # --- time

    def wake(self) -> None:
        """Have it ticked within a second, and for a while: something has happened to it."""
        self.idling.wake(self.context.now())
        if self.idle:
            self.rise()

    def rests(self, now: float) -> bool:
        """Whether it needs no tick at `now` (s): nothing has come since the last one, and nothing is due."""
        return now < self.idling.until and self._passed == self.idling.passed

    def rise(self) -> None:
        """Be ticked again: something has happened, or its time has come."""
        self.idle = False
        self._woken(self.peer.timetable.looked)
        self.peer.timetable.awake[self] = None

    @property
    def shows_the_same(self) -> bool:
        """Whether its last snapshot stays right until a message comes, it is woken or a feature shows another thing."""
        now = self.context.now()
        blank = self.rests(now) and self.meter.is_blank(now) and not self.judged.announced.verdict.lasting
        return blank and self.peer.route_fields(self) == self._shown_of_features

    def _woken(self, since: float) -> None:
        """Have the figures take over that nothing came until `since` (s)."""
        self.meter.rested(since)

    @property
    def _passed(self) -> int:
        """Messages or calls so far, each of which wakes it."""
        return self.meter.count

    def _signs(self) -> Signs:
        """Return what changes if anything happens to it, apart from messages and the passing of time."""
        return (
            self.id, self.judged.announced, self.judged.peer, self.endpoints, self.channel, self.connected,
            self.limit.rate, self.link_full, self.notices.last_error, self.notices.warning, self.notices.loop,
            self.life.phase, self.pausing.paused, self.peer.path.fault,
        )  # fmt: skip

    def _next_change(self, now: float, crossing: Crossing) -> float:
        """Return when (s) something changes by itself next, `now` if it may at any moment, or infinity."""
        # What is not open is proposed again, or given up. What it owes comes last: it takes longest to find out.
        restless = (
            self.never_idle or self._verdict is None or self._verdict.state not in _LASTS or not self.meter.still
            or self.arming.required or self.peer.linked != bool(self.id) or self.link_full is not None
            or self.peer.path.fault is not None or self.losses.reasons or self.owing
        )  # fmt: skip
        return now if restless else self.judged.next_change

    def tick(self) -> None:
        """Update the figures and report a changed verdict; called once a second while the route is not idle."""
        now, crossing, learns = self.context.now(), self.crossing, self.learns
        self._measure(now, crossing, learns=learns)
        self.meter.tick(now, learns=learns)
        connected = crossing.flows or self.connected
        self.reopening.observe(connected=connected, flowing=crossing.flows)
        if self.losses.reasons:  # nearly never, and the question what it owes takes a while
            self.losses.tick(now, idle=connected and not self.owing)
        self._verdict = own = self._judged(now, crossing)
        said = self.judged.announce(own, now, self.peer.path.fault)
        if said and self.purpose.in_graph:  # of an internal route, what has proposed it tells the operator
            shown, from_peer = self.judged.announced
            since = self.context.wall() - (now - self.judged.since(shown, now))
            about: About = {"cause": said.cause, "state": shown.state, "since": since, "from_peer": from_peer}
            self.log(said.level, said.code, said.text, **about)
        self._follow(now, crossing)
        # Last, so that the signs contain all that the tick has changed.
        self.idling.ticked(self._signs(), self._passed, now, self._next_change(now, crossing))

    @property
    def link_full(self) -> Fullness | None:
        """The rates of the link in the direction of this half, or None if it is not full."""
        return self.peer.fullness.out if self.outgoing else self.peer.fullness.into

    @property
    def learns(self) -> bool:
        """Whether its rate and delays are typical now, so that the usual values are learned from them."""
        return True

    # --- how it is

    def away_text(self) -> str:
        """Return why it carries nothing while it has no link, for an operator, perhaps with `LASTING`."""
        if self.peer.away_since is not None and self.life.accepted:
            return f"waiting {LASTING} for the link"
        return self.peer.down_reason or "the link is down"

    def trouble(self) -> Verdict | None:
        """Return the verdict on its channel if nothing gets through it now, or None."""
        return self.channel.trouble() if self.channel is not None else None

    @property
    def connected(self) -> bool:
        """Whether there is a path for messages; messages in transit when the route is paused still arrive."""
        return self.life.accepted and self.channel is not None and self.channel.ready

    @property
    def crossing(self) -> Crossing:
        """Whether messages may cross now, or the first reason why not."""
        if self.notices.loop:
            return Crossing.LOOP
        arming, armed = self.arming, Crossing.YES
        if arming.required:
            now = self.context.now()
            armed = arming.crossing(now)
            # A sending side whose deadman has run out stops at once; the tick that tells the other side comes later.
            if armed.is_unarmed and (self.settling.under_way or (self.outgoing and arming.has_run_out(now))):
                return Crossing.DISARMING
        if self.pausing.paused:
            return Crossing.PAUSED
        return armed if self.connected or armed.is_unarmed else Crossing.NOT_OPEN

    # --- verdict

    @property
    def shown_refusal(self) -> Reason:
        """The reason why it is refused or has ended, now or until shortly ago, or an empty one."""
        return self.reopening.shown_refusal(self.life, self.context.now() - self.opened_at if self.id else 0.0)

    def verdict(self) -> Verdict:
        """Return this side's verdict, made at the last tick or at a later change by an operator or the peer."""
        now = self.context.now()
        # A deadman that runs out between two ticks must not be shown as armed.
        if self._verdict is None or self.arming.overdue(now):
            self._verdict = self._judged(now, self.crossing)
        return self._verdict

    def _judged(self, now: float, crossing: Crossing) -> Verdict:
        return self._lossy_path.steady(judge(self, crossing, self.rules), self.peer.path.fault, now)

    def common_snapshot(self) -> partial[RouteSnapshot]:
        """Return the part of the snapshot that topics and calls share."""
        now, wall = self.context.now(), self.context.wall()
        self._shown_of_features = self.peer.route_fields(self)
        verdict, from_peer = self.judged.shown(self.verdict())
        return partial(
            RouteSnapshot,
            key=self.key,
            link=self.peer.name,
            topic=self.local_topic,
            remote_topic=self.far_topic,
            outgoing=self.outgoing,
            spec=self.spec,
            state=verdict.state,
            reason=verdict.said(now, wall),
            type_name=self.type_name,
            type_hash=self.type_hash,
            transport=self.transport.name,
            port=self.proposal.port or self.peer.shared_port(),
            stages=self.stages(),
            rate=self.meter.rate,
            expected_rate=self.limit.lowered(self.spec.expected_rate or self.meter.usual_rate),
            bytes_per_second=self.meter.bytes_per_second,
            bytes_total=self.meter.bytes,
            latency_uncertainty=self.peer.clock.uncertainty,
            last_at=None if self.meter.last is None else self.context.wall_of(self.meter.last),
            history=self.meter.history_at(now) if self.idle else tuple(self.meter.history),
            last_error=self.notices.last_error,
            last_error_at=self.notices.last_error_at,
            cause=verdict.cause,
            from_peer=from_peer,
            since=wall - (now - self.judged.since(verdict, now)),
            arming=self.arming.snapshot(now, self.on_end, self.velocity) if self.arming.required else None,
            allowed_rate=self.limit.allowed or None,
            pattern=self.pattern,
            messages_total=self.meter.count,
            max_age=self.age.max_age,
            limits=self.arming.limits,
            limited_by=self.arming.limited_by,
            purpose=self.purpose.name,
            features=self._shown_of_features,
        )

    def judge_again(self) -> None:
        """Make a new verdict when the next one is asked for, and within a second."""
        self._verdict = None
        self.wake()

    def log(self, level: Level, code: EventCode, text: str, **about: Unpack[About]) -> None:
        """Add an event about this route."""
        is_shown = self.purpose.is_shown
        if not is_shown and level is Level.INFO:
            return  # a view's beginning and end are logged with the topic that is looked at
        name = self.local_topic if is_shown else self.purpose.name
        about["link"], about["topic"] = self.peer.name, name
        self.context.log(level, code, f"{name}: {text}", **about)


def route_weight(proposal: Propose, *, armed: bool) -> int:
    """Return the weight of a route's share of the link: what moves robots, and calls, go ahead of all."""
    return weight_of(HIGHEST if armed or proposal.kind != "topic" else proposal.priority)


def route_key(link: str, proposal: Propose) -> str:
    """Return the key of a route on this side: the link, the direction and the topic's name on the sending side.

    The key of a service, an action or parameters also has the kind, as a service may share a topic's name. If the
    server adds a prefix that the client did not propose, the two sides' keys of a route that the server sends on
    differ. Keys do not cross the link: each side's commands and snapshots use its own.
    """
    kind = "" if proposal.kind == "topic" else f"{proposal.kind} "
    return f"{link} {'→' if proposal.from_client else '←'} {kind}{proposal.topic}"
