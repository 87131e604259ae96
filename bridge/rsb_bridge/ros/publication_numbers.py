"""Counts messages of a topic that nobody here took, by the numbers that DDS gives each publisher's messages."""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_PUBLISHERS_REMEMBERED = 1024
"""Publishers of one topic whose newest numbers are kept. A round figure; see `PublicationNumbers._make_room`."""
_DISCOVERED_WITHIN = 5.0
"""s that a publisher that was there before may take to be found: DDS repeats lost parts of its discovery every 3 s."""


class Untaken(StrEnum):
    """Reasons why messages were not taken, named as the fields of `rsb_bridge.model.snapshot.Ledger`."""

    LOST = "lost_in_dds"
    MISSED = "missed_while_down"
    UNSUBSCRIBED = "unsubscribed"


_NONE_YET: Mapping[str, int] = MappingProxyType(dict.fromkeys(Untaken, 0))


class PublicationNumbers:
    """Follows each publisher's newest number, from one subscription to a topic to the next.

    DDS numbers a publisher's messages from 1, whether anybody subscribes or not. So the first message after a gap tells
    how many came before it. Cyclone DDS tells no numbers; then nothing is counted.

    Args:
        clock: returns s.

    Attributes:
        newest: the number taken last, by publisher, in the present subscription. The thread that takes changes it.
        counts: messages that were not taken, by `Untaken`.
        gap: why the messages before the next subscription are not taken. After it, `Untaken.LOST` until it is set
            again: a subscription that is replaced was meant to last.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.newest: dict[bytes, int] = {}
        self.counts: dict[str, int] = dict(_NONE_YET)
        self.gap = Untaken.UNSUBSCRIBED
        self._clock = clock
        self._before: dict[bytes, int] = {}  # the newest numbers of earlier subscriptions
        self._present_gap = self.gap
        self._earlier: frozenset[bytes] | None = None
        self._began_at = 0.0
        self._forgot = False  # so that a publisher that seems new may be a forgotten one

    def begin(self, earlier: frozenset[bytes] | None) -> None:
        """Begin a subscription; the one before is closed.

        Args:
            earlier: publishers from before it, or None if each publisher's first messages are history.
        """
        self._before |= self.newest
        self.newest = {}
        self._present_gap, self.gap = self.gap, Untaken.LOST
        self._earlier, self._began_at = earlier, self._clock()

    def first(self, publisher: bytes, number: int) -> int:
        """Count the messages before a publisher's first one in this subscription; return the newest one's number."""
        gap, before = self._present_gap, self._before.pop(publisher, None)
        if before is None:
            before = number - 1 if self._forgot else 0
            if self._is_newcomer(publisher):
                gap = Untaken.LOST
        self.counts[gap] += max(0, number - 1 - before)
        self._make_room()
        return number - 1

    def lose(self, count: int) -> None:
        """Count messages that are missing between two that were taken."""
        self.counts[Untaken.LOST] += count

    def _is_newcomer(self, publisher: bytes) -> bool:
        """Whether a publisher came after the subscription, which so should have had its first message."""
        if self._earlier is None or publisher in self._earlier:
            return False
        return self._clock() - self._began_at > _DISCOVERED_WITHIN

    def _make_room(self) -> None:
        """Make room for another publisher: short-lived ones must not fill the memory."""
        while len(self._before) + len(self.newest) >= _PUBLISHERS_REMEMBERED:
            known = self._before or self.newest
            del known[next(iter(known))]
            self._forgot = True
