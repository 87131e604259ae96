"""The rules by which one half of a route of calls is judged. They use no clock and change nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LASTING, Cause, Verdict
from rsb_bridge.route.blocking_rules import worst
from rsb_bridge.route.calls.calls_ledger import LATELY, REMEDIES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.model.calls import Refused
    from rsb_bridge.route.blocking_rules import RouteStatus


class Trouble(NamedTuple):
    """A problem to show to operators.

    Attributes:
        cause: its kind.
        text: for an operator, with the remedy.
    """

    cause: Cause
    text: str


class CallsFacts(NamedTuple):
    """One half's knowledge of its calls.

    Attributes:
        status: the part that does not depend on what the route carries.
        unavailable: the reason why nothing can be called, or None if this side knows of none.
        warning: the trouble that does not keep calls from crossing, or None.
        offered: whether callers can call it, as far as this half knows.
        came: whether calls have come in this opening.
        came_before: whether calls have come in earlier openings, but none in this one.
        expired: calls in the last `LATELY` s that had no answer in time.
        unanswered: whether the last calls that are over had no answer in time, however long ago that was.
        refused: calls refused in the last `LATELY` s, by cause.
        failing_since: s, when calls began to fail, or None if none fails.
        timeout: s, after which a call is given up.
        providers: the nodes that should answer, in words.
    """

    status: RouteStatus
    unavailable: Trouble | None = None
    warning: Trouble | None = None
    offered: bool = False
    came: bool = False
    came_before: bool = False
    expired: int = 0
    unanswered: bool = False
    refused: Mapping[Refused, int] = {}
    failing_since: float | None = None
    timeout: float = 0.0
    providers: str = ""


def judge_calls(facts: CallsFacts) -> Verdict:
    """Return the verdict that counts."""
    return worst(facts.status, (rule(facts) for rule in _RULES))[0]


def _unavailable(facts: CallsFacts) -> Verdict | None:
    if facts.unavailable is None:
        return None
    not_yet = facts.unavailable.cause is Cause.NO_SERVER  # as a topic that has no publisher yet
    return Verdict(State.WAITING if not_yet else State.DOWN, *facts.unavailable)


def _unanswered(facts: CallsFacts) -> Verdict | None:
    if facts.expired:
        what = f"calls have timed out for {LASTING}, {facts.expired:,} in the last {LATELY} s"
    elif facts.unanswered:
        what = f"no call has been answered for {LASTING}: the last one timed out"
    else:
        return None
    nodes = facts.providers or "the far node"
    text = f"{what}; check why {nodes} does not answer within {facts.timeout:g} s, or set a longer timeout"
    return Verdict(State.SLOW, Cause.UNANSWERED, text, facts.failing_since)


def _refused(facts: CallsFacts) -> Verdict | None:
    if not facts.refused:
        return None
    why = max(facts.refused, key=lambda each: facts.refused[each])
    count = sum(facts.refused.values())
    text = f"calls have been refused for {LASTING}, {count:,} in the last {LATELY} s: "
    return Verdict(State.SLOW, Cause.CALLS_REFUSED, text + REMEDIES[why], facts.failing_since)


def _warning(facts: CallsFacts) -> Verdict | None:
    return Verdict(State.UNHEARD, *facts.warning) if facts.warning is not None else None


def _waiting(facts: CallsFacts) -> Verdict | None:
    if facts.came and facts.offered:
        return None
    text = "not called since it was reopened" if facts.came_before else "not called yet"
    if not facts.offered and facts.status.waits_for:
        text = f"waiting: {facts.status.waits_for}"
    return Verdict(State.WAITING, Cause.NO_CALL, text)


_RULES: tuple[Callable[[CallsFacts], Verdict | None], ...] = (
    _unavailable,
    _unanswered,
    _refused,
    _warning,
    _waiting,
)
