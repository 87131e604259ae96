"""Whether a link carries less than is asked of it: what this side finds out, and what the peer says of its own."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.fullness import Fullness
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.wire.records import FullRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

_BEGINS, _ENDS = 4, 6
"""Looks, a second apart, that have to agree before a link counts as full, or as not full any more."""
_WINDOW = 3
"""Looks that what arrives is taken over: fewer than `_BEGINS`, so that a stall is not taken for a full link."""
_MORE = 1.15
"""Times what arrives: more than that has to be asked for."""
_FAR_LESS = 0.6
"""Times what is asked for."""
_AFTER_STALL = 6
"""Looks after a stall in which what arrives says nothing of what the link carries."""
_SMOOTH = 0.4
"""The part that the newest look has in the figures."""
_NAMED = 3
_FASTEST = 1e12


class Asked(NamedTuple):
    """What one topic wants of the link.

    Attributes:
        topic: its name on this side.
        remote_topic: its name on the other side.
        bytes_per_second: that it wants to send.
    """

    topic: str
    remote_topic: str
    bytes_per_second: float


class LinkFullness:
    """Both directions of one link.

    Args:
        log: adds an event about the link.

    Attributes:
        out: what the link carries from here if that is less than is asked of it, else None.
        into: likewise to here, as the peer says.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None]) -> None:
        self.out: Fullness | None = None
        self.into: Fullness | None = None
        self._log = log
        self._other = 0
        self._stalled = 0  # looks for which the last stall explains what arrives
        self._flowed = False
        self._carried = self._asked = 0.0
        self._arrived: deque[float] = deque(maxlen=_WINDOW)
        self._told = FullRecord()
        self._record = FullRecord()

    def look(self, topics: Collection[Asked], arrived: float, *, full: bool, peer: str) -> None:
        """Look once a second.

        Args:
            topics: that have something to send.
            arrived: bytes, since the last look a second ago.
            full: more waits to be sent all the time, or is late.
            peer: the other side's name.
        """
        asked = sum(each.bytes_per_second for each in topics)
        self._arrived.append(arrived)
        carried = sum(self._arrived) / len(self._arrived)
        self._carried += _SMOOTH * (carried - self._carried)
        self._asked += _SMOOTH * (asked - self._asked)
        # After a stall, one look brings less than is asked for, and the next ones all of it.
        too_little = asked > _MORE * arrived or carried < _FAR_LESS * asked
        self._stalled = max(0, self._stalled - 1)
        if carried or not asked:
            self._flowed = bool(carried)
        elif self._flowed:
            self._stalled = _AFTER_STALL
        over = full and carried > 0.0 and not self._stalled and asked > _MORE * carried and too_little
        was = self.out is not None
        self._other = self._other + 1 if over != was else 0
        if self._other >= (_ENDS if was else _BEGINS):
            self._other = 0
            was = not was
            if was:
                self._carried, self._asked = carried, asked
            else:
                self.out = None
                self._log(Level.INFO, EventCode.LINK_ROOM, f"the link to {peer} carries all that is asked of it again")
        if not was:
            self.out, self._record = None, FullRecord()
            return
        most = sorted(topics, key=lambda each: -each.bytes_per_second)[:_NAMED]
        # What is asked is no less than what arrives, though one of the two may be smoothed behind the other.
        figures = min(self._carried, self._asked), self._asked
        begins = self.out is None
        self.out = Fullness(*figures, tuple(each.topic for each in most))
        names = tuple(sanitize_text(each.remote_topic, TEXT_LENGTH) for each in most)
        self._record = FullRecord(round(figures[0]), round(figures[1]), names)
        if begins:
            self._log(Level.WARNING, EventCode.LINK_FULL, self.out.warning(f"to {peer}"))

    def news(self) -> FullRecord | None:
        """Return what the peer has not been told yet, or None."""
        if self._record == self._told:
            return None
        self._told = self._record
        return self._record

    def told(self, record: FullRecord, peer: str) -> None:
        """Take what the peer says of what it sends; figures that cannot be right are brought within sense."""
        before, self.into = self.into, None
        if record.asked:
            asked = _within(record.asked)
            self.into = Fullness(min(_within(record.carried), asked), asked, record.topics[:_NAMED])
            if before is None:
                self._log(Level.WARNING, EventCode.LINK_FULL, self.into.warning(f"from {peer}"))
        elif before is not None:
            self._log(Level.INFO, EventCode.LINK_ROOM, f"the link from {peer} carries all that is asked of it again")

    def disconnected(self) -> None:
        """Forget everything: the next connection may go another way."""
        self.out = self.into = None
        self._other = self._stalled = 0
        self._carried = self._asked = 0.0
        self._arrived.clear()
        self._told = self._record = FullRecord()

    def warning(self, peer: str) -> str:
        """What an operator is told, or an empty string."""
        out = self.out.warning(f"to {peer}") if self.out is not None else ""
        into = self.into.warning(f"from {peer}") if self.into is not None else ""
        return "; ".join(filter(None, (out, into)))


def _within(figure: float) -> float:
    return max(0.0, min(figure, _FASTEST)) if math.isfinite(figure) else 0.0
