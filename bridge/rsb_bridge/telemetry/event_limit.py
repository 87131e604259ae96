"""Rate-limits the log lines of each link, which a peer can cause at little cost to itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Unpack

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import plural
from rsb_bridge.model.token_bucket import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.telemetry.event_log import About, EventLog

AT_ONCE = 1000
"""Lines: more than a robot with five hundred topics makes when it links."""
A_SECOND = 5.0
"""Lines; a client that keeps its delays between attempts causes no more about the link itself."""
_REPORTED_EVERY = 10.0


class RateLimitedEventLog:
    """Adds links' events to the log; in place of those beyond a link's quota, one event says how many are missing.

    Events about the link itself, up or down, have a quota of their own, so that no flood of others displaces them. If
    even those exceed it, the newest one is added late.

    Args:
        events: the log.
        now: gives the time (s) on a clock that nobody sets.
    """

    def __init__(self, events: EventLog, now: Callable[[], float]) -> None:
        self._events = events
        self._now = now
        self._quotas: dict[tuple[str, bool], _Quota] = {}

    def add(self, level: Level, code: EventCode, text: str, *, link_status: bool, **about: Unpack[About]) -> None:
        """Add an event of a link, if its quota has room.

        Args:
            level: how grave it is.
            code: what happened.
            text: in one line.
            link_status: it is about the link itself.
            about: `link`, by the client's name, and whatever else an event says.
        """
        link = about["link"]
        now = self._now()
        quota = self._quotas.get((link, link_status))
        if quota is None:
            quota = self._quotas[link, link_status] = _Quota(now)
        if not quota.passes(_Line(level, code, text, about), now):
            return
        if link_status:  # keep the order: first report what was left out before it
            self._report(link, link_status=False)
            self._report(link, link_status=True)
        self._events.add(level, code, text, **about)

    def tick(self) -> None:
        """Once a second: report how many events were left out, once the flood is over or has lasted 10 s."""
        now = self._now()
        for (link, link_status), quota in self._quotas.items():
            if quota.due(now):
                self._report(link, link_status=link_status)

    def _report(self, link: str, *, link_status: bool) -> None:
        quota = self._quotas.get((link, link_status))
        if quota is None or not quota.left_out:
            return
        newest = quota.newest if link_status else None
        left_out = quota.left_out - (newest is not None)
        quota.left_out, quota.newest = 0, None
        if left_out:
            text = f"{left_out:,} more {plural(left_out, 'line')} left out"
            self._events.add(Level.WARNING, EventCode.LINK_EVENTS_LEFT_OUT, text, link=link)
        if newest is not None:
            self._events.add(newest.level, newest.code, newest.text, **newest.about)


class _Line(NamedTuple):
    level: Level
    code: EventCode
    text: str
    about: About


class _Quota:
    """A link's lines of one kind.

    Attributes:
        left_out: lines beyond the quota since the last report.
        newest: the newest of them.
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
        return self.left_out > 0 and (self._lines.left(now) >= 1 or now - self._since >= _REPORTED_EVERY)
