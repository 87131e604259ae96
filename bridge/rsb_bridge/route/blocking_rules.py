"""The verdicts that all routes have in common: a link that is down, a pause, a limit and the like."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import FINE, Cause, Verdict

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


class RouteStatus(NamedTuple):
    """The part of one half's knowledge that does not depend on what its route carries.

    Attributes:
        sends: whether it is the sending half; of calls, the callers' half.
        topic: its name on this side.
        domain_id: of this side.
        link_down: the reason why the link is down, or empty.
        refusal: the reason why the route is refused, or empty.
        loop: the reason why its messages or calls would loop, or empty.
        paused: whether an operator has paused it.
        paused_by: the operator, or empty if unknown.
        disarmed: the reason why it is not armed although it must be, or empty.
        disarming: whether the other side may still act on messages from before it was disarmed.
        can_be_armed: whether an operator may arm it; if not, `disarmed` names the step that has to come first.
        no_path: the reason why its transport does not get through, or empty.
        breaking: the reason why its channel breaks before anything arrives, or empty.
        crowded_out: the reason why it yields to other routes of its link, or empty.
        waits_for: the step that has to come before anything can cross.
        limit: Hz that an operator allows, or 0 for no limit.
        limited_by: the reason for the limit, in words.
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
    crowded_out: str = ""
    waits_for: str = ""
    limit: float = 0.0
    limited_by: str = "set on purpose (max_rate)"


def worst(status: RouteStatus, verdicts: Iterable[Verdict | None]) -> tuple[Verdict, list[Verdict]]:
    """Return the verdict that counts, and all that were found.

    A blocking verdict counts alone, because it keeps the others from being known. Otherwise the worst one counts,
    and of equally bad ones the first.

    Args:
        status: the route's.
        verdicts: of the rules for what the route carries; not evaluated if something blocks.
    """
    if (blocking := blocked(status)) is not None:
        return blocking, [blocking]
    found = [each for each in (_no_path(status), *verdicts, _throttled(status)) if each is not None]
    return min(found, key=lambda verdict: verdict.state.rank, default=FINE), found


def blocked(status: RouteStatus) -> Verdict | None:
    """Return the verdict that keeps the others from being known, or None."""
    return next((verdict for rule in _BLOCKING if (verdict := rule(status)) is not None), None)


def _no_path(status: RouteStatus) -> Verdict | None:
    return Verdict(State.DOWN, Cause.NO_PATH, status.no_path) if status.no_path else None


def _throttled(status: RouteStatus) -> Verdict | None:
    if not status.limit:
        return None
    return Verdict(State.OK, Cause.THROTTLED, f"limit {status.limit:g} Hz, {status.limited_by}")


def _link(status: RouteStatus) -> Verdict | None:
    return Verdict(State.DOWN, Cause.LINK_DOWN, status.link_down) if status.link_down else None


def _breaking(status: RouteStatus) -> Verdict | None:
    if not status.breaking:
        return None
    text = f"its data connection ends before a message arrives ({status.breaking}), though the link is up: "
    if status.crowded_out:
        text += f"{status.crowded_out}; make its messages smaller, or set compression: zstd or a higher priority"
    else:
        text += (
            "large packets may be lost on the way; set a lower MTU on both sides (ip link set DEVICE mtu 1280), "
            "or make messages smaller"
        )
    return Verdict(State.DOWN, Cause.NO_PATH, text)


def _refused(status: RouteStatus) -> Verdict | None:
    return Verdict(State.DOWN, Cause.REFUSED, status.refusal) if status.refusal else None


def _loop(status: RouteStatus) -> Verdict | None:
    return Verdict(State.DOWN, Cause.LOOP, status.loop) if status.loop else None


def _disarming(status: RouteStatus) -> Verdict | None:
    """Judge a route that is being disarmed; comes before `_paused`, because a pause disarms as well."""
    if not (status.disarmed and status.disarming):
        return None
    text = f"{status.disarmed}; earlier messages may still act for 1 s"
    return Verdict(State.DISARMING, Cause.DISARMING, text)


def _paused(status: RouteStatus) -> Verdict | None:
    if not status.paused:
        return None
    text = f"paused ({status.paused_by})" if status.paused_by else "paused by an operator"
    return Verdict(State.PAUSED, Cause.PAUSED, text)


def _disarmed(status: RouteStatus) -> Verdict | None:
    if not status.disarmed:
        return None
    if not status.can_be_armed:
        return Verdict(State.DISARMED, Cause.DISARMED, status.disarmed)
    text = f"{status.disarmed}: arm it (key A, rsb-console arm {status.topic})"
    return Verdict(State.DISARMED, Cause.DISARMED, text)


_BLOCKING: tuple[Callable[[RouteStatus], Verdict | None], ...] = (
    _link, _breaking, _refused, _loop, _disarming, _paused, _disarmed,
)  # fmt: skip
