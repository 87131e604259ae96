"""The knowledge that both halves of a topic's route have: for the verdict, the stages and the snapshot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.verdict import EXPIRES, Cause, LinkCause
from rsb_bridge.route.lateness import Late
from rsb_bridge.route.route import promised_keep
from rsb_bridge.route.topic_flow import MEASURED_FOR
from rsb_bridge.route.topic_verdict import LOSS_CAUSES

if TYPE_CHECKING:
    from functools import partial

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import Ledger, RouteSnapshot
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.half import Carried
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_flow import AgreedEnd, TopicFlow

_UNUSUAL = frozenset({Cause.LATE, *LOSS_CAUSES, *EXPIRES})


class TopicFacts(ABC):
    """The knowledge of one half of a topic."""

    route: Route
    flow: TopicFlow
    carried: Carried[Any]
    _end: AgreedEnd

    # --- answers that only one of the halves knows

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
    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        """Return the QoS that the original publishers offer, and the one that the final subscriptions request."""

    @property
    @abstractmethod
    def publisher_nodes(self) -> tuple[str, ...]:
        """Nodes of the original publishers."""

    def lacks_publisher(self, _: Crossing) -> bool:
        """Whether messages are missing because nobody publishes them here."""
        return False

    def _held_up_where(self) -> str:
        """Return where late messages are held up, or an empty string if this half does not know it."""
        return ""

    # --- what follows from them

    @property
    def on_end(self) -> str:
        return self._end.of(self.carried.type_name)

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        return (TypeVersion(self.carried.type_name, self.carried.type_hash),)

    @property
    def resends(self) -> bool:
        # Kept messages must not get lost. Over datagrams both ends have to agree, and both know only the QoS.
        qos, kept = self.flow.qos, self.route.proposal.keep is not None and self.route.transport.reliable
        return kept or qos is None or qos.reliability != "best_effort"

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
        publisher_qos, subscriber_qos = self.end_qos()
        return common(
            qos=flow.qos,
            publisher_qos=publisher_qos,
            subscriber_qos=subscriber_qos,
            ledger=self.ledger,
            latency_p50=flow.latency.p50,
            latency_p99=flow.latency.p99,
            jitter=flow.latency.jitter,
            publishers=self.publisher_nodes,
            subscribers=flow.audience.subscribers,
            audience=flow.audience,
            drivers=flow.drivers.all if flow.drivers.here or flow.drivers.there else (),
        )
