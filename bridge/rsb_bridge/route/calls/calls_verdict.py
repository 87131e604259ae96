"""The stages and the verdict of a half of a route of calls: rules over its facts, without a clock or an effect."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LASTING, Cause, LinkCause, Verdict
from rsb_bridge.route.blocking_rules import as_known, first_missing, link_and_acceptance, stage, worst
from rsb_bridge.route.calls.calls_ledger import LATELY, REMEDIES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.model.snapshot import Stage
    from rsb_bridge.route.blocking_rules import RouteStatus, Rules


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
        asked: calls that came, since the route was made.
        answered: calls that were answered, since the route was made.
        last_failure: the reason why the last call without an answer had none, or empty.
    """

    served: bool | None = None
    providers: tuple[str, ...] = ()
    why_unserved: str = ""
    type_known: bool = False
    type_name: str = ""
    offered: bool = False
    offer_failed: bool = False
    why_not_offered: str = ""
    asked: int = 0
    answered: int = 0
    last_failure: str = ""


class MalformedCall(NamedTuple):
    """A request, a response or a message that does not fit its type.

    Attributes:
        field: and what is wrong with it.
    """

    type_name: str
    field: str


class CallsFacts(NamedTuple):
    """One half's knowledge of its calls.

    Attributes:
        status: the part that does not depend on what the route carries.
        progress: how far calls get.
        unavailable: the reason why nothing can be called, or None if this side knows of none.
        warning: the trouble that does not keep calls from crossing, or None.
        in_flight: calls without an answer.
        expired: calls in the last `LATELY` s that had no answer in time.
        waited: whether calls expired lately that their node never got, because it had not read earlier ones.
        unanswered: whether the last calls that are over had no answer in time, however long ago that was.
        refused: calls refused in the last `LATELY` s, by cause.
        malformed: the last malformed request or response, or None.
        failing_since: s, when calls began to fail, or None if none fails.
        timeout: s, after which a call is given up.
    """

    status: RouteStatus
    progress: CallsProgress = CallsProgress()
    unavailable: Trouble | None = None
    warning: Trouble | None = None
    in_flight: int = 0
    expired: int = 0
    waited: bool = False
    unanswered: bool = False
    refused: Mapping[Refused, int] = {}
    malformed: MalformedCall | None = None
    failing_since: float | None = None
    timeout: float = 0.0


def judge_calls(facts: CallsFacts) -> Verdict:
    """Return the verdict that counts."""
    return worst(facts.status, _RULES, facts)[0]


def calls_stages(status: RouteStatus, progress: CallsProgress) -> tuple[Stage, ...]:
    """Return the stages from the server to the caller that has its answer, in order."""
    untyped = not status.sends and bool(progress.served) and not progress.type_known  # else the other side knows why
    stages = (
        stage(
            "server seen",
            bool(progress.served),
            progress.why_unserved,
            failed=progress.served is False,
            note=", ".join(progress.providers),
        ),
        stage(
            "type known",
            progress.type_known,
            progress.why_unserved if untyped else "",
            failed=untyped,
            note=progress.type_name,
        ),
        *link_and_acceptance(status),
        stage("offered", progress.offered, progress.why_not_offered, failed=progress.offer_failed),
        stage("called", progress.asked > 0),
        stage("answered", progress.answered > 0, progress.last_failure),
    )
    return as_known(status, stages)


def _unavailable(facts: CallsFacts) -> Verdict | None:
    if facts.unavailable is None:
        return None
    not_yet = facts.unavailable.cause is Cause.NO_SERVER  # as a topic that has no publisher yet
    return Verdict(State.WAITING if not_yet else State.DOWN, *facts.unavailable)


def _awaits_link(facts: CallsFacts) -> Verdict | None:
    path = facts.status.path
    if not facts.in_flight or path is None or path.cause is not LinkCause.SILENT:
        return None
    return Verdict(State.WAITING, Cause.AWAITS_LINK, path.text)


def _unanswered(facts: CallsFacts) -> Verdict | None:
    if facts.expired:
        what = f"calls have timed out for {LASTING}, {facts.expired:,} in the last {LATELY} s"
    elif facts.unanswered:
        what = f"no call has been answered for {LASTING}: the last one timed out"
    else:
        return None
    nodes = " and ".join(facts.progress.providers) or "the far node"
    if facts.waited:
        text = f"{what}; they waited for {nodes} to take earlier ones: make fewer at once, or set a longer timeout"
        return Verdict(State.SLOW, Cause.CALLS_WAIT, text, facts.failing_since)
    text = f"{what}; check why {nodes} does not answer within {facts.timeout:g} s, or set a longer timeout"
    return Verdict(State.SLOW, Cause.UNANSWERED, text, facts.failing_since)


def _refused(facts: CallsFacts) -> Verdict | None:
    if not facts.refused:
        return None
    why = max(facts.refused, key=lambda each: facts.refused[each])
    count = sum(facts.refused.values())
    text = f"calls have been refused for {LASTING}, {count:,} in the last {LATELY} s: "
    if why is Refused.MALFORMED and facts.malformed is not None:
        text += f"they or their answers are malformed ({': '.join(facts.malformed)}): see the node that sent them"
    else:
        text += REMEDIES[why]
    return Verdict(State.SLOW, Cause.CALLS_REFUSED, text, facts.failing_since)


def _warning(facts: CallsFacts) -> Verdict | None:
    return Verdict(State.UNHEARD, *facts.warning) if facts.warning is not None else None


def _waiting(facts: CallsFacts) -> Verdict | None:
    if facts.status.came and facts.progress.offered:
        return None
    text = "not called since it was reopened" if facts.status.came_before else "not called yet"
    if not facts.progress.offered and not facts.status.crossing.flows:
        text = f"waiting: {first_missing(calls_stages(facts.status, facts.progress))}"
    return Verdict(State.WAITING, Cause.NO_CALL, text)


_RULES: Rules[CallsFacts] = (
    _unavailable,
    _awaits_link,
    _unanswered,
    _refused,
    _warning,
    _waiting,
)
