"""The stages and the verdict of a half of a route of calls: rules that only read it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.snapshot import Stage, State
from rsb_bridge.model.verdict import LASTING, Cause, LinkCause, Verdict
from rsb_bridge.route.blocking_rules import JudgedHalf, first_missing, stages_with_link
from rsb_bridge.route.calls.calls_ledger import LATELY, REMEDIES

if TYPE_CHECKING:
    from rsb_bridge.route.blocking_rules import Rules
    from rsb_bridge.route.calls.calls_ledger import CallFailures, CallsLedger
    from rsb_bridge.route.crossing import Crossing


class Trouble(NamedTuple):
    """A problem to show to operators.

    Attributes:
        text: for an operator, with the remedy.
    """

    cause: Cause
    text: str


class CallsProgress(NamedTuple):
    """The progress of calls, as one half knows it.

    Attributes:
        served: whether nodes answer, or None if it is unknown.
        providers: names of these nodes.
        why_unserved: the reason why none answers, or empty.
        type_name: as last known, or empty.
        offered: whether callers can call it, as far as this half knows.
        offer_failed: whether this half is kept from its part in offering it.
        why_not_offered: the reason why it is not offered, or empty.
    """

    served: bool | None = None
    providers: tuple[str, ...] = ()
    why_unserved: str = ""
    type_known: bool = False
    type_name: str = ""
    offered: bool = False
    offer_failed: bool = False
    why_not_offered: str = ""


class MalformedCall(NamedTuple):
    """A request, a response or a message that does not fit its type.

    Attributes:
        field: and what is wrong with it.
    """

    type_name: str
    field: str


class CallsEnd(Protocol):
    """The end of a route of calls on this side: the offer to callers here, or the servers here.

    Attributes:
        warning: the trouble that does not keep calls from crossing, or None.
    """

    warning: Trouble | None

    @property
    def offered(self) -> bool:
        """Whether callers can call it, as far as this half knows."""

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called, or None if this side knows of none."""

    def nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the nodes that call, and the nodes that answer."""

    def at_node(self) -> tuple[int, int]:
        """Return the newest call that was given to DDS, with all before it, and how many calls wait for their node."""

    def progress(self) -> CallsProgress:
        """Return how far calls get, as this half knows it."""

    def close(self) -> None:
        """End the opening."""


class JudgedCalls(JudgedHalf, Protocol):
    """One half of a route of calls, as its rules and stages read it."""

    calls: CallsLedger
    failures: CallFailures
    end: CallsEnd

    def stages(self) -> tuple[Stage, ...]: ...

    @property
    def waited(self) -> bool: ...

    def last_malformed(self) -> MalformedCall | None: ...

    @property
    def call_timeout(self) -> float: ...


def calls_stages(half: JudgedCalls, progress: CallsProgress) -> tuple[Stage, ...]:
    """Return the stages from the server to the caller that has its answer, in order."""
    seen = Stage(
        "server seen", progress.served, ", ".join(progress.providers) if progress.served else progress.why_unserved
    )
    if progress.type_known:
        known = Stage("type known", True, progress.type_name)
    elif progress.served and not half.route.outgoing:  # else the other side knows why
        known = Stage("type known", False, progress.why_unserved)
    else:
        known = Stage("type known", None)
    offered = Stage("offered", False if progress.offer_failed else progress.offered or None, progress.why_not_offered)
    called = Stage("called", half.calls.asked > 0 or None)
    answered = Stage("answered", True) if half.calls.answered else Stage("answered", None, half.calls.last_failure)
    return stages_with_link(half, (seen, known), (offered, called, answered))


def _unavailable(half: JudgedCalls, _: Crossing) -> Verdict | None:
    if (trouble := half.end.unavailable()) is None:
        return None
    not_yet = trouble.cause is Cause.NO_SERVER  # as a topic that has no publisher yet
    return Verdict(State.WAITING if not_yet else State.DOWN, *trouble)


def _awaits_link(half: JudgedCalls, _: Crossing) -> Verdict | None:
    path = half.route.peer.path.fault
    if path is None or path.cause is not LinkCause.SILENT or not half.calls.in_flight:
        return None
    return Verdict(State.WAITING, Cause.AWAITS_LINK, path.text)


def _unanswered(half: JudgedCalls, _: Crossing) -> Verdict | None:
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
    text = f"{what}; check why {nodes} does not answer within {half.call_timeout:g} s, or set a longer timeout"
    return Verdict(State.SLOW, Cause.UNANSWERED, text, half.failures.since)


def _refused(half: JudgedCalls, _: Crossing) -> Verdict | None:
    if not (refused := half.calls.refused_lately()):
        return None
    why = max(refused, key=lambda each: refused[each])
    text = f"calls have been refused for {LASTING}, {refused.total():,} in the last {LATELY} s: "
    if why is Refused.MALFORMED and (malformed := half.last_malformed()) is not None:
        text += f"they or their answers are malformed ({': '.join(malformed)}): see the node that sent them"
    else:
        text += REMEDIES[why]
    return Verdict(State.SLOW, Cause.CALLS_REFUSED, text, half.failures.since)


def _warning(half: JudgedCalls, _: Crossing) -> Verdict | None:
    return Verdict(State.UNHEARD, *half.end.warning) if half.end.warning is not None else None


def _waiting(half: JudgedCalls, crossing: Crossing) -> Verdict | None:
    offered = half.end.offered
    if half.came and offered:
        return None
    text = "not called since it was reopened" if half.came_before else "not called yet"
    if not offered and not crossing.flows:
        text = first_missing(half.stages())
    return Verdict(State.WAITING, Cause.NO_CALL, text)


OF_CALLS: Rules[JudgedCalls] = (
    _unavailable,
    _awaits_link,
    _unanswered,
    _refused,
    _warning,
    _waiting,
)
