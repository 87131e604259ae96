"""The knowledge of a half of a route of calls: for its verdict, its stages and its snapshot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.model.snapshot import Ledger
from rsb_bridge.model.verdict import LASTING, Cause
from rsb_bridge.route.calls.calls_verdict import MalformedCall, calls_stages

if TYPE_CHECKING:
    from functools import partial

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.model.snapshot import RouteSnapshot, Stage
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.calls_kind import CallsKind
    from rsb_bridge.route.calls.calls_verdict import CallsEnd
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.wire.records import CallsReport

_NO_LEDGER = Ledger()


class CallsFacts:
    """The knowledge of one half of a route of calls.

    Attributes:
        calls, failures: as of its `CallsFlow`.
        end: the offer to callers here, or the servers here.
    """

    large_vanish = False
    velocity = None
    resends = True
    learns = True
    may_not_be_late = False
    lifespan = 0.0

    def __init__(self, flow: CallsFlow, types: LaneTypes, end: CallsEnd, kind: CallsKind[Any]) -> None:
        self.route, self.calls, self.failures, self.end = flow.route, flow.calls, flow.failures, end
        self._flow, self._types, self._kind = flow, types, kind

    def stages(self) -> tuple[Stage, ...]:
        return calls_stages(self, self.end.progress())

    @property
    def came(self) -> bool:
        return self._flow.came

    @property
    def came_before(self) -> bool:
        return self.calls.asked > 0 and not self._flow.came

    @property
    def owing(self) -> bool:
        return self.calls.in_flight > 0

    @property
    def breaking(self) -> str:
        return self.route.losses.repeated

    @property
    def on_end(self) -> str:
        return self._kind.on_end

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        return self._types.messages

    def waiting_text(self) -> str:
        return f"waiting {LASTING} for the link"

    # --- for the rules of calls

    @property
    def call_timeout(self) -> float:
        return self._flow.call_timeout

    def last_malformed(self) -> MalformedCall | None:
        """Return the last malformed request or response, or None."""
        return self._types.last_malformed or malformed_in(self._flow.report)

    @property
    def waited(self) -> bool:
        """Whether calls expired lately that their node never got, because it had not read earlier ones."""
        return self.route.judged.peer.cause == Cause.CALLS_WAIT if self.route.outgoing else self.calls.waited_lately()

    def snapshot_of(self, common: partial[RouteSnapshot]) -> RouteSnapshot:
        (callers, providers), goals = self.end.nodes(), self._kind.goals
        return common(
            qos=None,
            publisher_qos=None,
            subscriber_qos=None,
            ledger=_NO_LEDGER,
            latency_p50=None,
            latency_p99=None,
            jitter=None,
            publishers=callers,
            subscribers=providers,
            calls=self.calls.snapshot(self.end.at_node()[1]),
            goals=() if goals is None else goals.snapshot(self._kind.awaited()),
            lanes=tuple(member.name for member in self._flow.members if not member.is_topic),
        )


def malformed_in(report: CallsReport | None) -> MalformedCall | None:
    """Return the malformed request or response that the other side has found, or None."""
    return MalformedCall(report.malformed_type, report.malformed) if report is not None and report.malformed else None
