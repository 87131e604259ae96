"""What happened, kept for a while: written by the engine's threads, read by logs and user interfaces."""

from __future__ import annotations

import itertools
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import encodable

if TYPE_CHECKING:
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.codes import EventCode

KEPT = 5000


class EventLog:
    """A bounded list of events. Writing never waits for a reader."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._numbers = itertools.count(1)
        self._news = threading.Condition()
        self.last = 0

    def add(
        self,
        level: Level,
        code: EventCode,
        text: str,
        *,
        link: str = "",
        topic: str = "",
        who: str = "",
        old: str = "",
        new: str = "",
        cause: str = "",
    ) -> None:
        """Append an event; `rsb_bridge.model.snapshot.Event` says what each value is."""
        texts = (encodable(each) for each in (text, link, topic, who, old, new, cause))
        self.append(Event(0, self._clock.time_ns() / 1e9, level, code, *texts))

    def append(self, event: Event) -> None:
        """Append an event of any engine's; it gets the next number of this log."""
        with self._news:
            self.last = next(self._numbers)
            self._events.append(replace(event, number=self.last))
            self._news.notify_all()

    def after(self, number: int) -> list[Event]:
        """Those numbered above `number` that are still kept, oldest first."""
        with self._news:
            missing = self.last - number
            if missing <= 0:
                return []
            return list(itertools.islice(reversed(self._events), missing))[::-1]

    def wait(self, number: int, timeout: float) -> list[Event]:
        """As `after`, but waits up to `timeout` s for one to come."""
        with self._news:
            self._news.wait_for(lambda: self.last > number, timeout)
        return self.after(number)
