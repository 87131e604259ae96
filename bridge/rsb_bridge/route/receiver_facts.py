"""The knowledge of a topic's receiving half: for its verdict, its stages and its snapshot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.snapshot import Ledger, Stage
from rsb_bridge.model.verdict import LASTING, Cause
from rsb_bridge.route.blocking_rules import stages_with_link
from rsb_bridge.route.rest_message import velocity_on
from rsb_bridge.route.topic_facts import TopicFacts
from rsb_bridge.route.topic_verdict import no_subscriber

if TYPE_CHECKING:
    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.incoming_path import IncomingPath
    from rsb_bridge.route.listeners import Listeners
    from rsb_bridge.route.topic_flow import AgreedEnd, TopicFlow
    from rsb_bridge.wire.records import SentReport


def failure_of(peer: Verdict) -> str:
    """Return the reason why the other side's subscription failed, or an empty string."""
    return peer.text if peer.cause == Cause.SUBSCRIBE_FAILED else ""


class ReceiverFacts(TopicFacts):
    """The knowledge of a topic's receiving half.

    Attributes:
        listeners: the subscriptions here.
        report: the sender's last one, or None.
        report_now: the last one on the present opening, or None.
        sender_ledger: of the sender's last plausible report.
    """

    owing = False
    large_vanish = False

    def __init__(self, flow: TopicFlow, end: AgreedEnd, path: IncomingPath, listeners: Listeners) -> None:
        self.route, self.flow, self.carried, self._end = flow.route, flow, flow.carried, end
        self.listeners, self._path = listeners, path
        self.report: SentReport | None = None
        self.report_now: SentReport | None = None
        self.sender_ledger = Ledger()

    @property
    def ledger(self) -> Ledger:
        return self.sender_ledger

    def stages(self) -> tuple[Stage, ...]:
        """Return the stages from the publisher to the subscriber, in order."""
        report, peer, path = self.report_now, self.route.judged.peer, self._path
        known, kept = bool(self.carried.type_name), self.has_kept
        if report is None or report.publishers:
            seen = Stage("publisher seen", None if report is None else True)
        else:
            seen = Stage("publisher seen", False, f"no publisher of {self.route.far_topic} on the other side")
        # A subscription that does not match is no obstacle to others that do.
        deaf = () if self.flow.audience.count else self.flow.audience.deaf
        clash = next((each.reason for each in deaf if each.cause == Cause.QOS_INCOMPATIBLE), "")
        if not clash and peer.cause == Cause.QOS_INCOMPATIBLE:
            clash = peer.text
        matches = Stage("QoS compatible", not clash if known else None, clash)
        failure = self.route.notices.loop or failure_of(peer)
        takes = report is not None and report.subscribed
        subscribed = Stage("subscribed", False if failure else takes or None, failure)
        sent = Stage("sent", (report is not None and report.offered > 0) or kept or None)
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
    def has_kept(self) -> bool:
        """Whether messages are kept here. The peer's verdict tells whether newer ones exist."""
        return self._path.outputs.has_kept

    @property
    def silence_counts(self) -> bool:
        """Whether silence counts while messages are in transit; otherwise the sending side judges."""
        return self.flow.silence_counts and (self.flow.silence.own or self.sender_ledger.open > 0)

    @property
    def present_type(self) -> TypeVersion:
        left = self.report is not None and not self.report.publishers
        return TypeVersion() if left else TypeVersion(self.carried.type_name, self.carried.type_hash)

    @property
    def publisher_nodes(self) -> tuple[str, ...]:
        return self.report.nodes if self.report else ()

    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        return self.report.publisher_qos if self.report else None, self.listeners.subscriber_qos

    @property
    def velocity(self) -> Velocity | None:
        return velocity_on(self.route.context, self.route.remote_topic)

    @property
    def came_before(self) -> bool:
        return self.route.meter.last is not None and not self.came

    @property
    def breaking(self) -> str:
        return self.route.losses.repeated

    def waiting_text(self) -> str:
        return f"waiting {LASTING} for the link"
