"""Links' lines in the log, of each link as many as its share: a frame costs the peer less than its line costs us."""

from __future__ import annotations

from typing import TYPE_CHECKING

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

    What is said of the link itself, up or down, has a share of its own, so that no flood of other lines displaces it;
    of a link that itself goes up and down too often the newest line is told, late.

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
        if not share.passes(text, now):
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
        newest = f"; the last one: {share.newest}" if link_status else ""
        words = f"{share.left_out:,} more line{'s' if share.left_out > 1 else ''} left out{newest}"
        share.left_out = 0
        self._events.add(Level.WARNING, EventCode.LINK_EVENTS_LEFT_OUT, words, link=link)


class _Quota:
    """A link's lines of one kind.

    Attributes:
        left_out: lines that were too many, since they were told of last.
        newest: of those.
    """

    def __init__(self, now: float) -> None:
        self.left_out = 0
        self.newest = ""
        self._lines = TokenBucket(AT_ONCE, A_SECOND, now)
        self._since = now

    def passes(self, text: str, now: float) -> bool:
        if self._lines.take(1, now):
            return True
        if not self.left_out:
            self._since = now
        self.left_out += 1
        self.newest = text
        return False

    def due(self, now: float) -> bool:
        return self.left_out > 0 and (self._lines.left(now) >= 1 or now - self._since >= _TOLD_EVERY)
