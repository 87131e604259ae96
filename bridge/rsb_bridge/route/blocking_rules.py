"""Rules that decide about any route, whatever it carries, before those of topics and of calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict

if TYPE_CHECKING:
    from collections.abc import Callable


class Standing(Protocol):
    """What a half knows of its route, whatever that carries: as in `rsb_bridge.route.topic_verdict.Facts`."""

    @property
    def topic(self) -> str: ...
    @property
    def link_down(self) -> str: ...
    @property
    def breaking(self) -> str: ...
    @property
    def crowded_out(self) -> str: ...
    @property
    def refusal(self) -> str: ...
    @property
    def loop(self) -> str: ...
    @property
    def paused(self) -> bool: ...
    @property
    def paused_by(self) -> str: ...
    @property
    def disarmed(self) -> str: ...
    @property
    def disarming(self) -> bool: ...
    @property
    def can_be_armed(self) -> bool: ...
    @property
    def no_path(self) -> str: ...
    @property
    def limit(self) -> float: ...
    @property
    def limited_by(self) -> str: ...


def gated(facts: Standing) -> Verdict | None:
    """What keeps everything else from being known; None: nothing does."""
    return next((verdict for gate in _GATES if (verdict := gate(facts)) is not None), None)


def rank(verdict: Verdict) -> int:
    """0 for the worst."""
    return verdict.state.rank


def no_path(facts: Standing) -> Verdict | None:
    """A rule: its transport does not get through."""
    return Verdict(State.DOWN, Cause.NO_PATH, facts.no_path) if facts.no_path else None


def throttled(facts: Standing) -> Verdict | None:
    """A rule: an operator limits it."""
    if not facts.limit:
        return None
    return Verdict(State.OK, Cause.THROTTLED, f"limit {facts.limit:g} Hz, {facts.limited_by}")


def _link(facts: Standing) -> Verdict | None:
    return Verdict(State.DOWN, Cause.LINK_DOWN, facts.link_down) if facts.link_down else None


def _breaking(facts: Standing) -> Verdict | None:
    if not facts.breaking:
        return None
    text = f"its data connection ends before a message arrives ({facts.breaking}), though the link is up: "
    if facts.crowded_out:
        text += f"{facts.crowded_out}; make its messages smaller, or set compression: zstd or a higher priority"
    else:
        text += (
            "large packets may be lost on the way; set a lower MTU on both sides (ip link set DEVICE mtu 1280), "
            "or make messages smaller"
        )
    return Verdict(State.DOWN, Cause.NO_PATH, text)


def _refused(facts: Standing) -> Verdict | None:
    return Verdict(State.DOWN, Cause.REFUSED, facts.refusal) if facts.refusal else None


def _loop(facts: Standing) -> Verdict | None:
    return Verdict(State.DOWN, Cause.LOOP, facts.loop) if facts.loop else None


def _disarming(facts: Standing) -> Verdict | None:
    """A gate: before that of a pause, as a pause disarms, too."""
    if not (facts.disarmed and facts.disarming):
        return None
    text = f"{facts.disarmed}; messages sent before it may act for 1 s"
    return Verdict(State.DISARMING, Cause.DISARMING, text)


def _paused(facts: Standing) -> Verdict | None:
    if not facts.paused:
        return None
    text = f"paused ({facts.paused_by})" if facts.paused_by else "paused by an operator"
    return Verdict(State.PAUSED, Cause.PAUSED, text)


def _disarmed(facts: Standing) -> Verdict | None:
    if not facts.disarmed:
        return None
    if not facts.can_be_armed:
        return Verdict(State.DISARMED, Cause.DISARMED, facts.disarmed)
    text = f"{facts.disarmed}: arm it (key A, rsb-console arm {facts.topic})"
    return Verdict(State.DISARMED, Cause.DISARMED, text)


_GATES: tuple[Callable[[Standing], Verdict | None], ...] = (
    _link, _breaking, _refused, _loop, _disarming, _paused, _disarmed,
)  # fmt: skip
