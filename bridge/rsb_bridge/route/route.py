"""A route: the two sides' agreement to bridge one name over one link. Its `rsb_bridge.route.half` carries it out.

`advance` does every step that is possible now and may be called at any time, so ROS, the peer and the sockets may
become ready in any order.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Unpack, final

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.fates import ARM_REQUIRED, Fate, Lost
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.reason import NO_REASON, Reason
from rsb_bridge.model.session import HIGHEST, weight_of
from rsb_bridge.model.snapshot import Level, RouteSnapshot, State
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import FINE, Cause
from rsb_bridge.route.age import MessageAge
from rsb_bridge.route.arming import AGREED, Arming, ArmingPhase, Disarmed, Settling
from rsb_bridge.route.blocking_rules import LossyPath, judge, stays_fine
from rsb_bridge.route.combined_verdict import CombinedVerdict
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.idling import STEADY_FOR, Idling
from rsb_bridge.route.lifecycle import Lifecycle, PauseState, Reopening, RouteEvent
from rsb_bridge.route.notices import ChannelLosses, Notices
from rsb_bridge.route.peer import Peer
from rsb_bridge.route.rate_limit import RateLimit, added_changed, limits_changed
from rsb_bridge.telemetry.meters import RateMeter
from rsb_bridge.wire.messages import Close, Propose

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.cdr.description import CompareTypes
    from rsb_bridge.context import Context
    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.fates import Fates
    from rsb_bridge.model.keep import Keep
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.half import Half
    from rsb_bridge.route.idling import Signs, Timetable
    from rsb_bridge.telemetry.event_log import About


_LASTS = frozenset(
    {
        State.OK, State.WAITING, State.UNHEARD, State.PAUSED, State.RESTING, State.STALE, State.STOPPED, State.DOWN,
    }
)  # fmt: skip
"""States that last until something happens, or until silence has lasted too long."""
_STOPS = frozenset({State.STALE, State.STOPPED, State.DOWN})
"""States in which messages that are due do not come."""
_STAYS = frozenset({Cause.NONE, Cause.NO_SUBSCRIBER})
"""Causes that `Route._signs` tell of, while the half is well."""


class Entry(NamedTuple):
    """One side's entry of a route.

    Attributes:
        topic: it with the client's names, as this side's session lists it or would list it.
        proposal: it with the sender's and the receiver's names.
    """

    topic: Topic
    proposal: Propose


class Owner(Peer, Protocol):
    """The link that a route belongs to."""

    timetable: Timetable[Route]

    def report_soon(self, route: Route) -> None:
        """Send a route's counts before the next regular report. May be called for every batch."""

    def open_channel(self, route: Route) -> None:
        """Begin to open the channel of its half. For streams, a server waits for the client's instead."""

    @property
    def compare_types(self) -> CompareTypes:
        """Asks the other side how its versions of a route's types differ."""


class Waiters:
    """Coroutines that wait until something has changed."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiting: list[asyncio.Future[None]] = []

    async def wait(self) -> None:
        """Wait until `tell` is called next."""
        self._waiting.append(waiter := self._loop.create_future())
        await waiter

    def tell(self) -> None:
        """Have those go on that wait."""
        for waiter in self._waiting:
            if not waiter.done():
                waiter.set_result(None)
        self._waiting.clear()


@final
class Route:
    """The agreement on one name. Lives across reconnects; `id` is that of the present opening.

    Attributes:
        key: its name in commands.
        here: the entry of this side's session that makes it, or None.
        there: the other side's entry that opens it, or None if this side's does.
        spec: the entry that this side shows: its own if it has one.
        proposal: the one that opens it: the other side's if it has one.
        topic: its name on the sending side; for calls, here and below, the callers' side.
        remote_topic: its name on the receiving side.
        local_topic: its name on this side.
        far_topic: its name on the other side.
        from_client: whether the client sends.
        proposed_here: whether this side opens it again after a reconnect.
        pattern: pattern of this side's session that created it, or an empty string.
        id: route id on the present connection, or 0 if it is not open.
        instance: id of the peer's process in its present or last opening.
        life: phase of the agreement between the two sides.
        pausing: whether an operator of either side has paused it.
        settling: whether the other side may still publish messages from before it was disarmed.
        closed_ids: ids of its last openings on the present connection, the oldest first.
        weight: of its share of the link.
        idle: whether it needs no tick now, as nothing has happened: then it is neither reported nor shown again.
        only_counts: whether nothing but figures, and what features show, may differ from its last snapshot.
        rested: callbacks; when the route wakes, each gets the time (s) until which nothing came.
        half: carries its messages or calls on this side.
    """

    def __init__(
        self,
        kind: type[Half],
        context: Context,
        peer: Owner,
        entry: Entry,
        *,
        proposed_here: bool,
    ) -> None:
        proposal = entry.proposal
        self.outgoing, self.duplex = kind.outgoing, kind.duplex
        self.context = context
        self.peer = peer
        self.enter(*((entry, None) if proposed_here else (None, entry)))
        self.purpose = purposes()[proposal.purpose]
        self.ends = context.ends(self.purpose)
        self.topic = proposal.topic
        self.remote_topic = proposal.remote_topic
        ends = self.topic, self.remote_topic
        self.local_topic, self.far_topic = ends if self.outgoing else ends[::-1]
        self.weight = route_weight(proposal, armed=False)
        self.from_client = proposal.from_client
        self.transport = context.transports[proposal.transport]
        self.key = route_key(peer.name, proposal)
        self.pattern = ""
        self.id = 0
        self.instance = ""
        self.life = Lifecycle()
        self.opened_at = 0.0
        self.closed_ids: deque[int] = deque()
        self.reopening = Reopening()
        self.notices = Notices(self.log, context.wall)
        self.limit = RateLimit(proposal.max_rate, self.log)
        self.pausing = PauseState(peer.revisions, paused=proposal.paused, is_client=peer.is_client)
        self.pausing.changed = self._pause_changed
        self.arming = Arming()
        self.settling = Settling(context.loop, self.judge_again)
        self.age = MessageAge(context, peer)
        self.losses = ChannelLosses()
        self.idle = False
        self.idling = Idling(context.now())
        peer.timetable.add(self)
        self._verdict: Verdict | None = None  # None: it has to be judged
        self._verdict_for_peer = FINE  # made together with the former
        self._lossy_path = LossyPath()
        self._shown_of_features: dict[str, Any] = {}
        self._shown_signs: Signs | None = None
        self.only_counts = False
        self.judged = CombinedVerdict(sends=self.outgoing, peer_name="server" if peer.is_client else peer.name)
        self.meter = RateMeter(context.now())
        self.rested = [self.meter.rested]
        self.release_port: Callable[[], None] | None = None
        # Told by `advance` and `close` alone: nothing else lets messages begin to cross.
        self.waiters = Waiters(context.loop)
        self.half = kind(self)  # last: it uses the rest
        # As they are, so that no message takes a call more.
        self.deliver, self.flush = self.half.deliver, self.half.flush

    # --- its entries

    def enter(self, here: Entry | None, there: Entry | None) -> None:
        """Take the entries of the two sides, of which one may be None."""
        first, last = (here or there), (there or here)
        assert first is not None
        assert last is not None
        self.here, self.there, self.proposed_here = here, there, there is None
        self.spec, self.proposal = first.topic, last.proposal

    @property
    def listed(self) -> bool:
        """Whether this side's session lists it by its name."""
        return self.here is not None and not self.pattern and self.purpose.in_graph

    # --- common to all routes

    def advance(self) -> None:
        """Do what can be done next: ROS, the peer, the sockets or an operator may have changed something."""
        self.half.proceed()
        if self.duplex:
            self._verdict = None  # of calls, by what `proceed` has just looked at; nothing has happened that wakes it
        if self.idling.missed(self._signs, self.context.now()):
            self.wake()
        self.waiters.tell()

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
        self.half.open()
        self.half.restart_measuring()

    def close(self, reason: str) -> None:
        """End the present opening; state that outlives openings stays."""
        self.half.close(reason)
        # First, while the opening has its id: the other side's `Settled` names it.
        if self.arming.held:
            self.disarm(Disarmed.REOPENED if self.peer.linked else Disarmed.LINK_LOST)
        self.half.carried.end(reason)
        if self.release_port is not None:
            self.release_port()
            self.release_port = None
        self.peer.closed(self.id)
        self.id = 0
        self.pausing.unpaused = 0
        self.notices.closed()
        self.judged.receive(None, self.context.now())
        self.judge_again()
        self.life.handle(RouteEvent.CLOSE)
        self.reopening.closed_at = self.context.now()
        self.waiters.tell()

    def destroy(self) -> None:
        """End it for good, with its endpoints."""
        self.close("removed")
        self.half.destroy()
        self.losses.forget_report()
        self.peer.timetable.remove(self)

    def refuse(self, code: EventCode, reason: Reason) -> None:
        """Refuse the route; this side tries again later if it proposed it."""
        self.notices.error(code, str(reason))
        self._end(reason)
        # A Close is no refusal: the route opens again, which usually solves the problem.
        self.reopening.refused = NO_REASON if code == EventCode.ROUTE_CLOSED else reason

    def _end(self, reason: Reason, *, tell: bool = False) -> None:
        """End the present opening and show the reason; this side opens it again later if it proposed it."""
        route_id = self.id
        # One that another program refuses, or that lacks a descriptor, has a cause of its own.
        broke = reason.broke and (self.connected or reason.timed_out)
        self.close(str(reason))
        self.life.handle(RouteEvent.REFUSE, reason)
        self.reopening.failed(self.context.now(), broke=broke)
        if tell:
            self.peer.send(Close(route=route_id, reason=sanitize_text(reason.text), code=reason.code))

    def suspend(self) -> None:
        """Wait, as the link has no connection and its association goes on."""
        self.judge_again()
        self.half.suspend()

    def resume(self) -> None:
        """Go on, as the association has another connection."""
        self.judge_again()
        self.half.resume()

    @property
    def fates(self) -> Fates:
        """The effect of each loss on it."""
        return ARM_REQUIRED if self.arming.required else self.half.facts.fates  # a break disarms what moves robots

    @property
    def lossy(self) -> bool:
        """Whether its channel may lose messages of an opening for good."""
        return not self.transport.reliable and self.fates[Lost.DATAGRAM] is Fate.LOSES

    def channel_lost(self, reason: Reason) -> None:
        """Open the route again after its channel broke. It is an error only if the link survives."""
        if self.id:
            # Asked first: a closed opening owes nothing.
            connection, owing = self.peer.connections, self.half.facts.owing
            # A side that disarms closes the channel; the closed channel may be noticed before the message about it.
            ends_with_arming = self.arming.required and not reason.timed_out
            if self.arming.held:
                self.disarm(Disarmed.CHANNEL_LOST)
            self._end(reason, tell=True)
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
            self._end(Reason(reason), tell=True)

    def _pause_changed(self, was: bool) -> None:
        """Act on a pause, its end, or a further revision of either (`PauseState`); the channel stays open."""
        paused = self.pausing.paused
        if was and not paused and self.id:  # until the provider has heard of it, it refuses calls
            self.pausing.unpaused = self.pausing.revision
        if paused != was:
            here, there = self.here, self.there
            topic = msgspec.structs.replace(self.spec, paused=paused)
            if here is not None:
                here = here._replace(topic=topic)
            elif there is not None:
                there = there._replace(topic=topic)
            self.enter(here, there)
            self.half.restart_measuring()
            code = EventCode.ROUTE_PAUSED if paused else EventCode.ROUTE_RESUMED
            self.log(Level.INFO, code, "paused" if paused else "resumed")
        self.judge_again()
        self.advance()

    def armed(self) -> None:
        """Let messages cross, as both sides now agree that it is armed."""
        self.judge_again()
        self.half.restart_measuring()
        self.advance()

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Disarm this opening for good; `reason` replaces the usual text of `why`."""
        self.half.disarm()
        arming, lease = self.arming, self.arming.lease
        if arming.phase in AGREED and self.outgoing and lease is not None:
            self.settling.begin(self.id, lease.left)
        # `LinkArming` records an operator's disarm. Other causes are logged once nothing is published any more.
        if arming.phase is ArmingPhase.ASKED and why is not Disarmed.OPERATOR:
            text = f"not armed: {reason or why.text} ({arming.by})"
            self.log(Level.WARNING, EventCode.ROUTE_NOT_ARMED, text, cause=why)
        elif why is not Disarmed.OPERATOR:
            text = f"disarmed: {reason or why.text} ({arming.by} armed it)"
            self.settling.then(lambda: self.log(Level.WARNING, EventCode.ROUTE_DISARMED, text, cause=why))
        arming.end(why, reason)
        self.judge_again()
        self.half.lapse()

    def amend(self, here: Entry | None, there: Entry | None) -> None:
        """Apply new limits; counts, endpoints and messages in transit stay."""
        before, spec = self.proposal, self.spec
        self.enter(here, there)
        changes = limits_changed(before, self.proposal)
        if spec.features != self.spec.features:
            changes = ", ".join(filter(None, (changes, added_changed(spec, self.spec))))
        self.weight = route_weight(self.proposal, armed=self.arming.required)
        self.limit.set_max_rate(self.proposal.max_rate)
        self.settle_age()
        self.judge_again()
        if changes:
            self.log(Level.INFO, EventCode.ROUTE_AMENDED, changes)
        self.half.configure()

    def settle_age(self) -> None:
        """Apply both sides' age limits; called after each change of them."""
        demands = self.proposal.max_age, self.age.accepted, self.arming.own.max_age
        facts = self.half.facts
        self.age.settle(demands, armed=self.arming.required, lifespan=facts.lifespan, moves=facts.may_not_be_late)

    # --- time

    def wake(self) -> None:
        """Have it ticked within a second, and for a while: something has happened to it.

        `judge_again` does so, too, if the verdict may be another one. Where messages pass, ask `idle` before: that they
        came is seen by `Half.passed` as long as it is awake.
        """
        self.idling.wake(self.context.now())
        if self.idle:
            self.rise()

    def rests(self, now: float) -> bool:
        """Whether it needs no tick at `now` (s): nothing has come since the last one, and nothing is due."""
        return now < self.idling.until and self.half.passed == self.idling.passed

    def rise(self) -> None:
        """Be ticked again. For `wake`, and for the timetable, once its time has come."""
        self.idle = False
        for rested in self.rested:
            rested(self.peer.timetable.looked)
        self.peer.timetable.awake[self] = None

    @property
    def shows_the_same(self) -> bool:
        """Whether its last snapshot stays right until a message comes, it is woken or a feature shows another thing."""
        now = self.context.now()
        blank = self.rests(now) and self.meter.is_blank(now) and not self.judged.announced.verdict.lasting
        return blank and self.peer.route_fields(self) == self._shown_of_features

    def _signs(self) -> Signs:
        """Return what changes if anything happens to it, apart from messages and the passing of time."""
        carried = self.half.carried
        return (
            self.id, self.judged.announced, self.judged.peer, carried.endpoints, carried.channel, self.connected,
            self.limit.rate, self.link_full, self.notices.last_error, self.notices.warning, self.notices.loop,
            self.life.phase, self.pausing.paused, self.peer.path.fault, *self.half.signs(),
        )  # fmt: skip

    def _next_change(self, now: float, crossing: Crossing) -> float:
        """Return when (s) something changes by itself next, `now` if it may at any moment, or infinity."""
        if (of_half := self.half.next_change(now, crossing)) <= now:
            return now
        # What is not open is proposed again, or given up. What it owes comes last: it takes longest to find out.
        restless = (
            self._verdict is None or self._verdict.state not in _LASTS or not self.meter.still or self.arming.required
            or self.peer.linked != bool(self.id) or self.link_full is not None
            or self.peer.path.fault is not None or self.losses.reasons or self.half.facts.owing
        )  # fmt: skip
        return now if restless else min(self.judged.next_change, of_half)

    def is_calm(self, now: float) -> bool:
        """Whether nothing of the last seconds counts any more."""
        if not self.meter.still:  # nearly always
            return False
        # Features find out within seconds why messages stopped, datagrams may still get lost, and a refusal is shown
        # for a while.
        fine = self._verdict is not None and self._verdict.state not in _STOPS
        return fine and self.transport.reliable and not self.reopening.refused and self.half.is_calm(now)

    def tick(self) -> None:
        """Update the figures and report a changed verdict; called once a second while the route is not idle."""
        now, crossing, learns = self.context.now(), self.crossing, self.half.facts.learns
        self.half.measure(now, crossing, learns=learns)
        self.meter.tick(now, learns=learns)
        connected = crossing.flows or self.connected
        if self.reopening.has_failed:
            self.reopening.observe(connected=connected, flowing=crossing.flows)
        if self.losses.reasons:  # nearly never, and the question what it owes takes a while
            self.losses.tick(now, idle=connected and not self.half.facts.owing)
        own = self._verdict
        stays = own is not None and own is self._verdict_for_peer and own.cause in _STAYS
        # Nearly each second of nearly each topic, and half the time of asking all rules.
        stays = stays and now < self.judged.next_change and self.idling.lasts(self._signs, now)
        stays = stays and stays_fine(self.half.facts, crossing, now)
        if not stays:
            own, self._verdict_for_peer = self._judged(now, crossing)
            self._verdict = own
            said = self.judged.announce(own, now, self.peer.path.fault)
            if said and self.purpose.in_graph:  # of an internal route, what has proposed it tells the operator
                shown, from_peer = self.judged.announced
                since = self.context.wall() - (now - self.judged.since(shown, now))
                about: About = {"cause": said.cause, "state": shown.state, "since": since, "from_peer": from_peer}
                self.log(said.level, said.code, said.text, **about)
        passed = self.half.passed
        self.half.act(now, crossing)
        steady = stays and not self.peer.is_looked_at
        # Last, so that the signs contain all that the tick has changed; else the next one, which comes in a second.
        signs = self.idling.signs if stays and passed != self.idling.passed else self._signs()
        self.idling.ticked(signs, passed, now, lambda: self._next_change(now, crossing), self.is_calm)
        self.idling.steady_until = min(now + STEADY_FOR, self.judged.next_change) if steady else -inf
        # Of one that rests from now on, the last figures are shown.
        self.only_counts = self.only_counts and self.idling.signs is self._shown_signs and self.idling.until <= now

    @property
    def link_full(self) -> Fullness | None:
        """The rates of the link in the direction of this half, or None if it is not full."""
        return self.peer.fullness.out if self.outgoing else self.peer.fullness.into

    # --- how it is

    def away_text(self) -> str:
        """Return why it carries nothing while it has no link, for an operator.

        It may have `LASTING`, for which the verdict puts how long its `since` is ago.
        """
        if self.peer.suspended_since is not None and self.life.accepted:
            return self.half.facts.waiting_text()
        return self.peer.down_reason or "the link is down"

    def trouble(self) -> Verdict | None:
        """Return the verdict on its channel if nothing gets through it now, or None."""
        channel = self.half.carried.channel
        return channel.trouble() if channel is not None else None

    @property
    def connected(self) -> bool:
        """Whether there is a path for messages; messages in transit when the route is paused still arrive."""
        return self.life.accepted and (channel := self.half.carried.channel) is not None and channel.ready

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
        if not (self.connected or armed.is_unarmed):
            return Crossing.NOT_OPEN
        return Crossing.RESTING if self.half.rests else armed

    # --- verdict

    @property
    def shown_refusal(self) -> Reason:
        """The reason why it is refused or has ended, now or until shortly ago, or an empty one."""
        return self.reopening.shown_refusal(self.life, self.context.now() - self.opened_at if self.id else 0.0)

    def verdict(self, *, for_peer: bool = False) -> Verdict:
        """Return this side's verdict, made at the last tick or at a later change by an operator or the peer.

        Args:
            for_peer: without the verdicts that are for this side only.
        """
        now = self.context.now()
        # A deadman that runs out between two ticks must not be shown as armed.
        if self._verdict is None or (self.arming.required and self.arming.overdue(now)):
            self._verdict, self._verdict_for_peer = self._judged(now, self.crossing)
        return self._verdict_for_peer if for_peer else self._verdict

    def _judged(self, now: float, crossing: Crossing) -> tuple[Verdict, Verdict]:
        """Return the verdicts for this side and for the other one."""
        own, for_peer = judge(self.half.facts, crossing, self.half.rules)
        path, steady = self.peer.path.fault, self._lossy_path.steady
        shown = steady(own, path, now)
        return shown, steady(for_peer, path, now) if own.here else shown

    def snapshot(self) -> RouteSnapshot:
        """Return the route as it is now."""
        now, wall = self.context.now(), self.context.wall()
        facts, carried = self.half.facts, self.half.carried
        if self.idling.goes_on_now:  # else its figures are those of this second
            self.meter.tick(now, learns=facts.learns)
        self._shown_of_features, self._shown_signs = self.peer.route_fields(self), self.idling.signs
        verdict, from_peer = self.judged.shown(self.verdict())
        self.only_counts = verdict.state in _LASTS and not (verdict.lasting or self.arming.required)
        common = partial(
            RouteSnapshot,
            key=self.key,
            link=self.peer.name,
            topic=self.local_topic,
            remote_topic=self.far_topic,
            outgoing=self.outgoing,
            spec=self.spec,
            state=verdict.state,
            reason=verdict.said(now, wall),
            type_name=carried.type_name,
            type_hash=carried.type_hash,
            transport=self.transport.name,
            port=self.proposal.port or self.peer.shared_port(),
            stages=facts.stages(),
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
            arming=self.arming.snapshot(now, facts.on_end, facts.velocity) if self.arming.required else None,
            max_rate=self.limit.rate or None,
            pattern=self.pattern,
            messages_total=self.meter.count,
            max_age=self.age.max_age,
            limits=self.arming.limits,
            limited_by=self.arming.limited_by,
            purpose=self.purpose.name,
            features=self._shown_of_features,
        )
        return facts.snapshot_of(common)

    def judge_again(self) -> None:
        """Make a new verdict when the next one is asked for, and within a second."""
        self._verdict, self.only_counts = None, False
        self.wake()

    def log(self, level: Level, code: EventCode, text: str, **about: Unpack[About]) -> None:
        """Add an event about this route."""
        is_shown = self.purpose.is_shown
        if not is_shown and level is Level.INFO:
            return  # a view's beginning and end are logged with the topic that is looked at
        name = self.local_topic if is_shown else self.purpose.name
        about["link"], about["topic"] = self.peer.name, name
        self.context.log(level, code, f"{name}: {text}", **about)


def promised_keep(route: Route) -> Keep | None:
    """Return the promise of `keep` that holds: topics that have to be armed give none."""
    return None if route.arming.required else route.proposal.keep


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
