"""The sending half of a route: describe, subscribe, send; and the ledger, which the sender keeps."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import msgspec

from rsb_bridge.channel.datagram_channel import DatagramSender
from rsb_bridge.channel.receipts import WindowedSender
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Ledger, Level, Stage
from rsb_bridge.ros.ros_interface import RawMessage, RosError
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.combined_verdict import lasting, node_names, record_of
from rsb_bridge.route.lateness import QUEUE, WAY, Unreported, delay_of_sender
from rsb_bridge.route.ledger import RouteLedger, reported_drops
from rsb_bridge.route.lifecycle import Event
from rsb_bridge.route.loop_filter import LoopFilter
from rsb_bridge.route.peer import TypeUse
from rsb_bridge.route.resolving import MessageType, Resolver, qos_clash
from rsb_bridge.route.sending import Sending
from rsb_bridge.route.topic_route import MEASURED_FOR, TopicRoute
from rsb_bridge.route.topic_subscription import SubscriptionSpec, TopicSubscription
from rsb_bridge.route.topic_verdict import LATELY, no_subscriber
from rsb_bridge.telemetry.watches import LossWatch, SlowWatch, StopWatch
from rsb_bridge.transport.transport import DatagramTransport
from rsb_bridge.wire.fields import MOST_PUBLISHERS
from rsb_bridge.wire.headers import publisher_id
from rsb_bridge.wire.messages import Describe, Propose, Publishers, Ready
from rsb_bridge.wire.records import ReceivedReport, SentReport

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.route import Owner
    from rsb_bridge.route.topic_verdict import Facts

_REPORTED_LATELY = 2.5
"""s for which a delay that the receiver has reported counts."""
_LONGEST_DELAY = 3600.0
"""s; a longer delay is taken for a mistake."""
_LONGEST_UNDER_WAY = 60.0
"""s; a message that is in transit for longer is lost."""
_JITTERS = 2.0
"""Times the jitter: that a message takes so much longer says nothing."""
_LIMITED = "they are limited to what was sent"


class Flow(NamedTuple):
    """A route's messages, as far as they are watched.

    Attributes:
        flowing: messages could cross now.
        last: s, when the last one was sent, or since when they could cross.
        rate: Hz.
        given_rate: Hz, that an operator expects; 0: none.
        usual_rate: Hz, learned; None: not known.
        limit: Hz that an operator allows; 0: all.
        publishers: which there are.
        ledger: where the messages went.
    """

    flowing: bool
    last: float
    rate: float
    given_rate: float
    usual_rate: float | None
    limit: float
    publishers: frozenset[bytes]
    ledger: Ledger


class Health:
    """How well a sending half's messages flow, watched once a second.

    Attributes:
        expected_rate: Hz, that the route is judged by; None: it is not known, or messages come at random.
    """

    def __init__(self) -> None:
        self.expected_rate: float | None = None
        self._slow = SlowWatch()
        self._stop = StopWatch()
        self._loss = LossWatch()
        self._lost_in_dds: deque[int] = deque(maxlen=LATELY)

    def tick(self, flow: Flow, now: float) -> None:
        """Once a second, at `now` (s)."""
        ledger = flow.ledger
        self._lost_in_dds.append(ledger.lost_in_dds)
        self._loss.tick(ledger.delivered, ledger.dropped, now)
        expected = flow.given_rate or flow.usual_rate
        if expected and flow.limit:
            expected = min(expected, flow.limit)
        self.expected_rate = expected
        if expected is None or not flow.flowing:
            self._stop.reset()
            self._slow.reset()
            return
        self._stop.tick(flow.last, expected, now, flow.publishers, promised=bool(flow.given_rate))
        if self._stop.since is not None:
            self._slow.reset()
        elif not self._stop.quiet:  # a pause is not slow
            self._slow.tick(flow.rate, expected, now)

    def added_to(self, facts: Facts) -> Facts:
        """The facts of a route with what the watches say."""
        lost = self._lost_in_dds
        return facts._replace(
            expected_rate=self.expected_rate,
            stopped_since=self._stop.since,
            slow_since=self._slow.since,
            loss=self._loss.loss,
            lost_in_dds=max(0, lost[-1] - lost[0]) if lost else 0,
        )


class OutgoingRoute(TopicRoute):
    """Takes a topic's messages here and sends them to the peer.

    Attributes:
        delay: s that messages take at least; needs no clock of the other side.
        longer: s that messages take beyond the shortest time of this opening and their jitter, as the receiver reports.
    """

    outgoing: ClassVar[bool] = True
    channel: SendingChannel | None

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._intake: TopicSubscription | None = None
        self._type = TypeUse(context.ros, peer.budget.types)
        self._present: frozenset[bytes] | None = None  # the publishers that the peer was told of
        self._ledger = RouteLedger(numbered=isinstance(self.transport, DatagramTransport))
        self._report: ReceivedReport | None = None  # of the present opening
        self._kept_there: Collection[bytes] = ()  # publishers of a latched topic whose messages the peer keeps
        self._described: Describe | None = None
        self._loop_filter = LoopFilter(context, peer, self.advance)
        self._sending = Sending(context, self, self._ledger, self._loop_filter)
        self.limit.apply = self._sending.limit
        self._resolver = Resolver(context, proposal)
        self._health = Health()
        self._unreported = Unreported()
        self.delay = self.longer = 0.0
        self._reported_delay: tuple[float, float] | None = None  # s, by the receiver; and when it reported it, s
        self._shortest: float | None = None  # s, by the receiver

    # --- setting up

    def peer_ready(self, ready: Ready) -> None:
        """The peer has a publisher for what was described, and says what it counted in the opening before this one."""
        again = self.life.ready
        if not self.life.take(Event.READY):
            return
        if not self._ledger.settle(ready.before, self.peer.instance):
            self.notices.doubt(self.peer.instance, _LIMITED)
        self._loop_filter.table.answered(ready.sources)
        described = self._described
        if described is not None and not again:
            self._end_intake()
            self._kept_there = ready.newest.keys()
            self.age.publishers.since = None if described.qos.latched else self.context.stamps.now()
            self._intake = TopicSubscription(
                self.context,
                self,
                SubscriptionSpec(self.topic, described.type, described.type_hash, described.qos, self.peer.name),
                automatic=self.proposal.qos is None,
                expected_rate=self.spec.expected_rate,
                known=ready.newest,
                marks=lambda: self.arming.lease if self.arming.required else None,
            )
        self.advance()

    def advance(self) -> None:
        """See who publishes; resolve type and QoS, describe them, make the path, subscribe: whatever is next."""
        self._advance()
        if self._intake is not None and (released := self._loop_filter.release()):
            self._intake.take(released)

    def _advance(self) -> None:
        if not self.accepted or self.paused:
            self._unsubscribe()
            self._lose("paused", self._loop_filter.forget())  # nobody wants them when it is resumed
            return
        self._sending.resume()
        self.endpoints = self._loop_filter.look(self.topic, self.remote_topic)
        self._resolver.look(self.endpoints)
        if self._described is not None and self._described.sources != self._loop_filter.table.sources:
            self._describe(msgspec.structs.replace(self._described, sources=self._loop_filter.table.sources))
        if self._described is not None and self._loop_filter.outdated(self.qos):
            self.request_reopen(EventCode.ROUTE_SOURCES_CHANGED, "other bridges than before bring its messages")
            return
        self.notices.set_loop(self._loop_filter.loop(self.topic))
        if self.notices.loop:
            self._unsubscribe()
            return
        described = self._resolve()
        if described is None:
            if self.life.ready:
                self._look_who_is_present()
            return
        if self._described is not None and described.type_hash != self._described.type_hash:
            # A new opening, so that no message of the old type comes where the new one is published.
            self.request_reopen(
                EventCode.ROUTE_TYPE_CHANGED, f"its type has changed from {self._described.type} to {described.type}"
            )
            return
        if described != self._described:
            self._unsubscribe()
            self.life.take(Event.DESCRIBE)
            self._describe(described)
        if not self.life.ready:
            return
        self._look_who_is_present()
        if self.channel is None:
            self.peer.open_channel(self)
        if not self.arming.stands(self.context.now()):
            self._unsubscribe()
        elif self.channel is not None and self.channel.ready:
            self._subscribe()

    def _describe(self, described: Describe) -> None:
        self._described = described
        self.type_name, self.type_hash, self.qos = described.type, described.type_hash, described.qos
        self.settle_age()
        self._loop_filter.table.described()
        self._present = None  # the peer may have new outputs
        self.peer.send(described)

    def _resolve(self) -> Describe | None:
        """What is sent; None: not known yet."""
        resolved = self._resolver.resolve(MessageType(self.type_name, self.type_hash), self._loop_filter)
        self.notices.set_warning(resolved.warning if resolved else "")
        if resolved is None:
            unresolved = self._resolver.unresolved
            if unresolved is not None and unresolved.clash and self._described is not None:
                # Nothing that is published now could be sent. Once the publishers are right, it opens with their type.
                self.request_reopen(EventCode.ROUTE_TYPE_CHANGED, str(unresolved))
            return None
        sources, qos = self._loop_filter.table.sources, resolved.qos
        if self.arming.required:
            qos = without_history(qos)
        return Describe(route=self.id, type=resolved.type, type_hash=resolved.type_hash, qos=qos, sources=sources)

    def _subscribe(self) -> None:
        if self._intake is None or self._intake.active:
            return
        try:
            self._type.begin(self.type_name, self.type_hash)
            self._intake.subscribe()
        except RosError as error:
            self.request_reopen(EventCode.ROUTE_SUBSCRIBE_FAILED, str(error), Level.ERROR)
            return
        self._ledger.missed.subscribed(self.context.now(), self._ledger.offered)
        self.silence.rearm(self.context.now())
        self._verdict = None
        self.log(Level.INFO, EventCode.ROUTE_CONNECTED, f"→ {self.transport.name} connected ({self.type_name})")

    def _unsubscribe(self) -> None:
        if self._intake is not None:
            self._intake.unsubscribe()
            self._type.end()

    def _end_intake(self) -> None:
        self._present = None
        if self._intake is not None:
            self._ledger.drop("link lost", self._intake.close() + self._sending.clear_later())
            self._ledger.lost_in_dds += self._intake.lost
            self._intake = None
            self._type.end()

    def _look_who_is_present(self) -> None:
        """Have the histories of publishers that are gone dropped, here and by the peer."""
        if self._intake is None or self.qos is None or not self.qos.latched:
            return
        gids = {endpoint.gid for endpoint in self.endpoints}
        self._intake.look(gids)
        present = frozenset(publisher_id(gid) for gid in gids)
        if present != self._present:
            self._present = present
            self.peer.send(Publishers(route=self.id, present=tuple(present)[:MOST_PUBLISHERS]))

    def log_intake(self, level: Level, code: EventCode, text: str) -> None:
        """Add an event about the subscription."""
        if level is Level.ERROR:
            self.notices.last_error = text
        self.log(level, code, text)

    @property
    def _failure(self) -> str:
        return self._intake.failure if self._intake is not None else ""

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Drop what waits, here and on the way."""
        self._unsubscribe()
        self._lose("disarmed", self._loop_filter.forget())
        self._ledger.drop("disarmed", self._sending.clear())
        self._ledger.disarmed()
        super().disarm(why, reason)

    def open(self, route_id: int) -> None:
        """Begin a new opening."""
        super().open(route_id)
        self._unreported = Unreported()
        self._reported_delay = self._shortest = None
        self.delay = self.longer = 0.0
        self._loop_filter.clear()
        self._ledger.opened(route_id, self.peer.instance)

    def close(self, reason: str) -> None:
        """End the opening; what waits is lost, and what is under way is settled when the peer is back."""
        if self.endpoints and self._subscribed and not self.arming.required:
            self._ledger.missed.lost(self.context.now())
        self._end_intake()
        self._described = None
        self._kept_there = ()
        self._lose("link lost", self._loop_filter.forget())
        self._ledger.drop("link lost", self._sending.clear())
        self._loop_filter.clear()
        self._ledger.closed()
        self._report = None
        super().close(reason)

    # --- messages

    def tick(self) -> None:
        now = self.context.now()
        latched = self.is_latched  # may be silent for any time, unless an operator expects a rate
        self._health.tick(
            Flow(
                self.flowing and self._subscribed,
                self.silence.quiet_since,
                self.meter.rate,
                self.spec.expected_rate or 0.0,
                None if latched else self.meter.usual_rate,
                self.thinning.limit(self.limit.rate),
                frozenset([each.gid for each in self.endpoints]),
                self.ledger(),
            ),
            now,
        )
        self._tick_missed(now, latched=latched)
        super().tick()
        if self._intake is not None:
            self._intake.tick()

    def _tick_missed(self, now: float, *, latched: bool) -> None:
        """Learn the rate at which messages cross, or estimate how many are missed now."""
        missed = self._ledger.missed
        if missed.down:
            missed.tick(now, self._ledger.offered, published=self._is_published)
        elif self.flowing:
            usual = None if latched else self.meter.usual_rate
            rate, limit = usual or self.spec.expected_rate, self.limit.rate
            missed.rate = min(rate, limit) if rate and limit else rate

    @property
    def _is_published(self) -> bool:
        """Whether somebody publishes the topic, and neither side has paused or refused it."""
        if self.paused or self._refused:
            return False
        own = self.context.announcements.own_publishers(self.topic, besides=self.peer.name)
        return bool(own or self.context.ros.publishers(self.topic))

    def _tick_lateness(self, now: float) -> None:
        unreported = self._unreported.age(self._ledger.sent_now, self._ledger.reported_now, now)
        self.delay = 0.0
        if not self.flowing:
            self.lateness.reset()
            return
        measured = None
        if (
            self._reported_delay is not None
            and now - self._reported_delay[1] <= _REPORTED_LATELY
            and not self.thinning.holds
        ):
            measured = self._reported_delay[0]
        else:
            self.longer = 0.0
        if not self.transport.reliable:  # unreported datagrams may be lost, unless pings by a stream are held up, too
            unreported = min(unreported, self.peer.ping_wait)
        own = max(self._sending.waits(now), delay_of_sender(unreported, self.peer.report_delay))
        self.delay = max(own, (measured or 0.0) - (self.peer.clock_uncertainty or 0.0))
        self.lateness.tick(self.delay, 0.0, self.late_after, now, measured, own=own, learns=self.learns)

    @property
    def _message_and_report(self) -> float:
        """Estimated s that a message and its report take together."""
        back = self.peer.report_delay
        there = 0.0 if self._reported_delay is None else self._reported_delay[0]
        return min(max(0.0, there, back) + back, _LONGEST_UNDER_WAY)

    def _held_up_where(self) -> str:
        return QUEUE if self._sending.waits(self.context.now()) >= self.lateness.seconds / 2 else WAY

    def admit(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """The messages to take now; those that would loop are lost, those whose source is not known yet are held."""
        if not self.arming.passes(self.context.now()):
            self._lose("disarmed", len(batch))
            return ()
        if self.age.is_on or self.peer.stamp_shift:
            batch = self._stamped(batch)
        if self._loop_filter.carries(batch):
            return batch
        admitted, unseen = self._loop_filter.admit(batch)
        if unseen:
            self.advance()  # see whose they are
            flags = self._loop_filter.table.flags
            sent = [message for message in admitted if message.gid in flags]  # what is known of these may have changed
            self._lose("would loop" if self.id else "link lost", len(admitted) - len(sent))
            admitted = sent
        self._lose("queue full", self._loop_filter.give_up())
        return admitted

    def _stamped(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """Return the messages that are young enough, with the stamps for the other side."""
        if not self.age.is_on:
            shift = self.peer.stamp_shift
            return [each._replace(stamp=shifted(each.stamp, shift)) for each in batch]
        young = self.age.stamped(batch, keep_old=self.is_latched)
        expired = len(batch) - len(young)
        self._ledger.offered += expired
        self._ledger.expired += expired
        return young

    @property
    def _came_here(self) -> int:
        return self._ledger.offered

    def too_late(self, messages: int) -> None:
        """Messages have come after the end of their opening."""
        self._lose("link lost", messages)

    def _lose(self, cause: str, messages: int) -> None:
        self._ledger.offered += messages
        self._ledger.drop(cause, messages)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        """Take messages from ROS, oldest first."""
        self._sending.offer(batch)

    def offer_latched(self, new: int, samples: Sequence[Sample]) -> None:
        """Take messages of a latched topic."""
        self._sending.offer_latched(new, samples)

    def flush(self) -> None:
        """Send what waits while the path takes it."""
        self._sending.flush()

    # --- the ledger

    def reported(self, report: ReceivedReport) -> None:
        """The peer said what arrived in the present opening."""
        self._report = report
        self.judged.take(report.verdict, self.context.now())
        if not self._ledger.reported(report, self.context.now(), self._message_and_report):
            self.notices.doubt(self.peer.instance, _LIMITED)
        if self._ledger.received_now:
            self.losses.arrived()
        if (report.type, report.type_hash) != self._resolver.hint:
            self._resolver.hint = MessageType(report.type, report.type_hash)
            self.advance()
        if report.latency is not None and abs(report.latency) <= _LONGEST_DELAY:
            self._reported_delay = report.latency, self.context.now()
            self._shortest = report.latency if self._shortest is None else min(self._shortest, report.latency)
            # In a queue one message takes as long as the next; where they do not, the path is uneven, not full.
            self.longer = max(0.0, report.latency - self._shortest - _JITTERS * max(0.0, report.jitter or 0.0))
        self.latency.told(report.latency_p50, report.latency_p99, report.jitter)

    def ledger(self) -> Ledger:
        """Where the messages went, by the peer's last report."""
        lost_in_dds = self._intake.lost if self._intake else 0
        return self._ledger.ledger(lost_in_dds)

    def news(self) -> SentReport | None:
        """The report that the peer has not been sent yet; None: it knows everything."""
        report = self._sent_report()
        if report == self._told_report:
            return None
        self._told_report = report
        verdict = lasting(report.verdict, self.verdict(), self.context.now())
        return msgspec.structs.replace(report, verdict=verdict)

    def _sent_report(self) -> SentReport:
        ledger = self.ledger()
        return SentReport(
            route=self.id,
            offered=ledger.offered,
            delivered=ledger.delivered,
            throttled=ledger.throttled,
            expired=ledger.expired,
            in_flight=ledger.in_flight,
            dropped=reported_drops(ledger),
            lost_in_dds=ledger.lost_in_dds,
            missed_while_down=ledger.missed_while_down,
            publishers=len(self.endpoints),
            publisher_qos=self._resolver.publisher_qos,
            subscribed=self._subscribed,
            verdict=record_of(self.verdict()),
            nodes=node_names(self.endpoints),
        )

    @property
    def _subscribed(self) -> bool:
        return self._intake is not None and self._intake.active and not self._intake.failure

    @property
    def has_kept(self) -> bool:
        """Whether the peer keeps messages of a publisher that still exists."""
        return bool(self._kept_there) and any(publisher_id(each.gid) in self._kept_there for each in self.endpoints)

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

    def end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return node_names(self.endpoints), self._report.nodes if self._report else ()

    def facts(self) -> Facts:
        unresolved = self._resolver.unresolved
        facts = super().facts()
        facts = facts._replace(
            similar=self._resolver.similar,
            breaking="" if self.peer.full_out is not None or self.peer.fullness_undecided else self.losses.repeated,
            subscribe_failed=self._failure,
            unresolved=(unresolved.cause, self._resolver.why()) if unresolved and self.accepted else None,
            left_out=self.notices.warning,
            rate=self.meter.rate,
            datagrams=self._datagrams(),
        )
        facts = self._health.added_to(facts)
        loss = facts.loss
        if loss is None or self.peer.full_out is not None:
            return facts
        new = self.context.now() - loss.since < MEASURED_FOR
        return facts._replace(
            loss_unexplained=new or self.peer.fullness_undecided,
            loss_of_full_link=self.was_full_since(loss.since),
        )

    @property
    def arrived_share(self) -> float | None:
        """The share of its datagrams that arrives, or None without datagrams or before the first receipt."""
        return self.channel.arrived_share if isinstance(self.channel, DatagramSender) else None

    @property
    def starts(self) -> bool:
        """Whether its channel does not yet send as fast as it can, so that messages wait though the link has room."""
        return isinstance(self.channel, WindowedSender) and self.channel.grows

    @property
    def messages_by_datagrams(self) -> float:
        """Messages/s that arrive by the count of their datagrams, or 0 if each message is one datagram."""
        datagrams = self._datagrams()
        if datagrams < 2 or not isinstance(self.channel, DatagramSender):
            return 0.0
        return self.channel.arrival_rate() / datagrams

    def _datagrams(self) -> int:
        """How many datagrams one of its messages takes; 0: it goes by none."""
        if not isinstance(self.channel, DatagramSender) or not self.meter.count or not self.channel.ready:
            return 0
        return self.channel.datagrams(self.meter.bytes // self.meter.count)

    def _stages(self) -> tuple[Stage, ...]:
        """From the publisher here to the subscriber there."""
        report = self._report
        known = self.life.described
        publishers = len(self.endpoints)
        looks = self.accepted and not self.paused
        failed = self._resolver.unresolved.stage if self._resolver.unresolved else ""
        clash = qos_clash(self.endpoints, self.type_name, self.qos)
        failure = self.notices.loop or self._failure
        return (
            Stage(
                "publisher seen",
                publishers > 0 or (False if looks else None),
                f"{publishers}{self._loop_filter.left_out()}" if publishers else self._resolver.no_publisher(),
            ),
            Stage(
                "type known",
                known or (False if failed == "type known" else None),
                self.type_name if known else self._resolver.why(),
            ),
            Stage("QoS compatible", not clash if known else None, clash),
            Stage("subscribed", False if failure else self._subscribed or None, failure),
            self._link_stage(),
            self._accepted_stage(),
            Stage("sent", self._ledger.sent_now > 0 or self.has_kept or None),
            Stage("received", self._ledger.received_now > 0 or self.has_kept or None),
            Stage("published", self._ledger.delivered_now > 0 or self.has_kept or None),
            Stage(
                "subscriber seen",
                (report is not None and report.subscribers > 0) or None,
                "" if report is None or report.subscribers else no_subscriber(self.remote_topic, "there", report.nodes),
            ),
        )
