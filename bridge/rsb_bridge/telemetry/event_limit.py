"""Links' lines in the log, of each link as many as its share: a frame costs the peer less than its line costs us."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.token_bucket import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.telemetry.event_log import EventLog

AT_ONCE = 1000
"""Lines: more than a robot with five hundred topics makes when it links."""
A_SECOND = 5.0
"""Lines; a client that goes by its pauses between two calls makes no more about the link itself."""
_TOLD_EVERY = 10.0


class RateLimitedEventLog:
    """Adds links' events to the log, and in place of those that are too many one that says how many they were.

    Events about the link itself, up or down, have a share of their own, so that no flood of others displaces them. When
    even those are too many, the newest one is added late.

    Args:
        events: the log.
        now: gives the time (s) on a clock that nobody sets.
    """

    def __init__(self, events: EventLog, now: Callable[[], float]) -> None:
        self._events = events
        self._now = now
        self._shares: dict[tuple[str, bool], _Quota] = {}

    def add(self, level: Level, code: EventCode, text: str, *, link: str, topic: str, link_status: bool) -> None:
        """Add an event of a link, if its share has room.

        Args:
            level: how grave it is.
            code: what happened.
            text: in one line.
            link: by the client's name.
            topic: which it is about, or empty.
            link_status: it is about the link itself.
        """
        now = self._now()
        share = self._shares.get((link, link_status))
        if share is None:
            share = self._shares[link, link_status] = _Quota(now)
        if not share.passes(_Line(level, code, text, topic), now):
            return
        if link_status:  # in their order: first what was left out before it
            self._tell(link, link_status=False)
            self._tell(link, link_status=True)
        self._events.add(level, code, text, link=link, topic=topic)

    def tick(self) -> None:
        """Once a second: tell how many were left out, where that is over or has lasted."""
        now = self._now()
        for (link, link_status), share in self._shares.items():
            if share.due(now):
                self._tell(link, link_status=link_status)

    def _tell(self, link: str, *, link_status: bool) -> None:
        share = self._shares.get((link, link_status))
        if share is None or not share.left_out:
            return
        newest = share.newest if link_status else None
        left_out = share.left_out - (newest is not None)
        share.left_out, share.newest = 0, None
        if left_out:
            text = f"{left_out:,} more line{'s' if left_out > 1 else ''} left out"
            self._events.add(Level.WARNING, EventCode.LINK_EVENTS_LEFT_OUT, text, link=link)
        if newest is not None:
            self._events.add(newest.level, newest.code, newest.text, link=link, topic=newest.topic)


class _Line(NamedTuple):
    level: Level
    code: EventCode
    text: str
    topic: str


class _Quota:
    """A link's lines of one kind.

    Attributes:
        left_out: lines that were too many, since they were told of last.
        newest: of those.
    """

    def __init__(self, now: float) -> None:
        self.left_out = 0
        self.newest: _Line | None = None
        self._lines = TokenBucket(AT_ONCE, A_SECOND, now)
        self._since = now

    def passes(self, line: _Line, now: float) -> bool:
        if self._lines.take(1, now):
            return True
        if not self.left_out:
            self._since = now
        self.left_out += 1
        self.newest = line
        return False

    def due(self, now: float) -> bool:
        return self.left_out > 0 and (self._lines.left(now) >= 1 or now - self._since >= _TOLD_EVERY)
