"""What happened, kept for a while: written by the engine's threads, read by logs and user interfaces."""

from __future__ import annotations

import itertools
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import encodable, sanitize_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.codes import EventCode

KEPT = 5000
EVENT_LENGTH = 2000
"""Characters of an event's text."""
_LENGTHS = {"text": EVENT_LENGTH} | dict.fromkeys(
    ("link", "topic", "who", "old", "new", "cause", "state"), REASON_LENGTH
)


class About(TypedDict, total=False):
    """What an event may say beside its text, as in `rsb_bridge.model.snapshot.Event`."""

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
        counts: how many there were of each level, also those that are not kept any more.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._numbers = itertools.count(1)
        self._news = threading.Condition()
        self.last = 0
        self.counts = dict.fromkeys(Level, 0)

    def add(self, level: Level, code: EventCode, text: str, **about: Unpack[About]) -> None:
        """Append an event; `rsb_bridge.model.snapshot.Event` says what each value is."""
        self.append(Event(0, self._clock.time_ns() / 1e9, level, code, text, **about))

    def append(self, event: Event) -> None:
        """Append an event of any engine's; it gets the next number of this log.

        It goes to terminals and files from here, and may quote a peer: each text becomes one line of a limited length.
        """
        event = replace(event, **_cleaned(event))
        with self._news:
            self.last = next(self._numbers)
            self._events.append(replace(event, number=self.last))
            self.counts[event.level] += 1
            self._news.notify_all()

    def after(self, number: int) -> list[Event]:
        """Those numbered above `number` that are still kept, oldest first."""
        with self._news:
            missing = self.last - number
            if missing <= 0:
                return []
            return list(itertools.islice(reversed(self._events), missing))[::-1]

    def wait(self, number: int, timeout: float, ends: Callable[[], bool] = lambda: False) -> list[Event]:
        """As `after`, but waits for one to come.

        Args:
            number: as `after`.
            timeout: s to wait, at most.
            ends: whether to wait no longer; looked at when `wake` is called.
        """
        with self._news:
            self._news.wait_for(lambda: self.last > number or ends(), timeout)
        return self.after(number)

    def wake(self) -> None:
        """Have those that wait look whether their waiting ends."""
        with self._news:
            self._news.notify_all()


def _cleaned(event: Event) -> dict[str, Any]:
    return {name: _one_line(getattr(event, name), length) for name, length in _LENGTHS.items()}


def _one_line(text: str, limit: int) -> str:
    return (
        text if text.isascii() and text.isprintable() and len(text) <= limit else sanitize_text(encodable(text), limit)
    )
