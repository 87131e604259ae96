"""The verdicts and stages that all routes have in common: a link that is down, a pause, a limit and the like."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import REOPENS
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.snapshot import Stage, State
from rsb_bridge.model.verdict import FINE, Cause, LinkCause, Verdict
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.crossing import Crossing

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.faults import PathFault
    from rsb_bridge.route.half import Facts, FactsT, Rules

_LINK_STAGE, ACCEPTED = "link up", "peer accepted"
"""Names of stages."""
_SILENCE = frozenset({Cause.PUBLISHER_SILENT, Cause.NO_MESSAGE})
_EXPLAINS_SILENCE = frozenset({Cause.QOS_INCOMPATIBLE, Cause.TYPE_CONFLICT})
"""Where a publisher's messages are not taken, it is not silent."""
# Of a lossy path.
_SUFFERS_FOR = 20.0  # s for which a route suffers after its last trouble: at 30 % loss, good times took up to 15 s
_STUCK_AFTER = 20.0  # s without a message after which it is stopped, and no longer slow: a round figure
_BETWEEN_LOSSES = frozenset(
    {
        (State.OK, Cause.NONE),
        (State.OK, Cause.THROTTLED),
        (State.OK, Cause.SEVERAL_PUBLISHERS),
        (State.WAITING, Cause.NO_MESSAGE),
        (State.WAITING, Cause.PUBLISHER_SILENT),
        (State.WAITING, Cause.PUBLISHER_UNHEARD),
    }
)
"""Verdicts on a route that has recovered for a moment, or opens again."""


def judge(half: FactsT, crossing: Crossing, rules: Rules[FactsT]) -> tuple[Verdict, Verdict]:
    """Return the verdict that counts on this side, and the one for the other side.

    A blocking verdict counts alone, because it keeps the others from being known. Otherwise the worst one counts,
    and of equally bad ones the first; instead of silence, its explanation.
    """
    if (blocking := blocked(half, crossing)) is not None:
        return (explained(half, blocking),) * 2
    # A stream of a full link only waits for its turn.
    no_path = half.route.trouble()
    found = [] if no_path is None or (half.route.transport.reliable and half.route.link_full is not None) else [no_path]
    # A generator would take a call for each rule, once a second for each route.
    found += [verdict for rule in rules if (verdict := rule(half, crossing)) is not None]
    if (of_features := half.route.peer.verdicts) is not None:
        found += of_features(half.route)
    if half.route.limit.rate:
        found.append(Verdict(State.OK, Cause.THROTTLED, f"limit {half.route.limit.rate:g} Hz, {half.route.limit.why}"))
    own = _known_more(half, _worst(half, found))
    return own, _known_more(half, _worst(half, [each for each in found if not each.here])) if own.here else own


def _known_more(half: Facts, verdict: Verdict) -> Verdict:
    """Return a verdict with what features know about its cause."""
    explain = half.route.peer.explain
    return verdict if explain is None or not verdict.cause else explain(half.route, verdict)


def _worst(half: Facts, found: Sequence[Verdict]) -> Verdict:
    if not found:
        return FINE
    worst = explained(half, min(found, key=lambda verdict: verdict.state.rank))
    if worst.cause not in _SILENCE:
        return worst
    faults = (each for each in found if each.state is not State.OK)  # a note explains nothing
    explanation = next((each for each in faults if each.cause in _EXPLAINS_SILENCE), None)
    return worst if explanation is None else replace(explanation, state=worst.state)


def explained(half: Facts, verdict: Verdict) -> Verdict:
    """Return a verdict with the fault of the path as its cause, if that explains it.

    A silent link says nothing of its topics: they wait.
    """
    path = half.route.peer.path.fault
    cause = None if path is None else path.of_topic(verdict.cause)
    if path is None or cause is None:
        return verdict
    if verdict.cause is Cause.UNANSWERED and not half.route.outgoing:
        return verdict  # the calls came, and it is a node of this side that has not answered them
    state = State.WAITING if cause is Cause.AWAITS_LINK else verdict.state
    return replace(verdict, state=state, cause=cause, text=path.text)


def stays_fine(half: Facts, crossing: Crossing, now: float) -> bool:
    """Whether no rule finds anything, if none has before and the route's signs are the same."""
    route, peer = half.route, half.route.peer
    return bool(
        crossing is Crossing.YES
        and not (route.arming.required or route.losses.reasons or route.limit.rate)
        and peer.verdicts is None and peer.path.fault is None and route.link_full is None
        and route.half.is_well(now) and route.trouble() is None
    )  # fmt: skip


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


def blocked(half: Facts, crossing: Crossing) -> Verdict | None:
    """Return the verdict that keeps the others from being known, or None."""
    if not half.route.peer.linked:
        return Verdict(State.DOWN, Cause.LINK_DOWN, half.route.away_text(), half.route.peer.suspended_since)
    # Each loss of a channel refuses the route, too. This comes first, because its text has the remedy.
    if why := half.breaking:
        text = (
            f"its data connection ends before a message arrives ({why}), though the link is up: check "
            "firewalls and NAT between the two sides"
        )
        return Verdict(State.DOWN, Cause.NO_PATH, text)
    return _refused(half) or _held_back(half, crossing)


def stages_with_link(half: Facts, before: Sequence[Stage], after: Sequence[Stage]) -> tuple[Stage, ...]:
    """Return a half's stages, with those of the link and of the peer's acceptance in the middle.

    The link's needs a working channel. Without a link, no other one is known.
    """
    if not half.route.peer.linked:
        link = Stage(_LINK_STAGE, False, half.route.peer.down_reason)
        before, after = ([Stage(each.name, None) for each in part] for part in (before, after))
        return (*before, link, Stage(ACCEPTED, None), *after)
    no_path, refusal = half.route.trouble(), half.route.life.refusal
    if no_path is None:
        link = Stage(_LINK_STAGE, True)
    else:
        link = Stage(_LINK_STAGE, False if no_path.state is State.DOWN else None, no_path.text)
    accepted = (
        Stage(ACCEPTED, False, str(refusal)) if refusal.text else Stage(ACCEPTED, half.route.life.accepted or None)
    )
    return (*before, link, accepted, *after)


def first_missing(stages: Iterable[Stage]) -> str:
    """Return in words what has to pass before anything can cross; failed stages come before undecided ones."""
    missing = [each for each in stages if not each.done]
    first = next((each for each in missing if each.done is False), None) or next(iter(missing), None)
    return (first.detail or f"not yet: {first.name}") if first else ""


def _refused(half: Facts) -> Verdict | None:
    refusal = half.route.shown_refusal
    if not refusal.text:
        return None
    if refusal.code is EndCode.LISTED_DIFFERENTLY:
        return Verdict(State.DOWN, Cause.LISTED_DIFFERENTLY, refusal.text)
    if not refusal.broke:
        return Verdict(State.DOWN, Cause.REFUSED, refusal.text)
    # Nobody has refused it. If the path is at fault, the link finds out within seconds, and shows it for all topics.
    if half.route.peer.path.fault is None and half.route.reopening.reopens(half.route.context.now()):
        return Verdict(State.WAITING, Cause.AWAITS_LINK, f"{REOPENS} ({refusal.text})")
    return Verdict(State.DOWN, Cause.NO_PATH, str(refusal))


def _held_back(half: Facts, crossing: Crossing) -> Verdict | None:
    match crossing:
        case Crossing.LOOP:
            return Verdict(State.DOWN, Cause.LOOP, half.route.notices.loop)
        case Crossing.DISARMING:
            _, disarmed = half.route.arming.why_at(half.route.context.now())
            text = f"{disarmed}; earlier messages may still act for 1 s"
            return Verdict(State.DISARMING, Cause.DISARMING, text)
        case Crossing.PAUSED:
            who = half.route.pausing.who
            return Verdict(State.PAUSED, Cause.PAUSED, f"paused ({who})" if who else "paused by an operator")
        case Crossing.DISARMED | Crossing.ASKED | Crossing.BEGINS:
            why, disarmed = half.route.arming.why_at(half.route.context.now())
            # That reason names the step that has to come first.
            remedy = "" if why is Disarmed.LINK_SLOW else f": arm it (key A, rsb-console arm {half.route.local_topic})"
            return Verdict(State.DISARMED, Cause.DISARMED, disarmed + remedy)
        case Crossing.NOT_OPEN | Crossing.RESTING | Crossing.UNHEARD | Crossing.YES:
            return None
