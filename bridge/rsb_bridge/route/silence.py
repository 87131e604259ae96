"""How long a route has been silent, and what the log says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.telemetry.meters import StaleWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.session import Session, Topic


_EXPLAINS = frozenset(
    {
        Cause.NO_PATH,
        Cause.SUBSCRIBE_FAILED,
        Cause.QOS_INCOMPATIBLE,
        Cause.TYPE_CONFLICT,
        Cause.TYPE_UNKNOWN,
        Cause.NO_PUBLISHER,
        Cause.SIMILAR_NAME,
        Cause.PUBLISHER_GONE,
        Cause.TOO_LARGE,
        Cause.NOT_PUBLISHED,
        Cause.LOSSY,
    }
)
"""Causes of silence. Others are silence itself, in other words, or go with messages."""


class Silence:
    """Warns of a route's silence after the time that its topic's entry or the session says.

    Args:
        log: adds an event about the route.
        now: s.

    Attributes:
        own: the topic's entry says after how long it is stale.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None], now: float) -> None:
        self.own = False
        self._log = log
        self._watch = StaleWatch(0.0, 0, now)
        self._warned = False  # in the log, since a message came

    def configure(self, topic: Topic, session: Session) -> None:
        """Watch as the topic's entry and the session say now."""
        self.own = topic.stale_after is not None
        self._watch.after = session.stale_after if topic.stale_after is None else topic.stale_after
        self._watch.times = session.stale_warnings

    def rearm(self, now: float) -> None:
        """Begin anew: no message was due before `now` (s)."""
        self._watch.rearm(now)
        self._warned = False

    def tick(self, now: float, *, due: bool, cause: str) -> None:
        """Warn if nothing has come for too long although messages are due. Called once a second.

        Args:
            now: s.
            due: whether messages are due.
            cause: of the route's state. A cause that explains the silence is logged already, and not repeated.
        """
        if due and (number := self._watch.check(now)) and cause not in _EXPLAINS:
            self._warned = True
            text = f"nothing for {self._watch.after * number:g} s (warning {number} of {self._watch.times})"
            if number == self._watch.times:
                text += "; no more will be said until data returns"
            self._log(Level.WARNING, EventCode.ROUTE_STALE, text)

    def seen(self, now: float) -> None:
        """A message came at `now` (s)."""
        quiet = self._watch.seen(now)
        if quiet is not None and self._warned:
            self._log(Level.INFO, EventCode.ROUTE_DATA_AGAIN, f"reinitialized: data again after {quiet:.0f} s")
        self._warned = False

    @property
    def quiet_since(self) -> float:
        """s, when the last message came, or when counting began anew."""
        return self._watch.quiet_since

    def stale_since(self, now: float) -> float | None:
        """`quiet_since` if that is too long ago at `now` (s), else None."""
        return self._watch.quiet_since if self._watch.stale(now) else None
