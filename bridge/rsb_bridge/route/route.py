"""What one link carries of one name: what every half of every route shares, whatever crosses on it.

A topic's two halves are `rsb_bridge.route.outgoing` and `rsb_bridge.route.incoming`, which share `TopicRoute`. The two
halves of a service, an action or a node's parameters are in `rsb_bridge.route.calls`. `advance` does whatever can be
done next and may be called at any time, so nothing depends on the order in which ROS, the peer and the sockets become
ready.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, Unpack

import msgspec

from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import MAX_AGE_FEATURE
from rsb_bridge.model.session import HIGHEST, RANKS, priority_of
from rsb_bridge.model.snapshot import Level, RouteSnapshot, Stage
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.age import MessageAge
from rsb_bridge.route.arming import SAID, Arming, Disarmed, Settling
from rsb_bridge.route.combined_verdict import CombinedVerdict
from rsb_bridge.route.lifecycle import Event, Lifecycle, PauseState
from rsb_bridge.route.notices import ChannelLosses, Notices, timed_out
from rsb_bridge.route.peer import Peer
from rsb_bridge.route.rate_limit import RateLimit, limits_changed
from rsb_bridge.telemetry.meters import RateMeter
from rsb_bridge.wire.headers import LEASE_FEATURE
from rsb_bridge.wire.messages import Close, Propose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.channel.channel import DataChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.combined_verdict import Announcement
    from rsb_bridge.telemetry.event_log import About
    from rsb_bridge.wire.framing import Message

_LINK_STAGE = "link up"
_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 10.0
_PROPOSED_WITHIN = 3.0
_REFUSED_WITHIN = 5.0
"""s after which a retried route is no longer likely to be refused again."""


class Owner(Peer, Protocol):
    """The link that a route belongs to."""

    def report_soon(self, route: Route) -> None:
        """Send a route's counts before the next regular report. May be called for every batch."""
        ...

    def open_channel(self, route: Route) -> None:
        """Begin to open `route.channel`. For streams, a server waits for the client's instead."""
        ...


class Standing(NamedTuple):
    """How a route stands, whatever it carries: what `Facts` of topics and of calls have in common, named as there."""

    sends: bool
    topic: str
    domain_id: int
    link_down: str
    refusal: str
    loop: str
    paused: bool
    paused_by: str
    disarmed: str
    disarming: bool
    can_be_armed: bool
    no_path: str
    waits_for: str
    limit: float
    limited_by: str


class Route:
    """A route's half on this side. Lives across reconnects; `id` is that of the present opening.

    Attributes:
        key: names it in commands.
        spec: what was asked for, as the client sees it.
        topic: its name on the sending side; of calls, here and below, that is the callers' side.
        remote_topic: its name on the receiving side.
        from_client: whether the client sends.
        proposed_here: whether this side opens it anew after a reconnect.
        pattern: of this side's session, which has made it; empty: it is listed by its name, or the other side's.
        id: route id on the present connection; 0: not open.
        instance: of the peer's process that its present or last opening is with.
        life: what the two sides have agreed on so far.
        arming: whether it is armed, where it has to be.
        settling: whether the other side may still publish what was sent before it was disarmed.
        age: how old its messages, or requests, may be.
        closed_ids: of its last incarnations on the present connection, the oldest first.
        closed_at: s, when its last opening ended; 0: it had none.
        endpoints: others' publishers of the topic on the sending side, their subscriptions on the receiving side; of
            calls, the clients and the servers.
        losses: of the channels that carried it.
        judged: what both sides make of it.
        limit: how many messages cross at most.
    """

    outgoing: ClassVar[bool]
    duplex: ClassVar[bool] = False

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        self.context = context
        self.peer = peer
        self.spec = spec
        self.proposal = proposal
        self.topic = proposal.topic
        self.remote_topic = proposal.remote_topic
        self.from_client = proposal.from_client
        self.transport = context.transports[proposal.transport]
        self.proposed_here = proposed_here
        self.key = route_key(peer.name, proposal)
        self.pattern = ""
        self.id = 0
        self.instance = ""
        self.life = Lifecycle()
        self.opened_at = 0.0
        self.closed_ids: deque[int] = deque()
        self.closed_at = 0.0
        self.retry_at = 0.0
        self._warned_of = ""  # the process of an older peer
        self._refused = ""  # the last refusal, until a later opening succeeds
        self._backoff = Backoff(_FIRST_PAUSE, _LONGEST_PAUSE)
        self.notices = Notices(self.log)
        self.limit = RateLimit(proposal.max_rate, self.local_topic, peer.budget.rates, self.log)
        self.pausing = PauseState(peer.revisions, paused=proposal.paused, is_client=peer.is_client)
        self.arming = Arming()
        self.settling = Settling(context.loop, self.judge_again)
        self.age = MessageAge(context, peer)
        self.channel: DataChannel | None = None
        self.type_name = ""
        self.type_hash = ""
        self.endpoints: Sequence[Endpoint] = ()
        self.losses = ChannelLosses()
        self._verdict: Verdict | None = None  # None: it has to be judged
        self.judged = CombinedVerdict(sends=self.outgoing, peer_name="server" if peer.is_client else peer.name)
        self.meter = RateMeter(context.now())
        self.release_port: Callable[[], None] | None = None

    # --- what the halves do differently

    def advance(self) -> None:
        """Do what can be done next."""
        raise NotImplementedError

    def flush(self) -> None:
        """The path takes more again. A half that sends nothing has nothing to do."""

    def deliver(self, messages: Iterable[Message]) -> None:
        """Messages came, whole and authentic. A half that only sends gets none: the peer does not even have its key."""

    def _may_flow(self) -> None:
        """From now on something may cross: what is watched over time begins anew."""

    def _stages(self) -> tuple[Stage, ...]:
        """The steps of a message's, or a call's, way."""
        raise NotImplementedError

    def _judge(self) -> Verdict:
        """What this half makes of it."""
        raise NotImplementedError

    def snapshot(self) -> RouteSnapshot:
        """The route as it is now."""
        raise NotImplementedError

    # --- what is the same for all

    def on_accepted(self) -> None:
        """Both sides want the route."""
        if self.life.take(Event.ACCEPT):
            self._warn_of_older_peer()
            self.advance()

    def _warn_of_older_peer(self) -> None:
        """Tell operators that the other side drops nothing for its age, once for each of its processes."""
        if self.age.max_age and MAX_AGE_FEATURE not in self.peer.features and self._warned_of != self.peer.instance:
            self._warned_of = self.peer.instance
            text = "only this side drops messages older than max_age: update the other side's rsb-console"
            self.log(Level.WARNING, EventCode.ROUTE_MAX_AGE_ONE_SIDED, text)

    def stages(self) -> tuple[Stage, ...]:
        """The steps of a message's way; without a link, nothing is known of the others."""
        steps = self._stages()
        if self.peer.linked:
            return steps
        return tuple(step if step.name == _LINK_STAGE else Stage(step.name, None) for step in steps)

    def _link_stage(self) -> Stage:
        """Whether the peer is there, and what carries the route gets through."""
        trouble = self.trouble()
        return Stage(_LINK_STAGE, self.peer.linked and not trouble, trouble or self.peer.down_reason)

    def _accepted_stage(self) -> Stage:
        """Whether both sides want the route."""
        return Stage("peer accepted", False if self.refusal else self.accepted or None, self.refusal)

    @property
    def rank(self) -> int:
        """Of its priority; calls go ahead of topics."""
        return RANKS[priority_of(self.proposal.priority)] if self.proposal.kind == "topic" else HIGHEST

    def set_peer_topic(self, topic: str) -> None:
        """The peer says what the topic is called on its side."""
        if self.outgoing:
            self.remote_topic = topic
        else:
            self.topic = topic

    @property
    def local_topic(self) -> str:
        """Its name on this side."""
        return self.topic if self.outgoing else self.remote_topic

    @property
    def far_topic(self) -> str:
        """The name on the other side."""
        return self.remote_topic if self.outgoing else self.topic

    # --- opening and closing

    @property
    def accepted(self) -> bool:
        """Whether both sides want it."""
        return self.life.accepted

    @property
    def refusal(self) -> str:
        """The reason why it was refused and is not open, or an empty string."""
        return self.life.refusal

    @property
    def standing_refusal(self) -> str:
        """The refusal to show to operators: the last one, until a retry succeeds."""
        if self.id and (self.life.ready or self.context.now() - self.opened_at >= _REFUSED_WITHIN):
            self._refused = ""
        return self.life.refusal or self._refused

    def open(self, route_id: int) -> None:
        """Begin a new opening on the present connection."""
        self.id = route_id
        self.instance = self.peer.instance
        self.opened_at = self.context.now()
        self.limit.opened()
        self._verdict = None
        self.life.take(Event.OPEN)
        self.judged.take(None, self.context.now())
        self._may_flow()

    def close(self, reason: str) -> None:
        """End the present opening; what it keeps across openings stays."""
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
        self.judged.take(None, self.context.now())
        self._verdict = None
        self.life.take(Event.CLOSE)
        self.closed_at = self.context.now()

    def destroy(self) -> None:
        """End it for good: endpoints too."""
        self.close("removed")
        self.losses.forget_report()

    def refuse(self, code: EventCode, reason: str) -> None:
        """The route can't be; it is tried again later if it was proposed here."""
        self.notices.error(code, reason)
        self._end(reason)
        self._refused = "" if code == EventCode.ROUTE_CLOSED else reason

    def _end(self, reason: str) -> None:
        """End the present opening for a reason that is shown; it is opened again later if it was proposed here."""
        self.close(reason)
        self._verdict = None
        self.life.take(Event.REFUSE, reason)
        self.retry_at = self.context.now() + self._backoff.next()

    def awaited_until(self, linked_at: float) -> float:
        """Until when (s) the other side will have asked for the route anew, if it still wants it."""
        if self.closed_at > linked_at:
            return self.closed_at + _LONGEST_PAUSE + _PROPOSED_WITHIN
        return linked_at + _PROPOSED_WITHIN

    def channel_lost(self, reason: str) -> None:
        """What carried the route broke: open it again. It is reported as an error once the link has outlived it."""
        if self.id:
            text, connection = f"data connection: {reason}", self.peer.connections
            # Whoever disarms ends the channel, which may be seen before it is said.
            ends_with_arming = self.arming.required and not timed_out(reason)
            if self.arming.held:
                self.disarm(Disarmed.CHANNEL_LOST)
            self._end_on_both_sides(text)
            if ends_with_arming:
                return

            def report() -> None:
                if self.peer.linked and self.peer.connections == connection:
                    self.notices.error(EventCode.ROUTE_CHANNEL_LOST, text)

            self.losses.add(reason, self.context.loop, report)

    def request_reopen(self, code: EventCode, reason: str, level: Level = Level.WARNING) -> None:
        """Close the route on both sides; its proposer opens it again, which as a rule is all that it needs."""
        if self.id:
            self.notices.error(code, reason, level)
            self._end_on_both_sides(reason)

    def _end_on_both_sides(self, reason: str) -> None:
        route_id = self.id
        self._end(reason)
        self.peer.send(Close(route=route_id, reason=sanitize_text(reason)))

    @property
    def paused(self) -> bool:
        """Whether it carries no messages, as an operator of either side wants."""
        return self.pausing.paused

    def pause(self, paused: bool, who: str = "") -> None:
        """An operator of this side, `who`, stops or resumes carrying messages; the route stays set up."""
        was = self.paused
        self.pausing.change(paused=paused, who=who)
        self._paused(was)

    def pause_from_peer(self, paused: bool, revision: int, who: str = "", *, known: bool = True) -> None:
        """The peer tells its state of the pause.

        Args:
            paused: its state.
            revision: of its state.
            who: an operator there, as it says.
            known: whether this side's revisions are about the peer's present process; else its state counts as it is.
        """
        was = self.paused
        if known:
            self.pausing.merge(paused=paused, revision=revision, who=who)
        else:
            self.pausing.adopt(paused=paused, revision=revision, who=who)
        self._paused(was)

    def _paused(self, was: bool) -> None:
        paused = self.paused
        if paused != was:
            self.spec = msgspec.structs.replace(self.spec, paused=paused)
            self._verdict = None
            self._may_flow()
            code = EventCode.ROUTE_PAUSED if paused else EventCode.ROUTE_RESUMED
            self.log(Level.INFO, code, "paused" if paused else "resumed")
        self.advance()

    def armed(self) -> None:
        """Both sides hold it for armed: messages may cross, from now on."""
        self._verdict = None
        self._may_flow()
        self.advance()

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Disarm this opening for good; `reason` replaces the usual text of `why`."""
        arming, lease = self.arming, self.arming.lease
        if arming.armed and self.outgoing and lease is not None:
            self.settling.begin(self.id, lease.left)
        if why is not Disarmed.OPERATOR:
            text = f"disarmed: {reason or SAID[why]} ({arming.by} armed it)"
            self.settling.then(lambda: self.log(Level.WARNING, EventCode.ROUTE_DISARMED, text, cause=why))
        arming.end(why, reason)
        self._verdict = None

    def amend(self, spec: Topic, proposal: Propose) -> None:
        """Go on with other limits; counts, endpoints and what is under way stay."""
        changes = limits_changed(self.proposal, proposal)
        self.spec, self.proposal = spec, proposal
        self.limit.set_max_rate(proposal.max_rate)
        self.settle_age()
        self._verdict = None
        if changes:
            self.log(Level.INFO, EventCode.ROUTE_AMENDED, changes)

    def settle_age(self) -> None:
        """Apply both sides' limits of age; called after each change of them."""
        demands = self.proposal.max_age, self.age.accepted, self.arming.own.max_age
        self.age.settle(demands, armed=self.arming.required, lifespan=self._lifespan)

    @property
    def _lifespan(self) -> float:
        """Lifespan (s) of what it carries, or 0 for none."""
        return 0.0

    def set_check(self) -> None:
        """Take over `check_messages` of the session."""

    # --- time

    def tick(self) -> None:
        """Once a second: histories, and what has turned for the worse."""
        now = self.context.now()
        self.meter.tick(now, learns=self.learns)
        if self.flowing:  # that both sides accept it says little: what it is refused for may be found out later
            self._backoff.reset()
        self._verdict = None
        verdict = self.verdict()
        if said := self.judged.announce(verdict, now):
            self.log(said.level, said.code, said.text, **self._about(said, now))

    @property
    def link_full(self) -> Fullness | None:
        """The rates of the link in the direction of this half, or None if it is not full."""
        return self.peer.full_out if self.outgoing else self.peer.full_in

    @property
    def learns(self) -> bool:
        """Whether its rate and delays are as usual now, so that the usual ones are learned from them."""
        return True

    # --- how it is

    def trouble(self) -> str:
        """Why what carries it does not get through; empty: it does."""
        return self.channel.trouble() if self.channel is not None else ""

    @property
    def awaits_report(self) -> bool:
        """Whether the other side, which has still to report of this opening, alone knows the first steps."""
        return False

    @property
    def connected(self) -> bool:
        """Whether there is a way for messages; those that are under way when the route is paused still go it."""
        return self.accepted and self.channel is not None and self.channel.ready

    @property
    def flowing(self) -> bool:
        """Whether messages could cross now."""
        return self.connected and not self.paused and not self.notices.loop and self.arming.stands(self.context.now())

    # --- what is made of it

    def standing(self) -> Standing:
        """What any half knows."""
        now = self.context.now()
        stands, overdue = self.arming.stands(now), self.arming.overdue(now)
        why_not = self._why_not_armable()
        return Standing(
            sends=self.outgoing,
            topic=self.local_topic,
            domain_id=self.context.domain_id,
            link_down="" if self.peer.linked else self.peer.down_reason or "the link is down",
            refusal=self.standing_refusal,
            loop=self.notices.loop,
            paused=self.paused,
            paused_by=self.pausing.who,
            disarmed="" if stands else SAID[why_not] if why_not else SAID[overdue] if overdue else self.arming.reason,
            disarming=self.settling.under_way
            or (self.outgoing and self.arming.armed and overdue is not None and not stands),
            can_be_armed=why_not is None,
            no_path=self._path_trouble(),
            waits_for="" if self.flowing else self._first_missing(),
            limit=self.limit.rate,
            limited_by=self.limit.why,
        )

    def _why_not_armable(self) -> Disarmed | None:
        """Return the reason why no operator can arm it now, whoever tries, or None."""
        if LEASE_FEATURE not in self.peer.features:
            return Disarmed.PEER_TOO_OLD
        return Disarmed.LINK_SLOW if self.arming.why is Disarmed.LINK_SLOW else None

    def _path_trouble(self) -> str:
        """Return the reason why its channel does not get through; a stream that waits on a full link is none."""
        return "" if self.link_full is not None and self.transport.reliable else self.trouble()

    def _first_missing(self) -> str:
        """What has to come before anything can cross; a step that has failed before one that is open."""
        missing = [stage for stage in self.stages() if not stage.done]
        first = next((stage for stage in missing if stage.done is False), None)
        if first is None and self.awaits_report:
            return "the other side's report" if self.accepted else self._accepted_stage().name
        first = first or next(iter(missing), None)
        return (first.detail or first.name) if first else ""

    def verdict(self) -> Verdict:
        """What this side made of the route at the last tick, or when an operator or the peer has changed it since."""
        if self._verdict is None or self.arming.overdue(self.context.now()):
            self._verdict = self._judge()
        return self._verdict

    def common_snapshot(self) -> partial[RouteSnapshot]:
        """The route as it is now, but for what depends on what it carries."""
        now = self.context.now()
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
            reason=verdict.said(now),
            type_name=self.type_name,
            type_hash=self.type_hash,
            transport=self.transport.name,
            port=self.proposal.port or self.peer.shared_port(),
            stages=self.stages(),
            rate=self.meter.rate,
            expected_rate=self._expected_rate(),
            bytes_per_second=self.meter.bytes_per_second,
            bytes_total=self.meter.bytes,
            latency_uncertainty=self.peer.clock.uncertainty,
            age=None if self.meter.last is None else now - self.meter.last,
            history=tuple(self.meter.history),
            last_error=self.notices.last_error,
            cause=verdict.cause,
            from_peer=from_peer,
            since=self.context.wall() - (now - self.judged.since(verdict, now)),
            arming=self.arming.snapshot(now),
            allowed_rate=self.limit.allowed or None,
            pattern=self.pattern,
            messages_total=self.meter.count,
            max_age=self.age.max_age,
        )

    def _expected_rate(self) -> float | None:
        rate, limit = self.spec.expected_rate or self.meter.usual_rate, self.limit.rate
        return min(rate, limit) if rate and limit else rate

    def judge_again(self) -> None:
        """Make a new verdict when the next one is asked for."""
        self._verdict = None

    def _about(self, said: Announcement, now: float) -> About:
        """What an event says of the verdict that is shown."""
        verdict, from_peer = self.judged.shown(self.verdict())
        since = self.context.wall() - (now - self.judged.since(verdict, now))
        return {"cause": said.cause, "state": verdict.state, "since": since, "from_peer": from_peer}

    def log(self, level: Level, code: EventCode, text: str, **about: Unpack[About]) -> None:
        """Add an event about this route."""
        about["link"], about["topic"] = self.peer.name, self.local_topic
        self.context.log(level, code, f"{self.local_topic}: {text}", **about)


def route_key(link: str, proposal: Propose) -> str:
    """What identifies a route on this side: the link, the direction and the topic's name on the sending side.

    Of what is not a topic, its kind, too: a service may have a topic's name.

    Where the server adds a prefix that the client did not propose, the two sides' keys of a route that the server sends
    on differ. Keys do not cross the link: each side's commands and snapshots use its own.
    """
    kind = "" if proposal.kind == "topic" else f"{proposal.kind} "
    return f"{link} {'→' if proposal.from_client else '←'} {kind}{proposal.topic}"
