"""The sending half of a topic's route: it describes the topic to the peer, subscribes, and keeps the ledger.

Messages don't pass here: `rsb_bridge.route.sending.OutgoingPath` is their path.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.audience import NOBODY, Audience, Deaf
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.ros.ros_interface import EndPlace, RosError, TopicSpec
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.catching_up import LATE, Backlog
from rsb_bridge.route.combined_verdict import lasting, record_of
from rsb_bridge.route.half import Carried
from rsb_bridge.route.health import Health
from rsb_bridge.route.lateness import SendersDelay, delay_of_sender
from rsb_bridge.route.lazy import LazySender
from rsb_bridge.route.ledger import OUTAGE, RouteLedger
from rsb_bridge.route.lifecycle import RouteEvent, RoutePhase
from rsb_bridge.route.listeners import PublishedAs
from rsb_bridge.route.loop_filter import LoopFilter
from rsb_bridge.route.renewal import Renewal
from rsb_bridge.route.resolving import Resolver
from rsb_bridge.route.sending import OutgoingPath
from rsb_bridge.route.topic_facts import SenderFacts
from rsb_bridge.route.topic_flow import TopicFlow
from rsb_bridge.route.topic_subscription import TopicSubscription
from rsb_bridge.route.topic_verdict import OF_SENDER
from rsb_bridge.telemetry.watches import FAST_ABOVE
from rsb_bridge.wire.messages import Describe, Limit, Publishers, Ready
from rsb_bridge.wire.records import MOST_PUBLISHERS, ReceivedCounts, ReceivedReport, SentCounts, SentReport

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.scheduler import SendingChannel
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.half import Rules
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.framing import Message

_LIMITED = "they are limited to the messages sent"


class Sender:
    """Takes a topic's messages here and sends them to the peer.

    Attributes:
        counts: its part of the ledger.
        backlog: the messages that wait for a link that is away.
        path: the path of the messages.
    """

    peer_report: ClassVar[Any] = ReceivedCounts, ReceivedReport
    outgoing: ClassVar[bool] = True
    duplex: ClassVar[bool] = False
    rules: ClassVar[Rules[Any]] = OF_SENDER

    def __init__(self, route: Route) -> None:
        self.route = route
        self.carried: Carried[SendingChannel] = Carried()  # to make a `Carried[…]` takes three calls more
        self.flow = TopicFlow(route, self.carried)
        # The last ones of the present opening.
        self._last_counts: SentCounts | None = None
        self._last_report: SentReport | None = None
        self._reported: tuple[object, ...] = ()  # the contents of that, which take less time to compare
        self._told: Publishers | None = None  # of the publishers, to the peer
        self._setbacks: tuple[int, ...] = ()  # at the last tick
        self.counts = RouteLedger()
        self._described: Describe | None = None
        self.loop_filter = LoopFilter(route)
        self.backlog = Backlog()
        self.restart_measuring = self.flow.restart_measuring
        self.path = OutgoingPath(self.flow, self.counts, self.loop_filter, self.backlog)
        route.rested.append(self.path.traffic.rested)
        self.subscription = TopicSubscription(route, self.path, self.loop_filter, self._look_who_is_present)
        self._unwanted = True  # since the last subscription, messages were not to cross for a while
        self.lazy = LazySender(route, self.flow)
        self._renewal = Renewal(route, self.subscription)
        self.resolver = Resolver(route)
        self.health = Health()
        self.delays = SendersDelay()
        self.facts = SenderFacts(self.flow, self.path, self.subscription, self.resolver, self.health)

    # --- setting up

    def peer_ready(self, ready: Ready) -> None:
        """Subscribe: the peer has publishers. Its counts of the previous opening settle the ledger."""
        # Asked before the event, because the peer answers each description, and only its first answer has this side
        # subscribe.
        again = self.route.life.phase is RoutePhase.READY
        if not self.route.life.handle(RouteEvent.READY):
            return
        if not self.counts.settle(ready.before, self.route.peer.instance):
            self.route.notices.doubt(self.route.peer.instance, _LIMITED)
        self.loop_filter.table.answered(ready.sources)
        described = self._described
        if described is not None and not again:
            self._end_subscription()
            self.facts.kept_there = ready.newest.keys()
            self.route.age.publishers.since = None if described.qos.latched else self.route.context.stamps.now()
            spec = TopicSpec(self.route.topic, described.type, described.type_hash, described.qos)
            self.subscription.begin(spec, known=ready.newest, resends=ready.resends)
            self.path.histories = self.subscription.histories
        self.lazy.look()
        self.route.advance()

    def proceed(self) -> None:
        self._set_up()
        if self.subscription.spec is not None and (released := self.loop_filter.release()):
            self.path.receive(released)

    def _set_up(self) -> None:
        """Do the next steps that are possible: look for publishers, describe them, open the channel, subscribe."""
        route, loops = self.route, self.loop_filter
        if not route.life.accepted or route.pausing.paused:
            self.subscription.unsubscribe()
            self._unwanted = self._unwanted or route.pausing.paused
            self.counts.lose("paused", loops.forget())  # nobody wants them when it is resumed
            return
        self.path.unpause()
        self.carried.endpoints = loops.update(route.topic, route.remote_topic)
        self.resolver.update(self.carried.endpoints)
        if self._described is not None and self._described.sources != loops.table.sources:
            # A further source needs no new subscription: only its own messages wait for the peer's answer.
            self._describe(msgspec.structs.replace(self._described, sources=loops.table.sources))
        before = self._described
        if before is not None and loops.outdated(self.flow.qos):
            route.request_reopen(EventCode.ROUTE_SOURCES_CHANGED, "its messages come through other bridges than before")
            return
        route.notices.set_loop(loops.loop(route.topic))
        if route.notices.loop:
            self._leave_out()
            return
        described = self._resolve()
        if described is None:
            if route.life.phase is RoutePhase.READY:
                self._look_who_is_present()
            return
        if before is not None and described.type_hash != before.type_hash:
            # A new opening, so that no message of the old type comes where the new one is published.
            text = f"its type has changed from {before.type} to {described.type}"
            route.request_reopen(EventCode.ROUTE_TYPE_CHANGED, text)
            return
        reliable = described.qos.reliability
        if before is not None and not route.transport.reliable and reliable != before.qos.reliability:
            # Both ends of a channel over datagrams depend on it.
            route.request_reopen(EventCode.ROUTE_RELIABILITY_CHANGED, f"its publishers offer {reliable} now")
            return
        if described != before:
            self.subscription.unsubscribe()
            route.life.handle(RouteEvent.DESCRIBE)
            self._describe(described)
        if route.life.phase is not RoutePhase.READY:
            return
        self._look_who_is_present()
        if self.carried.channel is None:
            route.peer.open_channel(route)
        crossing = route.crossing
        if crossing.flows:
            self._subscribe()
        elif crossing.is_held_back:
            self._leave_out()

    def _leave_out(self) -> None:
        """Subscribe to nothing, as messages are not to cross."""
        self.subscription.unsubscribe()
        self._unwanted = True

    def _describe(self, described: Describe) -> None:
        self._described = described
        self.flow.knows(described.type, described.type_hash, described.qos)
        self.counts.lossy = self.route.lossy
        self.route.settle_age()
        self.path.compose()  # what is latched, as its QoS says now, is asked its age later
        self.flow.end.log_other(self.carried.type_name)
        self.loop_filter.table.described()
        self._told = None  # the peer may have new outputs
        self.route.peer.send(msgspec.structs.replace(described, nodes=self.resolver.publisher_nodes))

    def _resolve(self) -> Describe | None:
        """Return the description to send, or None if type or QoS is unknown."""
        resolved = self.resolver.resolve(TypeVersion(self.carried.type_name, self.carried.type_hash), self.loop_filter)
        self.route.notices.set_warning(resolved.warning if resolved else "")
        if resolved is None:
            unresolved, there = self.resolver.unresolved, self.resolver.hint.name
            if self._described is None or unresolved is None:
                return None
            # Nothing that is published now could be sent. Once the publishers are right, it opens with their type.
            if unresolved.clash:
                self.route.request_reopen(EventCode.ROUTE_TYPE_CHANGED, str(unresolved))
            # A participant has one type on a topic: its subscription here would keep an operator's messages from them.
            elif not self.carried.endpoints and there not in ("", self.carried.type_name):
                text = f"nobody publishes {self.carried.type_name} any more, and the subscriptions there are to {there}"
                self.route.request_reopen(EventCode.ROUTE_TYPE_CHANGED, text)
            return None
        sources, qos = self.loop_filter.table.sources, resolved.qos
        if self.route.arming.required:
            qos = without_history(qos)
        return Describe(self.route.id, resolved.type, resolved.type_hash, qos, sources, resolved.keyed)

    def _subscribe(self) -> None:
        if self.subscription.spec is None or self.subscription.active:
            return
        try:
            self.subscription.subscribe(missed=not self._unwanted)
        except RosError as error:
            self.route.request_reopen(EventCode.ROUTE_SUBSCRIBE_FAILED, str(error), Level.ERROR)
            return
        self._unwanted = False
        self.flow.silence.rearm(self.route.context.now())
        self.route.judge_again()
        text = f"→ {self.route.transport.name} connected ({self.carried.type_name})"
        self.route.log(Level.INFO, EventCode.ROUTE_CONNECTED, text)

    def _end_subscription(self) -> None:
        self._told = self.path.histories = None
        self.counts.drop("link lost", self.subscription.close() + self.path.clear_later())

    def _look_who_is_present(self) -> None:
        """Tell the peer of the publishers: whether one is alive, and the depths of the histories that are not gone."""
        spec = self.subscription.spec
        if spec is None or not (spec.qos.latched or spec.qos.liveliness_lease_duration):
            return
        present, resends = {}, 0
        if (histories := self.subscription.histories) is not None:
            endpoints = self.carried.endpoints
            mute = {each.gid for each in endpoints if each.is_durable}
            depths = histories.present({each.gid for each in endpoints}, mute)
            present, resends = dict(islice(depths.items(), MOST_PUBLISHERS)), histories.resends
        told = Publishers(route=self.route.id, present=present, alive=self.subscription.alive, resends=resends)
        if told != self._told:
            self._told = told
            self.route.peer.send(told)

    def disarm(self) -> None:
        """Drop the waiting messages, and count those on their way as disarmed: the peer drops them."""
        self._leave_out()
        self.counts.lose("disarmed", self.loop_filter.forget())
        self.counts.drop("disarmed", self.path.clear())
        self.counts.disarmed()

    @property
    def places(self) -> Sequence[EndPlace]:
        return (EndPlace("subscription", self.route.topic, self.route.peer.name),)

    def move(self) -> bool:
        self.subscription.move()
        return True

    def open(self) -> None:
        self._forget_reports()
        # What was refused had nothing to lose before this opening.
        self._unwanted = self._unwanted or bool(self.route.reopening.refused)
        self.flow.full_at = None
        self.delays = SendersDelay()
        self.loop_filter.clear()
        self.counts.opened(self.route.id, self.route.peer.instance)

    def close(self, reason: str) -> None:
        """End the opening. Waiting messages are lost; messages in flight are settled with the next opening."""
        self._end_subscription()
        self._unwanted = self._unwanted or self.route.arming.required
        self.backlog.end()
        self._described = None
        self.counts.lose("link lost", self.loop_filter.forget())
        self.counts.drop("link lost", self.path.clear())
        self.loop_filter.clear()
        self.counts.closed()
        self.facts.forget()
        self.flow.drivers.there = ()
        self.flow.audience = NOBODY
        self.lazy.end()
        self._renewal.end()

    @property
    def rests(self) -> bool:
        return self.lazy.rests

    # --- messages

    def signs(self) -> Signs:
        subscription = self.subscription
        lost = subscription.numbers.counts[Untaken.LOST]
        drivers, report = self.flow.drivers.here, self.facts.report
        return self.flow.silence.watch.after, report, self.resolver.unresolved, subscription.failure, lost, drivers

    def next_change(self, now: float, crossing: Crossing) -> float:
        if not self.path.traffic.still or (self.backlog.exists and self.route.peer.linked):
            return now
        awaited, counts = crossing.flows or self.facts.lacks_publisher(crossing), self.facts.silence_counts
        changes = self.flow.next_change(now, awaited=awaited, counts=counts, polled=self._is_polled)
        return min(changes, self.health.next_change(now))

    @property
    def _is_polled(self) -> bool:
        # A topic of a similar name may appear, DDS does not tell when it matches a publisher at last, and the link may
        # get another profile.
        return not self.carried.endpoints or self.subscription.awaits_match or self._profile_limits

    @property
    def _profile_limits(self) -> bool:
        """Whether the link profile's limit is for it: it has none and may lose messages."""
        qos = self.flow.qos
        return qos is not None and qos.reliability == "best_effort" and not self.route.proposal.max_rate

    def measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        flows, ledger = crossing.flows, self.facts.ledger
        self.route.meter.publishers = sum([each.type_name == self.carried.type_name for each in self.carried.endpoints])
        awaited = self.subscription.receives if flows else self.facts.lacks_publisher(crossing)
        # A latched topic may be silent for any time, unless an operator expects a rate.
        usual = None if self.flow.is_latched else self.route.meter.usual_rate
        self.health.judge(
            self.route,
            ledger,
            now,
            self.carried.endpoints,
            usual_rate=usual,
            quiet_since=self.flow.silence.watch.quiet_since,
            flows=flows,
            awaited=awaited,
        )
        self.flow.latency.tick(now)
        if self.carried.may_move or self.route.arming.required:
            self.flow.drivers.tick(now)
            self.flow.drivers.look(self.carried.endpoints, counted=self.subscription.receives)
        self._judge_lateness(now, flows=flows, learns=learns)
        self.route.age.update(self.counts.offered, now)
        if not learns and self.route.link_full is not None:  # in this order: on a full link, nothing is learned
            self.flow.full_at = now
        if self.route.age.only_newest or self.flow.left_out.is_on:
            self.flow.left_out.judge(ledger, now)
        self._setbacks = self.counts.setbacks(self.subscription.numbers.counts)

    def goes_on(self, now: float) -> bool:
        setbacks = self.counts.setbacks(self.subscription.numbers.counts)
        if self.path.queue or self.backlog.exists or setbacks != self._setbacks:
            return False
        usual, expected = self.route.meter.usual_rate, self.health.expected_rate
        if usual is not None and expected is not None and usual < FAST_ABOVE * expected:
            return False  # it may get slow without a change, for which seconds are counted by ticks
        unreported = self.delays.unreported(self.counts.sent_now, self.counts.reported_now, now)
        delay = max(delay_of_sender(unreported, self.route.peer.keepalive.ping_delay), self.delays.reported or 0.0)
        return self.flow.goes_on(now, delay)

    def is_well(self, now: float) -> bool:
        # Of several publishers, a verdict tells once there is a rhythm.
        return (
            self.health.finds_nothing and self.flow.is_well(now) and not self.backlog.exists
            and len(self.carried.endpoints) == 1
        )  # fmt: skip

    def is_calm(self, now: float) -> bool:
        calm = not self._is_polled and self.subscription.is_settled
        return calm and self.health.is_calm and self.delays.is_outdated(now) and self.flow.is_calm(now)

    def act(self, now: float, crossing: Crossing) -> None:
        profile_rate = (self.route.peer.profile.max_rate or 0.0) if self._profile_limits else 0.0
        if self.route.limit.set_profile_rate(profile_rate) and self.route.id:
            self.route.peer.send(Limit(route=self.route.id, max_rate=self.route.limit.own))
        self.flow.act(now, awaited=crossing.flows or self.facts.lacks_publisher(crossing))
        self.subscription.tick(self.carried.endpoints)
        if self.route.age.publishers.since is None and crossing.flows and not self.flow.is_latched:
            # Messages seem old since this side's clock was set: their publisher's may lag. Only a new subscription has
            # no message from before it, so that an earlier stamp proves a wrong clock.
            late = self.route.age.late()
            if late is not None and late.cause is Cause.PUBLISHER_STAMPS_OLD:
                text = "this side's clock was set, and publishers' stamps seem old"
                self.route.request_reopen(EventCode.ROUTE_CLOCK_SET, text)

    def suspend(self) -> None:
        self.backlog.begin(self.counts.dropped[OUTAGE])

    def resume(self) -> None:
        self._forget_reports()
        self.path.resume()
        self.health.losses.reset()  # the link was silent before it was away: what it dropped then is no overload

    def _judge_lateness(self, now: float, *, flows: bool, learns: bool) -> None:
        unreported = self.delays.unreported(self.counts.sent_now, self.counts.reported_now, now)
        if self.route.lossy:  # unreported datagrams may be lost, unless pings by a stream are held up, too
            unreported = min(unreported, self.route.peer.keepalive.ping_wait)
        own = max(self.path.waits(now), delay_of_sender(unreported, self.route.peer.keepalive.ping_delay))
        if self.backlog.exists and self.route.peer.linked:
            self.backlog.judge(self.facts.ledger, now, held_up=own > LATE)
        if not flows or self.backlog.exists:  # what waited for the link is not late
            self.flow.lateness.reset()
            return
        measured = self.delays.measure(own, self.route.peer.clock.uncertainty or 0.0, now)
        self.flow.lateness.judge(self.delays.least, 0.0, self.flow.late_after, now, measured, own=own, learns=learns)

    @property
    def passed(self) -> int:
        return self.counts.offered + self.route.meter.count

    def lapse(self) -> None:
        """Nothing moves here."""

    def destroy(self) -> None:
        """Nothing outlives openings."""

    def deliver(self, messages: Sequence[Message]) -> None:
        """Gets none: the peer does not even have its key."""

    def flush(self) -> None:
        self.path.flush()

    def configure(self) -> None:
        self.flow.set_stale_after()
        self.path.compose()
        self.lazy.look()

    # --- the ledger

    def reported(self, report: ReceivedCounts | ReceivedReport) -> None:
        """Take what the peer knows of the present opening."""
        if isinstance(report, ReceivedCounts):
            self._counted(report)
            return
        if report.malformed not in ("", self.facts.malformed):
            whose = f"{self.carried.type_name} to {self.route.peer.name}"
            text = f"malformed {whose}: {report.malformed}: see the node here that sent it"
            self.route.notices.message_error(EventCode.ROUTE_MALFORMED, text)
        self.facts.report = report
        self.resolver.published_there = PublishedAs(report.publishers, report.published_as)
        self.flow.drivers.told(report.drivers)
        self.route.wake()
        deaf = tuple(Deaf(each.node, each.cause, each.reason) for each in report.deaf)
        self.flow.audience = Audience(max(0, report.subscribers), report.nodes, deaf)
        self.route.judged.receive(report.verdict, self.route.context.now())
        if (report.type, report.type_hash) != self.resolver.hint:
            self.resolver.hint = TypeVersion(report.type, report.type_hash)
            self.route.advance()
        self._renewal.told(self.flow.audience.count, rests=self.rests)
        self.lazy.told(wanted=report.wanted)

    def _counted(self, counts: ReceivedCounts) -> None:
        """Take the peer's figures of the present opening."""
        now = self.route.context.now()
        self.facts.velocity = counts.velocity
        delay = self.delays.with_report(self.route.peer.keepalive.ping_delay)
        if not self.counts.reported(counts, now, delay):
            self.route.notices.doubt(self.route.peer.instance, _LIMITED)
        if not self.route.idling.is_steady(now):  # else the next look finds out by what was counted here
            self.route.wake()
            if self.counts.received_now:
                self.route.losses.arrived()
        if counts.latency is not None:
            self.delays.receive(counts.latency, now)
        if counts.latency_p50 is not None:
            self.flow.latency.take_reported(counts.latency_p50, counts.latency_p99, counts.jitter, now)

    def receiver_left(self) -> None:
        """Take the peer's last report for final, as it leaves with a goodbye."""
        self.counts.receiver_left()

    def news(self) -> Sequence[SentCounts | SentReport]:
        if self.route.idling.goes_on_now:
            return ()
        news: list[SentCounts | SentReport] = []
        ledger = self.facts.ledger
        counts = SentCounts(
            route=self.route.id,
            offered=ledger.offered,
            delivered=ledger.delivered,
            in_flight=ledger.in_flight,
            waiting=ledger.waiting,
            dropped=ledger.dropped,
            throttled=ledger.throttled,
            expired=ledger.expired,
            unknown=ledger.unknown,
            lost_in_dds=ledger.lost_in_dds,
            missed_while_down=ledger.missed_while_down,
            unsubscribed=ledger.unsubscribed,
            again=ledger.again,
        )
        if counts != self._last_counts:
            self._last_counts = counts
            # With the age, all counts would differ from the ones before while a message waits.
            waited = self.path.waits(self.route.context.now()) if counts.waiting else 0.0
            news.append(msgspec.structs.replace(counts, waited=waited) if waited else counts)
        if (report := self._report()) is not None:
            news.append(report)
        return news

    def _report(self) -> SentReport | None:
        """Return what the peer does not know beside the counts, or None if it knows all."""
        verdict, resolver, drivers = self.route.verdict(for_peer=True), self.resolver, self.flow.drivers
        publishers, subscribed = len(self.carried.endpoints), self.subscription.receives
        contents = (
            self.route.id, publishers, resolver.publisher_qos, subscribed, verdict, resolver.publisher_nodes,
            drivers.here,
        )  # fmt: skip
        if contents == self._reported and self._last_report is not None:
            return None
        self._reported = contents
        report = SentReport(
            route=self.route.id,
            publishers=publishers,
            publisher_qos=resolver.publisher_qos,
            subscribed=subscribed,
            verdict=record_of(verdict),
            nodes=resolver.publisher_nodes,
            drivers=drivers.records,
        )
        if report == self._last_report:
            return None
        self._last_report = report
        # With its duration, each verdict would differ from the one before.
        return msgspec.structs.replace(report, verdict=lasting(report.verdict, verdict, self.route.context.now()))

    def _forget_reports(self) -> None:
        self._last_counts = self._last_report = None

    def takes(self, gid: bytes) -> bool:
        """Whether messages of a publisher here are taken now, or held until their origin is found out."""
        return self.subscription.receives and not self.loop_filter.table.left_out(gid)
