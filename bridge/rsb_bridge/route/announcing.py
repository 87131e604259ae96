"""What the log says of a route's verdicts: each turn for the worse that lasts, and when it is over."""

from __future__ import annotations

from typing import NamedTuple

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import FINE, Cause, Verdict

_LASTS = 3.0
"""s that a verdict must last."""
_LOSS_LASTS = 7.0
"""s that a loss on the way must last: before that, its remedy is not known (`MEASURED_FOR`)."""
_WAITS = 10.0
"""s that a route must wait for the same: nodes that start beside the bridge have come by then."""
_MENDABLE: dict[str, Level] = {
    Cause.NO_PUBLISHER: Level.INFO,
    Cause.NO_SERVER: Level.INFO,
    Cause.SIMILAR_NAME: Level.WARNING,
    Cause.TYPE_UNKNOWN: Level.WARNING,
}
"""What a route may wait for that a person can mend: a name or a type that is typed wrong, a type to install."""
_AGAIN_AFTER = 60.0
"""s until the same is said again."""
_MOST_SAID = 32
_SAID_ELSEWHERE = frozenset(
    {
        Cause.LINK_DOWN, Cause.REFUSED, Cause.LOOP, Cause.PAUSED, Cause.DISARMED, Cause.DISARMING,
        Cause.SUBSCRIBE_FAILED, Cause.SILENT, Cause.NO_MESSAGE,
    }
)  # fmt: skip
"""Causes that have events of their own, on both sides."""
_TOLD = frozenset({State.DOWN, State.STALE, State.STOPPED, State.LATE, State.SLOW, State.UNHEARD})


class Announcement(NamedTuple):
    """An event."""

    level: Level
    code: EventCode
    text: str
    cause: str


class Announcer:
    """Decides what to say; called once a second."""

    def __init__(self) -> None:
        self._candidate = FINE
        self._since = float("-inf")
        self._said = FINE
        self._said_as: tuple[EventCode, str] | None = None
        self._said_at: dict[tuple[EventCode, str], float] = {}
        self._heard = False

    def tick(self, verdict: Verdict, now: float) -> Announcement | None:
        """Take the present verdict at `now` (s); what to say about it, if anything."""
        if (verdict.state, verdict.cause) != (self._candidate.state, self._candidate.cause):
            self._since = now
        self._candidate = verdict
        if now - self._since < (_LOSS_LASTS if verdict.cause == Cause.LOSSY else _LASTS):
            return None
        if verdict.state is State.OK:
            self._heard = True
            return self._over()
        if verdict.state is State.WAITING:
            return self._waiting(verdict, now)
        if verdict.state not in _TOLD or verdict.cause in _SAID_ELSEWHERE:
            return None
        if verdict.cause == Cause.NO_SUBSCRIBER and not self._heard:
            return None  # nobody has been there yet, which the screen shows
        return self._say(Level.WARNING, EventCode.ROUTE_FAULT, verdict, now)

    def _waiting(self, verdict: Verdict, now: float) -> Announcement | None:
        level = _MENDABLE.get(verdict.cause)
        if level is None or now - self._since < _WAITS:
            return None
        return self._say(level, EventCode.ROUTE_WAITING, verdict, now)

    def _say(self, level: Level, code: EventCode, verdict: Verdict, now: float) -> Announcement | None:
        what = code, verdict.cause
        if what == self._said_as or now - self._said_at.get(what, float("-inf")) < _AGAIN_AFTER:
            return None
        self._said, self._said_as = verdict, what
        if len(self._said_at) >= _MOST_SAID:  # a peer may make up causes
            self._said_at.clear()
        self._said_at[what] = now
        return Announcement(level, code, f"{verdict.state.upper()}: {verdict.said(now)}", verdict.cause)

    def _over(self) -> Announcement | None:
        said, self._said, self._said_as = self._said, FINE, None
        if said.state is State.OK:
            return None
        return Announcement(Level.INFO, EventCode.ROUTE_RECOVERED, f"no longer {said.state}", said.cause)
