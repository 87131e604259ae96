"""The knowledge of a topic's halves: for the verdict, the stages and the snapshot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.fates import BEST_EFFORT, RELIABLE
from rsb_bridge.model.qos import incompatible
from rsb_bridge.model.snapshot import Ledger, Stage
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.model.verdict import EXPIRES, LASTING, Cause, LinkCause
from rsb_bridge.route.blocking_rules import stages_with_link
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.half import Facts
from rsb_bridge.route.lateness import QUEUE, REPORTED_LATELY, WAY, Late
from rsb_bridge.route.ledger import LOSS_CAUSES, OUTAGE
from rsb_bridge.route.listeners import no_subscriber
from rsb_bridge.route.rest_message import velocity_on
from rsb_bridge.route.route import promised_keep
from rsb_bridge.route.topic_flow import MEASURED_FOR
from rsb_bridge.wire.headers import resends_of

if TYPE_CHECKING:
    from collections.abc import Collection
    from functools import partial

    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.channel.scheduler import SendingChannel
    from rsb_bridge.model.fates import Fates
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.half import Carried
    from rsb_bridge.route.health import Health
    from rsb_bridge.route.incoming_path import IncomingPath
    from rsb_bridge.route.listeners import Listeners
    from rsb_bridge.route.resolving import Resolver
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.sending import OutgoingPath
    from rsb_bridge.route.topic_flow import TopicFlow
    from rsb_bridge.route.topic_subscription import TopicSubscription
    from rsb_bridge.wire.records import ReceivedReport, SentReport

_UNUSUAL = frozenset({Cause.LATE, *LOSS_CAUSES, *EXPIRES})
_NO_TYPE = frozenset({Cause.TYPE_UNKNOWN, Cause.TYPE_CONFLICT})
_NO_PUBLISHER = frozenset({Cause.NO_PUBLISHER, Cause.SIMILAR_NAME, Cause.PUBLISHED_THERE})
_NODES_START_IN = 10.0
"""s from an opening for which a topic without a publisher only waits: nodes that start with the bridge are up by then.
A round figure: nothing was measured; with a tenth of it, each boot of a robot would begin with faults."""


class TopicFacts(Facts, ABC):
    """The knowledge of one half of a topic."""

    route: Route
    flow: TopicFlow
    carried: Carried[Any]

    @property
    @abstractmethod
    def ledger(self) -> Ledger:
        """The ledger, as far as this half knows it."""

    @property
    @abstractmethod
    def has_kept(self) -> bool:
        """Whether the receiving side keeps messages of a latched topic."""

    @property
    @abstractmethod
    def silence_counts(self) -> bool:
        """Whether silence counts against the topic now, as this half sees it."""

    @abstractmethod
    def ends(self) -> tuple[tuple[str, ...], Qos | None, Qos | None]:
        """Return the original publishers' nodes, the QoS that they offer, and what the final subscriptions request."""

    def lacks_publisher(self, _: Crossing) -> bool:
        """Whether messages are missing because nobody publishes them here."""
        return False

    def _held_up_where(self) -> str:
        """Return where late messages are held up, or an empty string if this half does not know it."""
        return ""

    @property
    def on_end(self) -> str:
        return self.flow.end.of(self.carried.type_name)

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        return (TypeVersion(self.carried.type_name, self.carried.type_hash),)

    @property
    def fates(self) -> Fates:
        # Kept messages must not get lost. Over datagrams both ends have to agree, and both know only the QoS.
        qos, kept = self.flow.qos, self.route.proposal.keep is not None and self.route.transport.reliable
        return RELIABLE if kept or qos is None or qos.reliability != "best_effort" else BEST_EFFORT

    @property
    def lifespan(self) -> float:
        return 0.0 if self.flow.qos is None else self.flow.qos.lifespan

    @property
    def may_not_be_late(self) -> bool:
        return self.carried.may_move and promised_keep(self.route) is None

    @property
    def learns(self) -> bool:
        """Whether neither the link is full in this direction nor messages are late or lost.

        A slow publisher is no obstacle: a lower rate becomes the usual one after some time.
        """
        late, unusual = self.flow.lateness.since is not None, self.route.judged.shown_cause in _UNUSUAL
        return not (late or unusual) and self.route.link_full is None

    @property
    def came(self) -> bool:
        last = self.route.meter.last
        return (last is not None and last >= self.route.opened_at) or self.has_kept

    def late(self) -> Late | None:
        """Return the delay of messages that are late, or None."""
        watch, route = self.flow.lateness, self.route
        if watch.since is None:
            return None
        was_full = self.flow.was_full_since(watch.since)
        undecided = route.outgoing and route.context.now() - watch.since < MEASURED_FOR
        where = self._held_up_where()
        return Late(watch.seconds, watch.usual, where, route.link_full, watch.since, was_full, undecided)

    def stale_since(self, crossing: Crossing) -> float | None:
        """Return since when (s) messages that are due have not come, if that is too long ago, or None."""
        if not (crossing.flows or self.lacks_publisher(crossing)):
            return None
        fault, meter, watch = self.route.peer.path.fault, self.route.meter, self.flow.silence.watch
        # The sending side cannot say now that its publishers are silent: an expected message waits for the link.
        silent = fault and fault.cause is LinkCause.SILENT
        if silent and not self.route.outgoing and meter.usual_rate and not meter.rate:
            return watch.quiet_since
        return watch.quiet_since if watch.stale(self.route.context.now()) and self.silence_counts else None

    def snapshot_of(self, common: partial[RouteSnapshot]) -> RouteSnapshot:
        flow = self.flow
        nodes, publisher_qos, subscriber_qos = self.ends()
        p50, p99 = flow.latency.percentiles()
        return common(
            qos=flow.qos,
            publisher_qos=publisher_qos,
            subscriber_qos=subscriber_qos,
            ledger=self.ledger,
            latency_p50=p50,
            latency_p99=p99,
            jitter=flow.latency.jitter,
            publishers=nodes,
            subscribers=flow.audience.subscribers,
            audience=flow.audience,
            drivers=flow.drivers.all if flow.drivers.here or flow.drivers.there else (),
        )


class SenderFacts(TopicFacts):
    """The knowledge of a topic's sending half.

    Attributes:
        health, path, subscription, resolver: of its half.
        report: the peer's last one in the present opening, or None.
        kept_there: publishers of a latched topic whose messages the peer keeps.
    """

    velocity: Velocity | None = None  # that the peer has told in the present opening

    def __init__(
        self,
        flow: TopicFlow,
        path: OutgoingPath,
        subscription: TopicSubscription,
        resolver: Resolver,
        health: Health,
    ) -> None:
        self.route, self.flow = flow.route, flow
        self.carried: Carried[SendingChannel] = flow.carried
        self.path, self.subscription, self.resolver, self.health = path, subscription, resolver, health
        self.report: ReceivedReport | None = None
        self.kept_there: Collection[bytes] = ()

    def forget(self) -> None:
        """Forget what the peer has told in an opening that is over."""
        self.report, self.velocity, self.kept_there = None, None, ()

    @property
    def ledger(self) -> Ledger:
        """The ledger as it is now, by the peer's last report; it is counted anew each time."""
        ledger, context = self.path.ledger.ledger(self.subscription.numbers.counts), self.route.context
        if ledger.waiting and (waited := self.path.waits(context.now())):
            return replace(ledger, waiting_since=context.wall_of(context.clock.steady() - waited))
        return ledger

    def stages(self) -> tuple[Stage, ...]:
        described, kept, counts, report = self.route.life.described, self.has_kept, self.path.ledger, self.report
        if self.carried.endpoints:
            seen = Stage("publisher seen", True, f"{len(self.carried.endpoints)}{self.path.loop_filter.left_out()}")
        else:
            looks = self.route.life.accepted and not self.route.pausing.paused
            seen = Stage("publisher seen", False if looks else None, self.resolver.no_publisher())
        if described:
            known = Stage("type known", True, self.carried.type_name)
        else:
            known = Stage("type known", False if self.unresolved in _NO_TYPE else None, self.resolver.why())
        clash = self._qos_clash()
        matches = Stage("QoS compatible", not clash if described else None, clash)
        failure = self.route.notices.loop or self.subscription.failure
        why = failure or ("it rests" if self.route.half.rests else "")
        subscribed = Stage("subscribed", False if failure else self.subscription.receives or None, why)
        undelivered = self.route.notices.undelivered
        sent = Stage("sent", True) if counts.sent_now or kept else Stage("sent", None, undelivered)
        received = Stage("received", counts.received_now > 0 or kept or None, undelivered)
        published = Stage("published", counts.delivered_now > 0 or kept or None)
        if report is None or report.subscribers:
            heard = Stage("subscriber seen", None if report is None else True)
        else:
            heard = Stage("subscriber seen", None, no_subscriber(self.route.far_topic, None, report.deaf))
        return stages_with_link(self, (seen, known, matches, subscribed), (sent, received, published, heard))

    @property
    def owing(self) -> bool:
        return self.ledger.open > 0

    @property
    def large_vanish(self) -> bool:
        loss, channel = self.health.losses.loss, self.carried.channel
        if loss is None or loss.lost < loss.of or channel is None or self.datagrams() < 2:
            return False
        # A part of a message's datagrams may arrive, on a full link for example, and none of the messages.
        return channel.unheard_for > REPORTED_LATELY and not channel.trouble()

    @property
    def breaking(self) -> str:
        losses, fullness = self.route.losses, self.route.peer.fullness
        # A full link crowds a topic out until its connection breaks; the text would blame firewalls.
        if not losses.reasons or fullness.out is not None or fullness.undecided:
            return ""
        return losses.repeated

    def waiting_text(self) -> str:
        dropped = self.path.ledger.dropped[OUTAGE] - self.path.backlog.dropped_before
        older = f", {dropped:,} older dropped" if dropped else ""
        return f"waiting {LASTING}, {self.ledger.waiting:,} kept{older}"

    @property
    def came_before(self) -> bool:
        """Whether either side knows of messages in an earlier opening, and none came in this one."""
        there = self.report is not None and self.report.came_before
        return (self.route.meter.last is not None or there) and not self.came

    @property
    def nodes_there(self) -> tuple[str, ...]:
        return self.flow.audience.nodes

    def ends(self) -> tuple[tuple[str, ...], Qos | None, Qos | None]:
        asked = self.report.subscriber_qos if self.report else None
        return self.resolver.publisher_nodes, self.resolver.publisher_qos, asked

    @property
    def present_type(self) -> TypeVersion:
        if self.carried.type_name and self.carried.endpoints:
            return TypeVersion(self.carried.type_name, self.carried.type_hash)
        hint, named = self.resolver.hint, self.route.spec.type
        # Only the session's type crosses, even if nodes of the other side have another one.
        return hint if named == "auto" or expand_type_name(named) == hint.name else TypeVersion(expand_type_name(named))

    @property
    def has_kept(self) -> bool:
        """Whether the peer keeps messages of a publisher that still exists."""
        kept = self.kept_there
        return bool(kept) and any(resends_of(each.gid, kept) is not None for each in self.carried.endpoints)

    def lacks_publisher(self, crossing: Crossing) -> bool:
        # Type and QoS are a publisher's, so that without one nothing is described, and nothing flows.
        unpublished = self.resolver.unresolved is not None and not self.carried.endpoints
        started = self.route.context.now() - self.route.opened_at >= _NODES_START_IN
        return unpublished and started and self.route.life.accepted and crossing is Crossing.NOT_OPEN

    @property
    def silence_counts(self) -> bool:
        """Whether silence counts and there is no usual rate; `Health` judges topics with one."""
        return self.flow.silence_counts and (self.flow.silence.own or self.route.meter.usual_rate is None)

    def _qos_clash(self) -> str:
        """Return the reason why its subscription misses messages of a publisher, or an empty string."""
        if self.flow.qos is None:
            return ""
        for each in self.carried.endpoints:
            if each.type_name == self.carried.type_name and (why := incompatible(each.qos, self.flow.qos)):
                return why
        return ""

    @property
    def unresolved(self) -> Cause | None:
        """The cause why type or QoS is unknown, or None."""
        return None if self.resolver.unresolved is None else self.resolver.unresolved.cause

    @property
    def has_sent(self) -> bool:
        """Whether messages were sent in this opening, or the peer keeps some of a latched topic."""
        return self.path.ledger.sent_now > 0 or self.has_kept

    @property
    def malformed(self) -> str:
        """The field of the last malformed message, and what is wrong with it, or an empty string."""
        return "" if self.report is None else self.report.malformed

    @property
    def loss_unexplained(self) -> bool:
        """Whether it is not known yet if the present loss is due to a full link."""
        loss = self.health.losses.loss
        is_new = loss is not None and self.route.context.now() - loss.since < MEASURED_FOR
        return self.route.peer.fullness.undecided or is_new

    def datagrams(self) -> int:
        """Return the number of datagrams of an average message, or 0 if the channel uses none."""
        channel, meter = self.carried.channel, self.route.meter
        if channel is None or not meter.count or not channel.ready:
            return 0
        return channel.datagrams(meter.bytes // meter.count)

    def _held_up_where(self) -> str:
        return QUEUE if self.path.waits(self.route.context.now()) >= self.flow.lateness.seconds / 2 else WAY


def failure_of(peer: Verdict) -> str:
    """Return the reason why the other side's subscription failed, or an empty string."""
    return peer.text if peer.cause == Cause.SUBSCRIBE_FAILED else ""


class ReceiverFacts(TopicFacts):
    """The knowledge of a topic's receiving half.

    Attributes:
        listeners: the subscriptions here.
        report: the sender's last one, or None.
        report_now: the last one on the present opening, or None.
        ledger: of the sender's last plausible report.
    """

    owing = False
    ledger = Ledger()

    def __init__(self, flow: TopicFlow, path: IncomingPath, listeners: Listeners) -> None:
        self.route, self.flow, self.carried = flow.route, flow, flow.carried
        self.listeners, self._path = listeners, path
        self.report: SentReport | None = None
        self.report_now: SentReport | None = None

    @property
    def of_transforms(self) -> Verdict | None:
        """The first verdict of what changes its messages, or None."""
        for each in self._path.transforms:
            if each.verdict is not None and each.verdict.cause.startswith(f"{each.feature}."):
                return each.verdict
        return None

    def stages(self) -> tuple[Stage, ...]:
        report, peer, path = self.report_now, self.route.judged.peer, self._path
        known, kept = bool(self.carried.type_name), self.has_kept
        if report is None or report.publishers:
            seen = Stage("publisher seen", None if report is None else True)
        else:
            why = peer.text if peer.cause in _NO_PUBLISHER else ""
            why = why or f"no publisher of {self.route.far_topic} on the other side"
            seen = Stage("publisher seen", False, why)
        # A subscription that does not match is no obstacle to others that do.
        deaf = () if self.flow.audience.count else self.flow.audience.deaf
        clash = next((each.reason for each in deaf if each.cause == Cause.QOS_INCOMPATIBLE), "")
        if not clash and peer.cause == Cause.QOS_INCOMPATIBLE:
            clash = peer.text
        matches = Stage("QoS compatible", not clash if known else None, clash)
        failure = self.route.notices.loop or failure_of(peer)
        takes = report is not None and report.subscribed
        subscribed = Stage("subscribed", False if failure else takes or None, failure)
        sent = Stage("sent", (report is not None and self.ledger.offered > 0) or kept or None)
        undelivered = "" if path.received else self.route.notices.undelivered
        received = Stage("received", path.received > 0 or kept or None, undelivered)
        published = Stage("published", path.delivered > 0 or kept or None)
        if self.flow.audience.count:
            heard = Stage("subscriber seen", True)
        else:
            why = no_subscriber(self.route.local_topic, self.route.context.domain, self.flow.audience.deaf)
            heard = Stage("subscriber seen", None, why)
        before = seen, Stage("type known", known or None, self.carried.type_name or peer.text), matches, subscribed
        return stages_with_link(self, before, (sent, received, published, heard))

    @property
    def is_unpublished(self) -> bool:
        """Whether the sending side has said that nobody publishes the topic there."""
        return self.report_now is not None and not self.report_now.publishers

    @property
    def has_kept(self) -> bool:
        """Whether messages are kept here. The peer's verdict tells whether newer ones exist."""
        return self._path.outputs.has_kept

    @property
    def silence_counts(self) -> bool:
        """Whether silence counts while messages are in transit; otherwise the sending side judges."""
        return self.flow.silence_counts and (self.flow.silence.own or self.ledger.open > 0)

    @property
    def present_type(self) -> TypeVersion:
        left = self.report is not None and not self.report.publishers
        return TypeVersion() if left else TypeVersion(self.carried.type_name, self.carried.type_hash)

    def ends(self) -> tuple[tuple[str, ...], Qos | None, Qos | None]:
        nodes, offered = (self.report.nodes, self.report.publisher_qos) if self.report else ((), None)
        return nodes, offered, self.listeners.subscriber_qos

    @property
    def velocity(self) -> Velocity | None:
        return velocity_on(self.route.context, self.route.remote_topic)

    @property
    def came_before(self) -> bool:
        return self.route.meter.last is not None and not self.came

    @property
    def nodes_there(self) -> tuple[str, ...]:
        return () if self.report_now is None else self.report_now.nodes
