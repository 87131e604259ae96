"""The knowledge of a half of a route of calls, with its stages, its snapshot, and the rules of its verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.fates import RELIABLE
from rsb_bridge.model.snapshot import Ledger, Stage, State
from rsb_bridge.model.verdict import LASTING, Cause, LinkCause, Verdict
from rsb_bridge.route.blocking_rules import first_missing, stages_with_link
from rsb_bridge.route.calls.calls_end import MalformedCall
from rsb_bridge.route.calls.calls_ledger import LATELY, REMEDIES
from rsb_bridge.route.half import Facts

if TYPE_CHECKING:
    from functools import partial

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.route.calls.calls_end import CallsEnd
    from rsb_bridge.route.calls.calls_flow import CallsFlow, CallsKind
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.half import Rules
    from rsb_bridge.wire.records import CallsReport

_NO_LEDGER = Ledger()


class CallsFacts(Facts):
    """The knowledge of one half of a route of calls.

    Attributes:
        flow, calls, failures: of its half.
        end: the offer to callers here, or the servers here.
    """

    fates = RELIABLE
    learns = True
    lifespan = 0.0

    def __init__(self, flow: CallsFlow, types: LaneTypes, end: CallsEnd, kind: CallsKind[Any]) -> None:
        self.route, self.calls, self.failures, self.end = flow.route, flow.calls, flow.failures, end
        self.flow, self._types, self._kind = flow, types, kind

    @property
    def nodes_there(self) -> tuple[str, ...]:
        return self.end.nodes_there

    def stages(self) -> tuple[Stage, ...]:
        (seen, known, offered), calls = self.end.stages(), self.calls
        called = Stage("called", calls.asked > 0 or None)
        answered = Stage("answered", True) if calls.answered else Stage("answered", None, calls.last_failure)
        return stages_with_link(self, (seen, known), (offered, called, answered))

    @property
    def came(self) -> bool:
        return self.flow.came

    @property
    def came_before(self) -> bool:
        return self.calls.asked > 0 and not self.flow.came

    @property
    def owing(self) -> bool:
        return self.calls.in_flight > 0

    @property
    def on_end(self) -> str:
        return self._kind.on_end

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        return self._types.messages

    # --- for the rules of calls

    def last_malformed(self) -> MalformedCall | None:
        """Return the last malformed request or response, or None."""
        return self._types.last_malformed or malformed_in(self.flow.report)

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
            lanes=tuple([member.name for member in self.flow.members if not member.is_topic]),
        )


def malformed_in(report: CallsReport | None) -> MalformedCall | None:
    """Return the malformed request or response that the other side has found, or None."""
    return MalformedCall(report.malformed_type, report.malformed) if report is not None and report.malformed else None


def _unavailable(half: CallsFacts, _: Crossing) -> Verdict | None:
    if (trouble := half.end.unavailable()) is None:
        return None
    not_yet = trouble.cause is Cause.NO_SERVER  # as a topic that has no publisher yet
    return Verdict(State.WAITING if not_yet else State.DOWN, *trouble)


def _awaits_link(half: CallsFacts, _: Crossing) -> Verdict | None:
    path = half.route.peer.path.fault
    if path is None or path.cause is not LinkCause.SILENT or not half.calls.in_flight:
        return None
    return Verdict(State.WAITING, Cause.AWAITS_LINK, path.text)


def _unanswered(half: CallsFacts, _: Crossing) -> Verdict | None:
    if expired := half.calls.expired_lately():
        what = f"calls have timed out for {LASTING}, {expired:,} in the last {LATELY} s"
    elif half.calls.unanswered:
        what = f"no call has been answered for {LASTING}: the last one timed out"
    else:
        return None
    providers = half.end.nodes()[1]
    nodes = " and ".join(providers) or "the far node"
    if half.waited:
        text = f"{what}; they waited for {nodes} to take earlier ones: make fewer at once, or set a longer timeout"
        return Verdict(State.SLOW, Cause.CALLS_WAIT, text, half.failures.since)
    text = f"{what}; check why {nodes} does not answer within {half.flow.call_timeout:g} s, or set a longer timeout"
    return Verdict(State.SLOW, Cause.UNANSWERED, text, half.failures.since)


def _refused(half: CallsFacts, _: Crossing) -> Verdict | None:
    if not (refused := half.calls.refused_lately()):
        return None
    why = max(refused, key=lambda each: refused[each])
    text = f"calls have been refused for {LASTING}, {refused.total():,} in the last {LATELY} s: "
    if why is Refused.MALFORMED and (malformed := half.last_malformed()) is not None:
        text += f"they or their answers are malformed ({': '.join(malformed)}): see the node that sent them"
    else:
        text += REMEDIES[why]
    return Verdict(State.SLOW, Cause.CALLS_REFUSED, text, half.failures.since)


def _warning(half: CallsFacts, _: Crossing) -> Verdict | None:
    return Verdict(State.UNHEARD, *half.end.warning) if half.end.warning is not None else None


def _waiting(half: CallsFacts, crossing: Crossing) -> Verdict | None:
    offered = half.end.offered
    if half.came and offered:
        return None
    text = "not called since it was reopened" if half.came_before else "not called yet"
    if not offered and not crossing.flows:
        text = first_missing(half.stages())
    return Verdict(State.WAITING, Cause.NO_CALL, text)


OF_CALLS: Rules[CallsFacts] = (
    _unavailable,
    _awaits_link,
    _unanswered,
    _refused,
    _warning,
    _waiting,
)
