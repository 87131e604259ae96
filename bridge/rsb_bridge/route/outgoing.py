"""The sending half of a topic's route: it describes the topic to the peer, subscribes, and keeps the ledger.

Messages don't pass here: `rsb_bridge.route.sending.OutgoingPath` is their path.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.channel.scheduler import SendingChannel
from rsb_bridge.model.audience import NOBODY, Audience, Deaf
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import expand_type_name
from rsb_bridge.model.qos import incompatible
from rsb_bridge.model.snapshot import Ledger, Level, Stage
from rsb_bridge.model.verdict import LASTING, Cause
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.ros.ros_interface import RosError, TopicSpec
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.blocking_rules import stages_with_link
from rsb_bridge.route.catching_up import LATE, Backlog
from rsb_bridge.route.combined_verdict import lasting, node_names, record_of
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.health import Health
from rsb_bridge.route.lateness import QUEUE, REPORTED_LATELY, WAY, SendersDelay, delay_of_sender
from rsb_bridge.route.ledger import OUTAGE, RouteLedger
from rsb_bridge.route.lifecycle import RouteEvent, RoutePhase
from rsb_bridge.route.loop_filter import LoopFilter
from rsb_bridge.route.resolving import Resolver
from rsb_bridge.route.sending import OutgoingPath, remedy_for_size
from rsb_bridge.route.topic_route import MEASURED_FOR, TopicRoute
from rsb_bridge.route.topic_subscription import TopicSubscription
from rsb_bridge.route.topic_verdict import OF_SENDER, no_subscriber
from rsb_bridge.wire.headers import publisher_id
from rsb_bridge.wire.messages import Describe, Propose, Publishers, Ready
from rsb_bridge.wire.records import MOST_PUBLISHERS, ReceivedReport, SentReport

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.reason import Reason
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.blocking_rules import Rules
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.route import Owner

_NO_TYPE = frozenset({Cause.TYPE_UNKNOWN, Cause.TYPE_CONFLICT})
_LIMITED = "they are limited to the messages sent"
_NODES_START_IN = 10.0
"""s from an opening for which a topic without a publisher only waits: nodes that start with the bridge are up by then.
A round figure: nothing was measured; with a tenth of it, each boot of a robot would begin with faults."""


class OutgoingRoute(TopicRoute[SendingChannel]):
    """Takes a topic's messages here and sends them to the peer.

    It has more than 40 methods because 28 of them fill in hooks of `TopicRoute` and `Route`.

    Attributes:
        backlog: what waits for a link that is away.
    """

    peer_report = ReceivedReport
    outgoing: ClassVar[bool] = True
    rules: ClassVar[Rules[Any]] = OF_SENDER

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._told: Publishers | None = None  # of the publishers, to the peer
        self._ledger = RouteLedger()
        self._report: ReceivedReport | None = None  # of the present opening
        self._kept_there: Collection[bytes] = ()  # publishers of a latched topic whose messages the peer keeps
        self._described: Describe | None = None
        self._loop_filter = LoopFilter(self)
        self.backlog = Backlog()
        self._path = OutgoingPath(self, self._ledger, self._loop_filter, self.backlog)
        self._subscription = TopicSubscription(self, self._path, self._loop_filter, self._look_who_is_present)
        self._unwanted = True  # since the last subscription, messages were not to cross for a while
        self._resolver = Resolver(context, proposal, self.judge_again)
        self.health = Health()
        self.delays = SendersDelay()

    # --- setting up

    def peer_ready(self, ready: Ready) -> None:
        """Subscribe: the peer has publishers. Its counts of the previous opening settle the ledger."""
        # Asked before the event, because the peer answers each description, and only its first answer has this side
        # subscribe.
        again = self.life.phase is RoutePhase.READY
        if not self.life.handle(RouteEvent.READY):
            return
        if not self._ledger.settle(ready.before, self.peer.instance):
            self.notices.doubt(self.peer.instance, _LIMITED)
        self._loop_filter.table.answered(ready.sources)
        described = self._described
        if described is not None and not again:
            self._end_subscription()
            self._kept_there = ready.newest.keys()
            self.age.publishers.since = None if described.qos.latched else self.context.stamps.now()
            spec = TopicSpec(self.topic, described.type, described.type_hash, described.qos)
            self._subscription.begin(
                spec,
                automatic=self.proposal.qos is None,
                expected_rate=self.spec.expected_rate,
                known=ready.newest,
            )
            self._path.histories = self._subscription.histories
        self.advance()

    def _advance(self) -> None:
        self._set_up()
        if self._subscription.spec is not None and (released := self._loop_filter.release()):
            self._path.receive(released)

    def _set_up(self) -> None:
        """Do the next steps that are possible: look for publishers, describe them, open the channel, subscribe."""
        if not self.life.accepted or self.pausing.paused:
            self._subscription.unsubscribe()
            self._unwanted = self._unwanted or self.pausing.paused
            self._ledger.lose("paused", self._loop_filter.forget())  # nobody wants them when it is resumed
            return
        self._path.resume()
        self.endpoints = self._loop_filter.update(self.topic, self.remote_topic)
        self._resolver.update(self.endpoints)
        if self._described is not None and self._described.sources != self._loop_filter.table.sources:
            # A further source needs no new subscription: only its own messages wait for the peer's answer.
            self._describe(msgspec.structs.replace(self._described, sources=self._loop_filter.table.sources))
        if self._described is not None and self._loop_filter.outdated(self.qos):
            self.request_reopen(EventCode.ROUTE_SOURCES_CHANGED, "its messages come through other bridges than before")
            return
        self.notices.set_loop(self._loop_filter.loop(self.topic))
        if self.notices.loop:
            self._leave_out()
            return
        described = self._resolve()
        if described is None:
            if self.life.phase is RoutePhase.READY:
                self._look_who_is_present()
            return
        if self._described is not None and described.type_hash != self._described.type_hash:
            # A new opening, so that no message of the old type comes where the new one is published.
            self.request_reopen(
                EventCode.ROUTE_TYPE_CHANGED, f"its type has changed from {self._described.type} to {described.type}"
            )
            return
        reliable = described.qos.reliability
        if self._described is not None and not self.transport.reliable and reliable != self._described.qos.reliability:
            # Both ends of a channel over datagrams depend on it.
            self.request_reopen(EventCode.ROUTE_RELIABILITY_CHANGED, f"its publishers offer {reliable} now")
            return
        if described != self._described:
            self._subscription.unsubscribe()
            self.life.handle(RouteEvent.DESCRIBE)
            self._describe(described)
        if self.life.phase is not RoutePhase.READY:
            return
        self._look_who_is_present()
        if self.channel is None:
            self.peer.open_channel(self)
        crossing = self.crossing
        if crossing.flows:
            self._subscribe()
        elif crossing.is_held_back:
            self._leave_out()

    def _leave_out(self) -> None:
        """Subscribe to nothing, as messages are not to cross."""
        self._subscription.unsubscribe()
        self._unwanted = True

    def _describe(self, described: Describe) -> None:
        self._described = described
        self.type_name, self.type_hash, self.qos = described.type, described.type_hash, described.qos
        self._ledger.lossy = self.lossy
        self.settle_age()
        self._path.compose()  # what is latched, as its QoS says now, is asked its age later
        self.log_other_end(self.type_name)
        self._loop_filter.table.described()
        self._told = None  # the peer may have new outputs
        self.peer.send(described)

    def _resolve(self) -> Describe | None:
        """Return the description to send, or None if type or QoS is unknown."""
        resolved = self._resolver.resolve(TypeVersion(self.type_name, self.type_hash), self._loop_filter)
        self.notices.set_warning(resolved.warning if resolved else "")
        if resolved is None:
            unresolved, there = self._resolver.unresolved, self._resolver.hint.name
            if self._described is None or unresolved is None:
                return None
            # Nothing that is published now could be sent. Once the publishers are right, it opens with their type.
            if unresolved.clash:
                self.request_reopen(EventCode.ROUTE_TYPE_CHANGED, str(unresolved))
            # A participant has one type on a topic: its subscription here would keep an operator's messages from them.
            elif not self.endpoints and there not in ("", self.type_name):
                text = f"nobody publishes {self.type_name} any more, and the subscriptions there are to {there}"
                self.request_reopen(EventCode.ROUTE_TYPE_CHANGED, text)
            return None
        sources, qos = self._loop_filter.table.sources, resolved.qos
        if self.arming.required:
            qos = without_history(qos)
        return Describe(route=self.id, type=resolved.type, type_hash=resolved.type_hash, qos=qos, sources=sources)

    def _subscribe(self) -> None:
        if self._subscription.spec is None or self._subscription.active:
            return
        try:
            self._subscription.subscribe(missed=not self._unwanted)
        except RosError as error:
            self.request_reopen(EventCode.ROUTE_SUBSCRIBE_FAILED, str(error), Level.ERROR)
            return
        self._unwanted = False
        self.silence.rearm(self.context.now())
        self.judge_again()
        self.log(Level.INFO, EventCode.ROUTE_CONNECTED, f"→ {self.transport.name} connected ({self.type_name})")

    def _end_subscription(self) -> None:
        self._told = self._path.histories = None
        self._ledger.drop("link lost", self._subscription.close() + self._path.clear_later())

    def _look_who_is_present(self) -> None:
        """Tell the peer of the publishers: whether one is alive, and the depths of the histories that are not gone."""
        spec = self._subscription.spec
        if spec is None or not (spec.qos.latched or spec.qos.liveliness_lease_duration):
            return
        present = {}
        if (histories := self._subscription.histories) is not None:
            gids = {endpoint.gid for endpoint in self.endpoints}
            histories.forget_gone(gids)
            depths = histories.depths()
            ids = islice(map(publisher_id, gids), MOST_PUBLISHERS)
            present = {each: depths.get(each, 0) for each in ids}
        told = Publishers(route=self.id, present=present, alive=self._subscription.alive)
        if told != self._told:
            self._told = told
            self.peer.send(told)

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Drop the waiting messages, here and at the peer."""
        self._leave_out()
        self._ledger.lose("disarmed", self._loop_filter.forget())
        self._ledger.drop("disarmed", self._path.clear())
        self._ledger.disarmed()
        super().disarm(why, reason)

    def open(self, route_id: int) -> None:
        """Begin a new opening."""
        super().open(route_id)
        self.delays = SendersDelay()
        self._loop_filter.clear()
        self._ledger.opened(route_id, self.peer.instance)

    def close(self, reason: str) -> None:
        """End the opening. Waiting messages are lost; messages in flight are settled with the next opening."""
        self._end_subscription()
        self._unwanted = self._unwanted or self.arming.required
        self.backlog.end()
        self._described = None
        self._kept_there = ()
        self._ledger.lose("link lost", self._loop_filter.forget())
        self._ledger.drop("link lost", self._path.clear())
        self._loop_filter.clear()
        self._ledger.closed()
        self._report, self.audience = None, NOBODY
        super().close(reason)

    def refuse(self, code: EventCode, reason: Reason) -> None:
        super().refuse(code, reason)
        self._unwanted = self._unwanted or bool(self.reopening.refused)

    # --- messages

    def _signs(self) -> Signs:
        subscription = self._subscription
        lost = subscription.numbers.counts[Untaken.LOST]
        return *super()._signs(), self._report, self._resolver.unresolved, subscription.failure, lost

    def _next_change(self, now: float, crossing: Crossing) -> float:
        if self.backlog.exists and self.peer.linked:
            return now
        return min(super()._next_change(now, crossing), self.health.next_change(now))

    @property
    def _is_polled(self) -> bool:
        # A topic of a similar name may appear, DDS does not tell when it matches a publisher at last, and the link may
        # get another profile.
        return super()._is_polled or not self.endpoints or self._subscription.awaits_match or self._profile_limits

    @property
    def _profile_limits(self) -> bool:
        """Whether the link profile's limit is for it: it has none and may lose messages."""
        return self.qos is not None and self.qos.reliability == "best_effort" and not self.proposal.max_rate

    def _measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        flows, ledger = crossing.flows, self.ledger()
        awaited = self._subscription.receives if flows else self.lacks_publisher(crossing)
        # A latched topic may be silent for any time, unless an operator expects a rate.
        usual = None if self.is_latched else self.meter.usual_rate
        last = self.silence.watch.quiet_since
        self.health.judge(self, ledger, now, usual_rate=usual, quiet_since=last, flows=flows, awaited=awaited)
        super()._measure(now, crossing, learns=learns)

    def _follow(self, now: float, crossing: Crossing) -> None:
        self.limit.set_profile_rate((self.peer.profile.max_rate or 0.0) if self._profile_limits else 0.0)
        super()._follow(now, crossing)
        self._subscription.tick()
        if self.age.publishers.since is None and crossing.flows and not self.is_latched:
            self._tick_clocks()

    def _tick_clocks(self) -> None:
        """Open the route again if messages seem old since this side's clock was set: their publisher's may lag."""
        late = self.age.late()
        # Only a new subscription has no message from before it, so that an earlier stamp proves a wrong clock.
        if late is not None and late.cause is Cause.PUBLISHER_STAMPS_OLD:
            self.request_reopen(EventCode.ROUTE_CLOCK_SET, "this side's clock was set, and publishers' stamps seem old")

    def away(self) -> None:
        super().away()
        self.backlog.begin(self._ledger.dropped[OUTAGE])

    def back(self) -> None:
        super().back()
        self._path.back()
        self.health.losses.reset()  # the link was silent before it was away: what it dropped then is no overload

    def _judge_lateness(self, now: float, *, flows: bool, learns: bool) -> None:
        unreported = self.delays.unreported(self._ledger.sent_now, self._ledger.reported_now, now)
        if self.lossy:  # unreported datagrams may be lost, unless pings by a stream are held up, too
            unreported = min(unreported, self.peer.keepalive.ping_wait)
        own = max(self._path.waits(now), delay_of_sender(unreported, self.peer.keepalive.ping_delay))
        if self.backlog.exists and self.peer.linked:
            self.backlog.judge(self.ledger(), now, held_up=own > LATE)
        if not flows or self.backlog.exists:  # what waited for the link is not late
            self.lateness.reset()
            return
        measured = self.delays.measure(own, self.peer.clock.uncertainty or 0.0, now)
        self.lateness.judge(self.delays.least, 0.0, self.late_after, now, measured, own=own, learns=learns)

    def _held_up_where(self) -> str:
        return QUEUE if self._path.waits(self.context.now()) >= self.lateness.seconds / 2 else WAY

    @property
    def _came_here(self) -> int:
        return self._ledger.offered

    @property
    def _passed(self) -> int:
        return self._ledger.offered + self.meter.count

    def flush(self) -> None:
        self._path.flush()

    def away_text(self) -> str:
        if self.peer.away_since is None or not self.life.accepted:
            return super().away_text()
        dropped = self._ledger.dropped[OUTAGE] - self.backlog.dropped_before
        older = f", {dropped:,} older dropped" if dropped else ""
        return f"waiting {LASTING}, {self.ledger().waiting:,} kept{older}"

    def amend(self, spec: Topic, proposal: Propose) -> None:
        super().amend(spec, proposal)
        self._path.compose()

    # --- the ledger

    def reported(self, report: ReceivedReport) -> None:
        """Take the peer's counts of the present opening."""
        if report.malformed and (self._report is None or report.malformed != self._report.malformed):
            text = f"malformed {self.type_name} to {self.peer.name}: {report.malformed}: see the node here that sent it"
            self.notices.message_error(EventCode.ROUTE_MALFORMED, text)
        self._report = report
        self.wake()
        deaf = tuple(Deaf(each.node, each.cause, each.reason) for each in report.deaf)
        self.audience = Audience(max(0, report.subscribers), report.nodes, deaf)
        self.judged.receive(report.verdict, self.context.now())
        delay = self.delays.with_report(self.peer.keepalive.ping_delay)
        if not self._ledger.reported(report, self.context.now(), delay):
            self.notices.doubt(self.peer.instance, _LIMITED)
        if self._ledger.received_now:
            self.losses.arrived()
        if (report.type, report.type_hash) != self._resolver.hint:
            self._resolver.hint = TypeVersion(report.type, report.type_hash)
            self.advance()
        if report.latency is not None:
            self.delays.receive(report.latency, self.context.now())
        self.latency.take_reported(report.latency_p50, report.latency_p99, report.jitter)

    @property
    def velocity(self) -> Velocity | None:
        return self._report.velocity if self._report is not None else None

    def ledger(self) -> Ledger:
        """Return the ledger, by the peer's last report."""
        ledger, context = self._ledger.ledger(self._subscription.numbers.counts), self.context
        if ledger.waiting and (waited := self._path.waits(context.now())):
            return replace(ledger, waiting_since=context.wall_of(context.clock.steady() - waited))
        return ledger

    def receiver_left(self) -> None:
        """Take the peer's last report for final, as it leaves with a goodbye."""
        self._ledger.receiver_left()

    def news(self) -> SentReport | None:
        """Return the report to send to the peer now, or None if nothing has changed."""
        ledger = self.ledger()
        report = SentReport(
            route=self.id,
            offered=ledger.offered,
            delivered=ledger.delivered,
            throttled=ledger.throttled,
            expired=ledger.expired,
            waiting=ledger.waiting,
            in_flight=ledger.in_flight,
            dropped=ledger.dropped,
            unknown=ledger.unknown,
            lost_in_dds=ledger.lost_in_dds,
            missed_while_down=ledger.missed_while_down,
            unsubscribed=ledger.unsubscribed,
            again=ledger.again,
            publishers=len(self.endpoints),
            publisher_qos=self._resolver.publisher_qos,
            subscribed=self._subscription.receives,
            verdict=record_of(self.verdict()),
            nodes=node_names(self.endpoints),
        )
        if report == self._last_report:
            return None
        self._last_report = report
        now = self.context.now()
        # With these, each report would differ from the one before.
        verdict, waited = lasting(report.verdict, self.verdict(), now), self._path.waits(now)
        return msgspec.structs.replace(report, verdict=verdict, waited=waited)

    @property
    def present_type(self) -> TypeVersion:
        if self.type_name and self.endpoints:
            return TypeVersion(self.type_name, self.type_hash)
        hint, named = self._resolver.hint, self.spec.type
        # Only the session's type crosses, even if nodes of the other side have another one.
        return hint if named == "auto" or expand_type_name(named) == hint.name else TypeVersion(expand_type_name(named))

    def takes(self, gid: bytes) -> bool:
        """Whether messages of a publisher here are taken now, or held until their origin is found out."""
        return self._subscription.receives and not self._loop_filter.table.left_out(gid)

    @property
    def has_kept(self) -> bool:
        """Whether the peer keeps messages of a publisher that still exists."""
        return bool(self._kept_there) and any(publisher_id(each.gid) in self._kept_there for each in self.endpoints)

    def lacks_publisher(self, crossing: Crossing) -> bool:
        # Type and QoS are a publisher's, so that without one nothing is described, and nothing flows.
        unpublished = self._resolver.unresolved is not None and not self.endpoints
        started = self.context.now() - self.opened_at >= _NODES_START_IN
        return unpublished and started and self.life.accepted and crossing is Crossing.NOT_OPEN

    @property
    def silence_counts(self) -> bool:
        """Whether silence counts and there is no usual rate; `Health` judges topics with one."""
        return super().silence_counts and (self.silence.own or self.meter.usual_rate is None)

    @property
    def came_before(self) -> bool:
        """Whether either side knows of messages in an earlier opening, and none came in this one."""
        there = self._report is not None and self._report.came_before
        return super().came_before or (there and not self.came)

    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        return self._resolver.publisher_qos, self._report.subscriber_qos if self._report else None

    @property
    def publisher_nodes(self) -> tuple[str, ...]:
        return node_names(self.endpoints)

    # --- stages and verdict

    def stages(self) -> tuple[Stage, ...]:
        """Return the stages from the publisher to the subscriber, in order."""
        described, kept, counts, report = self.life.described, self.has_kept, self._ledger, self._report
        if self.endpoints:
            seen = Stage("publisher seen", True, f"{len(self.endpoints)}{self._loop_filter.left_out()}")
        else:
            looks = self.life.accepted and not self.pausing.paused
            seen = Stage("publisher seen", False if looks else None, self._resolver.no_publisher())
        if described:
            known = Stage("type known", True, self.type_name)
        else:
            known = Stage("type known", False if self.unresolved in _NO_TYPE else None, self._resolver.why())
        clash = self._qos_clash()
        matches = Stage("QoS compatible", not clash if described else None, clash)
        failure = self.notices.loop or self._subscription.failure
        subscribed = Stage("subscribed", False if failure else self._subscription.receives or None, failure)
        undelivered = self.notices.undelivered
        sent = Stage("sent", True) if counts.sent_now or kept else Stage("sent", None, undelivered)
        received = Stage("received", counts.received_now > 0 or kept or None, undelivered)
        published = Stage("published", counts.delivered_now > 0 or kept or None)
        if report is None or report.subscribers:
            heard = Stage("subscriber seen", None if report is None else True)
        else:
            heard = Stage("subscriber seen", None, no_subscriber(self.far_topic, None, report.deaf))
        return stages_with_link(self, (seen, known, matches, subscribed), (sent, received, published, heard))

    def _qos_clash(self) -> str:
        """Return the reason why its subscription misses messages of a publisher, or an empty string."""
        if self.qos is None:
            return ""
        for each in self.endpoints:
            if each.type_name == self.type_name and (why := incompatible(each.qos, self.qos)):
                return why
        return ""

    @property
    def similar(self) -> str:
        """A published topic with a similar name, which may be meant, or an empty string."""
        return self._resolver.similar

    @property
    def unresolved(self) -> Cause | None:
        """The cause why type or QoS is unknown, or None."""
        return None if self._resolver.unresolved is None else self._resolver.unresolved.cause

    def why_unresolved(self) -> str:
        """Return the same in words."""
        return self._resolver.why()

    @property
    def subscribe_failed(self) -> str:
        """The reason why its subscription failed, or an empty string."""
        return self._subscription.failure

    @property
    def unmatched(self) -> bool:
        return self._subscription.is_unmatched

    @property
    def has_sent(self) -> bool:
        """Whether messages were sent in this opening, or the peer keeps some of a latched topic."""
        return self._ledger.sent_now > 0 or self.has_kept

    @property
    def malformed(self) -> str:
        """The field of the last malformed message, and what is wrong with it, or an empty string."""
        return "" if self._report is None else self._report.malformed

    @property
    def loss_unexplained(self) -> bool:
        """Whether it is not known yet if the present loss is due to a full link."""
        loss = self.health.losses.loss
        return self.peer.fullness.undecided or (loss is not None and self.context.now() - loss.since < MEASURED_FOR)

    def remedy_for_size(self) -> str:
        """Return what to do about messages that are too large."""
        return remedy_for_size(self.transport, self.proposal)

    @property
    def owing(self) -> bool:
        return self.ledger().open > 0

    @property
    def breaking(self) -> str:
        repeated = self.losses.repeated
        # A full link crowds a topic out until its connection breaks; the text would blame firewalls.
        return "" if not repeated or self.peer.fullness.out is not None or self.peer.fullness.undecided else repeated

    @property
    def large_vanish(self) -> bool:
        loss, channel = self.health.losses.loss, self.channel
        if loss is None or loss.lost < loss.of or channel is None or self.datagrams() < 2:
            return False
        # A part of a message's datagrams may arrive, on a full link for example, and none of the messages.
        return channel.unheard_for > REPORTED_LATELY and not channel.trouble()

    def datagrams(self) -> int:
        """Return the number of datagrams of an average message, or 0 if the channel uses none."""
        if self.channel is None or not self.meter.count or not self.channel.ready:
            return 0
        return self.channel.datagrams(self.meter.bytes // self.meter.count)
