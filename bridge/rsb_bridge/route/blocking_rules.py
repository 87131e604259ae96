"""The verdicts and stages that all routes have in common: a link that is down, a pause, a limit and the like."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypeVar

from rsb_bridge.channel.channel import REOPENS
from rsb_bridge.model.reason import NO_REASON, EndCode, Reason
from rsb_bridge.model.snapshot import Stage, State
from rsb_bridge.model.verdict import FINE, Cause, LinkCause, Verdict
from rsb_bridge.route.crossing import Crossing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.model.faults import PathFault

FactsT = TypeVar("FactsT")
_LINK_STAGE, ACCEPTED = "link up", "peer accepted"
"""Names of stages."""
# Of a lossy path.
_SUFFERS_FOR = 20.0  # s for which a route suffers after its last trouble: at 30 % loss, good times took up to 15 s
_STUCK_AFTER = 20.0  # s without a message after which it is stopped, and no longer slow: a round figure
_BETWEEN_LOSSES = frozenset(
    {
        (State.OK, Cause.NONE),
        (State.OK, Cause.THROTTLED),
        (State.WAITING, Cause.NO_MESSAGE),
        (State.WAITING, Cause.PUBLISHER_SILENT),
    }
)
"""Verdicts on a route that has recovered for a moment, or opens again."""


class RouteStatus(NamedTuple):
    """The part of one half's knowledge that does not depend on what its route carries.

    Attributes:
        sends: whether it is the sending half; of calls, the callers' half.
        topic: its name on this side.
        far_topic: its name on the other side.
        link_down: the reason why the link is down, which may be empty, or None if it is up.
        accepted: whether both sides want it, False if it is refused, or None while the peer has not answered.
        refusal: the reason why the route is refused or has ended, now or until shortly ago, or an empty one.
        reopens: whether its data connection broke a short time ago, and has not been open since.
        crossing: whether messages or calls may cross.
        loop: the reason why they would loop, or empty.
        paused_by: the operator, or empty if unknown.
        disarmed: the reason why it is not armed, if it has to be and is not.
        can_be_armed: whether an operator may arm it; if not, `disarmed` names the step that has to come first.
        no_path: the verdict on its channel, over which nothing gets through, or None.
        awaits_full_link: whether its stream only waits for a full link, so that `no_path` is no fault.
        breaking: the reason why its channel breaks before anything arrives, or empty.
        came: whether messages or calls have crossed since it was opened, or the receiving side keeps some of a latched
            topic.
        came_before: whether messages or calls crossed in an earlier opening, but none in this one.
        limit: Hz that an operator allows, or 0 for no limit.
        limited_by: the reason for the limit, in words.
        path: the fault of the link's path, or None.
    """

    sends: bool
    topic: str
    far_topic: str = ""
    domain_id: int = 0
    link_down: str | None = None
    accepted: bool | None = None
    refusal: Reason = NO_REASON
    reopens: bool = False
    crossing: Crossing = Crossing.NOT_OPEN
    loop: str = ""
    paused_by: str = ""
    disarmed: str = ""
    can_be_armed: bool = True
    no_path: Verdict | None = None
    awaits_full_link: bool = False
    breaking: str = ""
    came: bool = False
    came_before: bool = False
    limit: float = 0.0
    limited_by: str = "set on purpose (max_rate)"
    path: PathFault | None = None


Rules: TypeAlias = "tuple[Callable[[FactsT], Verdict | None], ...]"
"""Rules for what a route carries, over one half's facts. The order counts: of equally bad verdicts, the first does."""


def worst(status: RouteStatus, rules: Rules[FactsT], facts: FactsT) -> tuple[Verdict, list[Verdict]]:
    """Return the verdict that counts, and all that were found.

    A blocking verdict counts alone, because it keeps the others from being known. Otherwise the worst one counts,
    and of equally bad ones the first.
    """
    if (blocking := blocked(status)) is not None:
        return explained(status, blocking), [blocking]
    found = [] if status.no_path is None or status.awaits_full_link else [status.no_path]
    # A generator would take a call for each rule, once a second for each route.
    found += [verdict for rule in rules if (verdict := rule(facts)) is not None]
    if status.limit:
        found.append(Verdict(State.OK, Cause.THROTTLED, f"limit {status.limit:g} Hz, {status.limited_by}"))
    return explained(status, min(found, key=lambda verdict: verdict.state.rank)) if found else FINE, found


def explained(status: RouteStatus, verdict: Verdict) -> Verdict:
    """Return a verdict with the fault of the path as its cause, if that explains it.

    A silent link says nothing of its topics: they wait.
    """
    cause = None if status.path is None else status.path.of_topic(verdict.cause)
    if status.path is None or cause is None:
        return verdict
    if verdict.cause is Cause.UNANSWERED and not status.sends:
        return verdict  # the calls came, and it is a node of this side that has not answered them
    state = State.WAITING if cause is Cause.AWAITS_LINK else verdict.state
    return replace(verdict, state=state, cause=cause, text=status.path.text)


class LossyPath:
    """Keeps a route's verdict steady while its link loses packets.

    TCP repeats what is lost after ever longer pauses, and gives up at last. So a route's messages are late, lost,
    stalled and on time by turns: at 30 % both ways, its state changed each few seconds. All of that is one state.
    """

    def __init__(self) -> None:
        self._until = float("-inf")
        self._stuck_since: float | None = None

    def steady(self, verdict: Verdict, path: PathFault | None, now: float) -> Verdict:
        """Return the verdict to show instead of `verdict` at `now` (s)."""
        if path is None or path.cause is not LinkCause.LOSSY:
            self._until, self._stuck_since = float("-inf"), None
            return verdict
        suffers = verdict.cause == Cause.LOSSY
        if suffers:
            self._until = now + _SUFFERS_FOR
        # A fault of another kind is not the path's.
        elif now >= self._until or (verdict.state, verdict.cause) not in _BETWEEN_LOSSES:
            return verdict
        if not suffers or verdict.state.rank > State.STOPPED.rank:
            self._stuck_since = None
        elif self._stuck_since is None:
            self._stuck_since = now
        elif now - self._stuck_since >= _STUCK_AFTER:
            return verdict
        return Verdict(State.SLOW, Cause.LOSSY, path.text)


def blocked(status: RouteStatus) -> Verdict | None:
    """Return the verdict that keeps the others from being known, or None."""
    for rule in _BLOCKING:
        if (verdict := rule(status)) is not None:
            return verdict
    return None


def stage(name: str, passed: bool, reason: str = "", *, failed: bool = False, note: str = "") -> Stage:
    """Return a stage, with `note` if it has passed, or else with the reason."""
    done = False if failed else passed or None
    return Stage(name, done, note if done else reason)


def link_and_acceptance(status: RouteStatus) -> tuple[Stage, Stage]:
    """Return the stages of the link, which needs a working channel, and of the peer's acceptance."""
    no_path = status.no_path
    failed = status.link_down is not None or (no_path is not None and no_path.state is State.DOWN)
    trouble = no_path.text if no_path is not None else status.link_down or ""
    refused = status.accepted is False
    return (
        stage(_LINK_STAGE, not failed and no_path is None, trouble, failed=failed),
        stage(ACCEPTED, bool(status.accepted), str(status.refusal) if refused else "", failed=refused),
    )


def as_known(status: RouteStatus, stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """Return the stages as far as they are known: without a link, only the link's is."""
    if status.link_down is None:
        return stages
    return tuple(each if each.name == _LINK_STAGE else Stage(each.name, None) for each in stages)


def first_missing(stages: Iterable[Stage]) -> str:
    """Return the stage that has to pass before anything can cross; failed ones come before undecided ones."""
    missing = [each for each in stages if not each.done]
    first = next((each for each in missing if each.done is False), None) or next(iter(missing), None)
    return (first.detail or first.name) if first else ""


def _link(status: RouteStatus) -> Verdict | None:
    if status.link_down is None:
        return None
    return Verdict(State.DOWN, Cause.LINK_DOWN, status.link_down or "the link is down")


def _breaking(status: RouteStatus) -> Verdict | None:
    if not status.breaking:
        return None
    text = (
        f"its data connection ends before a message arrives ({status.breaking}), though the link is up: check "
        "firewalls and NAT between the two sides"
    )
    return Verdict(State.DOWN, Cause.NO_PATH, text)


def _refused(status: RouteStatus) -> Verdict | None:
    if not status.refusal.text:
        return None
    if status.refusal.code is EndCode.LISTED_DIFFERENTLY:
        return Verdict(State.DOWN, Cause.LISTED_DIFFERENTLY, status.refusal.text)
    if not status.refusal.broke:
        return Verdict(State.DOWN, Cause.REFUSED, status.refusal.text)
    # Nobody has refused it. If the path is at fault, the link finds out within seconds, and shows it for all topics.
    if status.reopens and status.path is None:
        return Verdict(State.WAITING, Cause.AWAITS_LINK, f"{REOPENS} ({status.refusal.text})")
    return Verdict(State.DOWN, Cause.NO_PATH, str(status.refusal))


def _held_back(status: RouteStatus) -> Verdict | None:
    match status.crossing:
        case Crossing.LOOP:
            return Verdict(State.DOWN, Cause.LOOP, status.loop)
        case Crossing.DISARMING:
            text = f"{status.disarmed}; earlier messages may still act for 1 s"
            return Verdict(State.DISARMING, Cause.DISARMING, text)
        case Crossing.PAUSED:
            text = f"paused ({status.paused_by})" if status.paused_by else "paused by an operator"
            return Verdict(State.PAUSED, Cause.PAUSED, text)
        case Crossing.DISARMED | Crossing.ASKED | Crossing.BEGINS:
            remedy = f": arm it (key A, rsb-console arm {status.topic})" if status.can_be_armed else ""
            return Verdict(State.DISARMED, Cause.DISARMED, status.disarmed + remedy)
        case Crossing.NOT_OPEN | Crossing.UNHEARD | Crossing.YES:
            return None


# Each loss of a channel refuses the route, too, so `_breaking` is asked before `_refused`: its text has the remedy.
_BLOCKING: tuple[Callable[[RouteStatus], Verdict | None], ...] = (_link, _breaking, _refused, _held_back)
