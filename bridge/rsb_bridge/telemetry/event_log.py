"""The events of an engine, kept for a while, and the limit of each link's, which a peer can cause at little cost."""

from __future__ import annotations

import itertools
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import encodable, plural, sanitize_text

if TYPE_CHECKING:
    from collections.abc import Callable
    from enum import StrEnum

    from rsb_bridge.model.clock import Clock

KEPT = 5000
"""Events; not measured. While the disk takes nothing, events wait here for it, and one link that floods the log
displaces the others' after some minutes (`AT_ONCE`, `A_SECOND`)."""
EVENT_LENGTH = 2000
"""Characters of an event's text."""
_LENGTHS = {"text": EVENT_LENGTH} | dict.fromkeys(
    ("link", "topic", "who", "old", "new", "cause", "state"), REASON_LENGTH
)
AT_ONCE = 1000
"""Lines: more than a robot with five hundred topics makes when it links."""
A_SECOND = 5.0
"""Lines; a client that keeps its delays between attempts causes no more about the link itself."""
# s; not measured: a flood that lasts shows up in the log while it lasts, with six lines a minute.
_REPORTED_EVERY = 10.0


class About(TypedDict, total=False):
    """Optional fields of an `rsb_bridge.model.snapshot.Event`."""

    link: str
    topic: str
    who: str
    old: str
    new: str
    cause: str
    state: str
    since: float | None
    from_peer: bool


class EventLog:
    """A bounded list of events. Writing never waits for a reader.

    Attributes:
        last: the number of the newest event.
        counts: number of events of each level, including dropped ones.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._numbers = itertools.count(1)
        self._news = threading.Condition()
        self.last = 0
        self.counts = dict.fromkeys(Level, 0)

    def add(self, level: Level, code: StrEnum, text: str, **about: Unpack[About]) -> None:
        """Append an event; `rsb_bridge.model.snapshot.Event` says what each value is."""
        self.append(Event(0, self._clock.time_ns() / 1e9, level, code, text, **about))

    def append(self, event: Event) -> None:
        """Append an event of any engine's; it gets the next number of this log.

        It goes to terminals and files from here, and may quote a peer: each text becomes one line of a limited length.
        """
        # Outside of the lock, so that a long text holds up no other thread. Nearly none has to be cleaned.
        cleaned: dict[str, Any] = {}
        for name, most in _LENGTHS.items():
            text = getattr(event, name)
            if not (text.isascii() and text.isprintable() and len(text) <= most):
                cleaned[name] = sanitize_text(encodable(text), most)
        with self._news:
            self.last = next(self._numbers)
            self._events.append(replace(event, number=self.last, **cleaned))
            self.counts[event.level] += 1
            self._news.notify_all()

    def after(self, number: int) -> list[Event]:
        """Return the events numbered above `number` that are still kept, oldest first."""
        with self._news:
            missing = self.last - number
            if missing <= 0:
                return []
            # From the newest end: readers come several times a second, and lack a few of thousands.
            return list(itertools.islice(reversed(self._events), missing))[::-1]

    def wait(self, number: int, timeout: float, ends: Callable[[], bool] = lambda: False) -> list[Event]:
        """Wait for an event above `number`, and return all of them.

        Args:
            number: of the last event that the caller has.
            ends: returns whether to stop waiting; called after each `wake`.
        """
        with self._news:
            self._news.wait_for(lambda: self.last > number or ends(), timeout)
        return self.after(number)

    def wake(self) -> None:
        """Make all callers of `wait` check whether to stop."""
        with self._news:
            self._news.notify_all()


class RateLimitedEventLog:
    """Adds links' events to the log; in place of those beyond a link's quota, one event says how many are missing.

    Events about the link itself, up or down, have a quota of their own, so that no flood of others displaces them. If
    even those exceed it, the newest one is added late.

    Args:
        now: gives the time (s) on a clock that nobody sets.
    """

    def __init__(self, events: EventLog, now: Callable[[], float]) -> None:
        self._events = events
        self._now = now
        self._quotas: dict[tuple[str, bool], _Quota] = {}

    def add(self, level: Level, code: StrEnum, text: str, *, link_status: bool, **about: Unpack[About]) -> None:
        """Add an event of a link, if its quota has room.

        Args:
            link_status: whether it is about the link itself.
            about: `link`, the client's name, and other fields of the event.
        """
        link = about["link"]
        now = self._now()
        quota = self._quotas.get((link, link_status))
        if quota is None:
            quota = self._quotas[link, link_status] = _Quota(now)
        if not quota.lines.take(1, now):
            quota.leave_out(_Line(level, code, text, about), now)
            return
        if link_status:  # keep the order: earlier events that were left out come first
            self._report(link, link_status=False)
            self._report(link, link_status=True)
        self._events.add(level, code, text, **about)

    def tick(self) -> None:
        """Report how many events were left out, when the flood is over or has lasted 10 s. Called once a second."""
        now = self._now()
        for (link, link_status), quota in self._quotas.items():
            if quota.due(now):
                self._report(link, link_status=link_status)

    def forget(self, link: str) -> None:
        """Forget a link that was removed, after a last report of the lines left out."""
        for link_status in (False, True):
            self._report(link, link_status=link_status)
            self._quotas.pop((link, link_status), None)

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
    code: StrEnum
    text: str
    about: About


class _Quota:
    """A link's lines of one kind.

    Attributes:
        lines: its room.
        left_out: lines beyond it since the last report.
        newest: the newest of them.
    """

    def __init__(self, now: float) -> None:
        self.left_out = 0
        self.newest: _Line | None = None
        self.lines = TokenBucket(AT_ONCE, A_SECOND, now)
        self._since = now

    def leave_out(self, line: _Line, now: float) -> None:
        if not self.left_out:
            self._since = now
        self.left_out += 1
        self.newest = line

    def due(self, now: float) -> bool:
        return self.left_out > 0 and (self.lines.left(now) >= 1 or now - self._since >= _REPORTED_EVERY)
