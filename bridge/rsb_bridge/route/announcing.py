"""What the log says of a route's verdicts: each turn for the worse that lasts, and when it is over."""

from __future__ import annotations

from typing import NamedTuple

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import FINE, Cause, Verdict

_LASTS = 3.0
"""s that a verdict must last."""
_AGAIN_AFTER = 60.0
"""s until the same is said again."""
_MOST_SAID = 32
_SAID_ELSEWHERE = frozenset(
    {Cause.LINK_DOWN, Cause.REFUSED, Cause.LOOP, Cause.PAUSED, Cause.SUBSCRIBE_FAILED, Cause.SILENT, Cause.NO_MESSAGE}
)
"""Causes that have events of their own, on both sides."""
_TOLD = frozenset({State.DOWN, State.STALE, State.STOPPED, State.SLOW, State.UNHEARD})


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
        self._said_at: dict[str, float] = {}
        self._heard = False

    def tick(self, verdict: Verdict, now: float) -> Announcement | None:
        """Take the present verdict at `now` (s); what to say about it, if anything."""
        if (verdict.state, verdict.cause) != (self._candidate.state, self._candidate.cause):
            self._since = now
        self._candidate = verdict
        if now - self._since < _LASTS:
            return None
        if verdict.state is State.OK:
            self._heard = True
            return self._over()
        if verdict.state not in _TOLD or verdict.cause in _SAID_ELSEWHERE:
            return None
        if verdict.cause == Cause.NO_SUBSCRIBER and not self._heard:
            return None  # nobody has been there yet, which the screen shows
        return self._worse(verdict, now)

    def _worse(self, verdict: Verdict, now: float) -> Announcement | None:
        if verdict.cause == self._said.cause:
            return None
        if now - self._said_at.get(verdict.cause, float("-inf")) < _AGAIN_AFTER:
            return None
        self._said = verdict
        if len(self._said_at) >= _MOST_SAID:  # a peer may make up causes
            self._said_at.clear()
        self._said_at[verdict.cause] = now
        return Announcement(
            Level.WARNING, EventCode.ROUTE_FAULT, f"{verdict.state.upper()}: {verdict.said(now)}", verdict.cause
        )

    def _over(self) -> Announcement | None:
        said, self._said = self._said, FINE
        if said.state is State.OK:
            return None
        return Announcement(Level.INFO, EventCode.ROUTE_RECOVERED, f"no longer {said.state}", said.cause)
