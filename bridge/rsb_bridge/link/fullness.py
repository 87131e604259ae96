"""Decides whether a link is full: this side judges what it sends, and takes the peer's word for the other direction."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.wire.records import FullRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

_BEGINS, _ENDS = 4, 4
"""Ticks that have to agree before a link counts as full, or as no longer full."""
_WINDOW = 3
"""Ticks over which the arriving bytes are averaged: fewer than `_BEGINS`, so that a stall is no full link."""
_MORE = 1.15
"""A full link is asked for more than so many times the arriving bytes."""
_ALL = 0.95
"""Share of the asked bytes: a link that carries that much is not full, however short a time it does."""
_FAR_LESS = 0.6
"""Share of the asked bytes: if less arrives on average, the link is full even if the last tick brought more."""
_AFTER_STALL = 6
"""Ticks after a stall in which the arriving bytes say nothing about the link's capacity."""
_SHOWN_OVER = 6
"""Ticks over which the shown figure of the arriving bytes is averaged: a report may be a second late."""
_NAMED = 3
_FASTEST = 1e12


class Asked(NamedTuple):
    """Demand of one topic.

    Attributes:
        topic: its name on this side.
        remote_topic: its name on the other side.
        bytes_per_second: that it asks the link to carry.
    """

    topic: str
    remote_topic: str
    bytes_per_second: float


class LinkFullness:
    """Both directions of one link.

    Args:
        log: adds an event about the link.

    Attributes:
        out: the rates from here, or None if the link is not full.
        into: the rates to here, as the peer reports them, or None if the link is not full.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None]) -> None:
        self.out: Fullness | None = None
        self.into: Fullness | None = None
        self._log = log
        self._other = 0
        self._stalled = 0  # ticks for which the last stall explains the arriving bytes
        self._flowed = False
        self._arrived: deque[float] = deque(maxlen=_WINDOW)
        self._lately: deque[float] = deque(maxlen=_SHOWN_OVER)  # since it seems full
        self._sent = FullRecord()
        self._record = FullRecord()

    def tick(self, topics: Collection[Asked], arrived: float, *, full: bool, peer: str) -> None:
        """Judge the direction from here. Called once a second.

        Args:
            topics: that have something to send.
            arrived: bytes since the last tick.
            full: whether messages wait to be sent all the time, or are late.
            peer: the other side's name.
        """
        asked = sum(each.bytes_per_second for each in topics)
        self._arrived.append(arrived)
        carried = sum(self._arrived) / len(self._arrived)
        # After a stall, one tick brings less than is asked for, and the next ones bring all of it.
        too_little = asked > _MORE * arrived or carried < _FAR_LESS * asked
        self._stalled = max(0, self._stalled - 1)
        if carried or not asked:
            self._flowed = bool(carried)
        elif self._flowed:
            self._stalled = _AFTER_STALL
        over = full and carried > 0.0 and not self._stalled and asked > _MORE * carried and too_little
        was = self.out is not None
        if not was and not self._other:
            self._lately.clear()  # it carried what it was asked for
        self._lately.append(arrived)
        shown = _mean_reported(self._lately)
        self._other = self._other + 1 if over != was else 0
        carries_all = was and shown >= _ALL * asked
        if carries_all or self._other >= (_ENDS if was else _BEGINS):
            self._other = 0
            was = not was
            if not was:
                self.out = None
                self._log(Level.INFO, EventCode.LINK_ROOM, f"the link to {peer} is no longer full")
        if not was:
            self.out, self._record = None, FullRecord()
            return
        most = sorted(topics, key=lambda each: -each.bytes_per_second)[:_NAMED]
        figures = min(shown, asked), asked  # the two are averaged over different times
        begins = self.out is None
        self.out = Fullness(*figures, tuple(each.topic for each in most))
        names = tuple(sanitize_text(each.remote_topic, TEXT_LENGTH) for each in most)
        self._record = FullRecord(round(figures[0]), round(figures[1]), names)
        if begins:
            self._log(Level.WARNING, EventCode.LINK_FULL, self.out.warning(f"to {peer}"))

    @property
    def undecided(self) -> bool:
        """Whether the link from here may be full, which is being measured."""
        return self.out is None and self._other > 0

    def next_record(self) -> FullRecord | None:
        """Return the record for the peer, or None if it has not changed since the last one."""
        if self._record == self._sent:
            return None
        self._sent = self._record
        return self._record

    def take_record(self, record: FullRecord, peer: str) -> None:
        """Take the peer's record of what it sends; impossible figures are limited."""
        before, self.into = self.into, None
        if record.asked:
            asked = _within(record.asked)
            self.into = Fullness(min(_within(record.carried), asked), asked, record.topics[:_NAMED])
            if before is None:
                self._log(Level.WARNING, EventCode.LINK_FULL, self.into.warning(f"from {peer}"))
        elif before is not None:
            self._log(Level.INFO, EventCode.LINK_ROOM, f"the link from {peer} is no longer full")

    def disconnected(self) -> None:
        """Forget everything: the next connection may go another way."""
        self.out = self.into = None
        self._other = self._stalled = 0
        self._arrived.clear()
        self._lately.clear()
        self._sent = self._record = FullRecord()

    def warning(self, peer: str) -> str:
        """Return the warning for an operator, or an empty string."""
        out = self.out.warning(f"to {peer}") if self.out is not None else ""
        into = self.into.warning(f"from {peer}") if self.into is not None else ""
        return "; ".join(filter(None, (out, into)))


def _mean_reported(ticks: Collection[float]) -> float:
    """Return the mean up to the last tick in which something arrived: the next report may only be late.

    In the first tick more may have arrived, until a queue on the way filled up.
    """
    first, *others = ticks
    while others and not others[-1]:
        others.pop()
    reported = [min(first, max(others)), *others] if others else [first]
    return sum(reported) / len(reported)


def _within(figure: float) -> float:
    return max(0.0, min(figure, _FASTEST)) if math.isfinite(figure) else 0.0
