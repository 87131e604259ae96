"""The knowledge of a topic's sending half: for its verdict, its stages and its snapshot."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.names import expand_type_name
from rsb_bridge.model.qos import incompatible
from rsb_bridge.model.snapshot import Stage
from rsb_bridge.model.verdict import LASTING, Cause
from rsb_bridge.route.blocking_rules import stages_with_link
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.lateness import QUEUE, REPORTED_LATELY, WAY
from rsb_bridge.route.ledger import OUTAGE
from rsb_bridge.route.sending import remedy_for_size
from rsb_bridge.route.topic_facts import TopicFacts
from rsb_bridge.route.topic_flow import MEASURED_FOR
from rsb_bridge.route.topic_verdict import no_subscriber
from rsb_bridge.wire.headers import publisher_id

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.channel.scheduler import SendingChannel
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.route.catching_up import Backlog
    from rsb_bridge.route.half import Carried
    from rsb_bridge.route.health import Health
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.resolving import Resolver
    from rsb_bridge.route.sending import OutgoingPath
    from rsb_bridge.route.topic_flow import AgreedEnd, TopicFlow
    from rsb_bridge.route.topic_subscription import TopicSubscription
    from rsb_bridge.route.topic_verdict import Elsewhere
    from rsb_bridge.wire.records import ReceivedReport

_NO_TYPE = frozenset({Cause.TYPE_UNKNOWN, Cause.TYPE_CONFLICT})
_NODES_START_IN = 10.0
"""s from an opening for which a topic without a publisher only waits: nodes that start with the bridge are up by then.
A round figure: nothing was measured; with a tenth of it, each boot of a robot would begin with faults."""


class SenderFacts(TopicFacts):
    """The knowledge of a topic's sending half.

    Attributes:
        report: the peer's last one in the present opening, or None.
        kept_there: publishers of a latched topic whose messages the peer keeps.
    """

    def __init__(
        self,
        flow: TopicFlow,
        end: AgreedEnd,
        counts: RouteLedger,
        loop_filter: LoopFilter,
        backlog: Backlog,
        path: OutgoingPath,
        subscription: TopicSubscription,
        resolver: Resolver,
        health: Health,
    ) -> None:
        self.route, self.flow, self._end = flow.route, flow, end
        self.carried: Carried[SendingChannel] = flow.carried
        self.health, self.backlog = health, backlog
        self._counts, self._loop_filter, self._path = counts, loop_filter, path
        self._subscription, self._resolver = subscription, resolver
        self.report: ReceivedReport | None = None
        self.kept_there: Collection[bytes] = ()

    def forget(self) -> None:
        """Forget what the peer has told in an opening that is over."""
        self.report, self.kept_there = None, ()

    @property
    def ledger(self) -> Ledger:
        """The ledger as it is now, by the peer's last report; it is counted anew each time."""
        ledger, context = self._counts.ledger(self._subscription.numbers.counts), self.route.context
        if ledger.waiting and (waited := self._path.waits(context.now())):
            return replace(ledger, waiting_since=context.wall_of(context.clock.steady() - waited))
        return ledger

    def stages(self) -> tuple[Stage, ...]:
        """Return the stages from the publisher to the subscriber, in order."""
        described, kept, counts, report = self.route.life.described, self.has_kept, self._counts, self.report
        if self.carried.endpoints:
            seen = Stage("publisher seen", True, f"{len(self.carried.endpoints)}{self._loop_filter.left_out()}")
        else:
            looks = self.route.life.accepted and not self.route.pausing.paused
            seen = Stage("publisher seen", False if looks else None, self._resolver.no_publisher())
        if described:
            known = Stage("type known", True, self.carried.type_name)
        else:
            known = Stage("type known", False if self.unresolved in _NO_TYPE else None, self._resolver.why())
        clash = self._qos_clash()
        matches = Stage("QoS compatible", not clash if described else None, clash)
        failure = self.route.notices.loop or self._subscription.failure
        subscribed = Stage("subscribed", False if failure else self._subscription.receives or None, failure)
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
        repeated, fullness = self.route.losses.repeated, self.route.peer.fullness
        # A full link crowds a topic out until its connection breaks; the text would blame firewalls.
        return "" if repeated and (fullness.out is not None or fullness.undecided) else repeated

    @property
    def velocity(self) -> Velocity | None:
        return self.report.velocity if self.report is not None else None

    def waiting_text(self) -> str:
        dropped = self._counts.dropped[OUTAGE] - self.backlog.dropped_before
        older = f", {dropped:,} older dropped" if dropped else ""
        return f"waiting {LASTING}, {self.ledger.waiting:,} kept{older}"

    @property
    def came_before(self) -> bool:
        """Whether either side knows of messages in an earlier opening, and none came in this one."""
        there = self.report is not None and self.report.came_before
        return (self.route.meter.last is not None or there) and not self.came

    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        return self._resolver.publisher_qos, self.report.subscriber_qos if self.report else None

    @property
    def publisher_nodes(self) -> tuple[str, ...]:
        return node_names(self.carried.endpoints)

    @property
    def present_type(self) -> TypeVersion:
        if self.carried.type_name and self.carried.endpoints:
            return TypeVersion(self.carried.type_name, self.carried.type_hash)
        hint, named = self._resolver.hint, self.route.spec.type
        # Only the session's type crosses, even if nodes of the other side have another one.
        return hint if named == "auto" or expand_type_name(named) == hint.name else TypeVersion(expand_type_name(named))

    @property
    def has_kept(self) -> bool:
        """Whether the peer keeps messages of a publisher that still exists."""
        kept = self.kept_there
        return bool(kept) and any(publisher_id(each.gid) in kept for each in self.carried.endpoints)

    def lacks_publisher(self, crossing: Crossing) -> bool:
        # Type and QoS are a publisher's, so that without one nothing is described, and nothing flows.
        unpublished = self._resolver.unresolved is not None and not self.carried.endpoints
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
    def elsewhere(self) -> Elsewhere | None:
        return self._resolver.elsewhere

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
        return self._counts.sent_now > 0 or self.has_kept

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

    def remedy_for_size(self) -> str:
        """Return what to do about messages that are too large."""
        return remedy_for_size(self.route.transport, self.route.proposal)

    def datagrams(self) -> int:
        """Return the number of datagrams of an average message, or 0 if the channel uses none."""
        channel, meter = self.carried.channel, self.route.meter
        if channel is None or not meter.count or not channel.ready:
            return 0
        return channel.datagrams(meter.bytes // meter.count)

    def _held_up_where(self) -> str:
        return QUEUE if self._path.waits(self.route.context.now()) >= self.flow.lateness.seconds / 2 else WAY
