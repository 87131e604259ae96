"""The rules by which one half of a route of calls is judged. They use no clock and change nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import FINE, LASTING, Cause, Verdict
from rsb_bridge.route.blocking_rules import gated, no_path, rank, throttled
from rsb_bridge.route.calls.calls_ledger import LATELY, REMEDIES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.model.calls import Refused


class Trouble(NamedTuple):
    """A problem to show to operators.

    Attributes:
        cause: its kind.
        text: for an operator, with the remedy.
    """

    cause: Cause
    text: str


class CallsFacts(NamedTuple):
    """One half's knowledge of its route.

    Attributes:
        sends: whether it is the callers' half.
        topic: the name on this side.
        domain_id: of this side.
        link_down: the reason why the link is down, or empty.
        refusal: the reason why the route is refused, or empty.
        loop: the reason why its calls would go in a circle, or empty.
        paused: whether an operator has paused it.
        paused_by: the operator, or empty if unknown.
        disarmed: the reason why it is not armed although it has to be, or empty.
        disarming: whether the other side may still act on messages from before it was disarmed.
        can_be_armed: whether an operator may arm it; if not, `disarmed` names the step that has to come first.
        no_path: the reason why its transport does not get through, or empty.
        breaking: the reason why its channel breaks before anything arrives, or empty.
        waits_for: the step that has to come before calls can cross.
        limit: calls a second that an operator allows, or 0 for no limit.
        limited_by: the reason for the limit, in words.
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

    sends: bool
    topic: str
    domain_id: int = 0
    link_down: str = ""
    refusal: str = ""
    loop: str = ""
    paused: bool = False
    paused_by: str = ""
    disarmed: str = ""
    disarming: bool = False
    can_be_armed: bool = True
    no_path: str = ""
    breaking: str = ""
    waits_for: str = ""
    limit: float = 0.0
    limited_by: str = "set on purpose (max_rate)"
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

    @property
    def crowded_out(self) -> str:
        """Empty: calls yield to nothing."""
        return ""


def judge_calls(facts: CallsFacts) -> Verdict:
    """Return the verdict that blocks all others, or the worst of `_RULES`, and of equal ones the first."""
    if (verdict := gated(facts)) is not None:
        return verdict
    return min((verdict for rule in _RULES if (verdict := rule(facts)) is not None), key=rank, default=FINE)


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
    text = f"{what}; see why {nodes} does not answer within {facts.timeout:g} s, or set a longer timeout"
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
    text = "not called since it was opened again" if facts.came_before else "not called yet"
    if not facts.offered and facts.waits_for:
        text = f"waiting: {facts.waits_for}"
    return Verdict(State.WAITING, Cause.NO_CALL, text)


_RULES: tuple[Callable[[CallsFacts], Verdict | None], ...] = (
    no_path,
    _unavailable,
    _unanswered,
    _refused,
    _warning,
    _waiting,
    throttled,
)
