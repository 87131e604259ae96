"""The links and topics that a timeline remembers, and which of them give way where there are too many."""

from __future__ import annotations

from collections import Counter
from typing import Literal

from rsb_bridge.history.subject import Subject
from rsb_bridge.model.history import LINK
from rsb_bridge.model.session import Kind

SUBJECTS = 2000
"""Links and topics kept, those that are gone included."""

Key = tuple[str, Kind | Literal["link"], str, bool]
"""Of a subject: link, kind, topic, outgoing."""


class Subjects(dict[Key, Subject]):
    """Subjects by key. What the timeline looks up for each route, every second, takes no walk over all of them."""

    def __init__(self) -> None:
        super().__init__()
        self._topics: Counter[str] = Counter()  # by link
        self._gone: list[Key] = []
        self._gone_in = -1

    def __setitem__(self, key: Key, subject: Subject) -> None:
        self._topics[key[0]] += key[1] != LINK and key not in self
        super().__setitem__(key, subject)

    def __delitem__(self, key: Key) -> None:
        super().__delitem__(key)
        self._topics[key[0]] -= key[1] != LINK
        if not self._topics[key[0]]:
            del self._topics[key[0]]

    def make_room(self, key: Key, turn: int) -> bool:
        """Make room for a new subject: no link has more topics than it leaves to the others.

        Those that are gone give way, of the link that has most, but not of one that has fewer than the new one's.

        Args:
            key: the new subject's.
            turn: differs from one look at all links and topics to the next.
        """
        topics, own = self._topics, self._topics[key[0]]
        if key[1] == LINK or own <= SUBJECTS - len(self):
            return True
        if turn != self._gone_in:
            self._gone_in, self._gone = turn, [each for each, subject in self.items() if not subject.live]
        gone = [each for each in self._gone if each in self and not self[each].live and topics[each[0]] >= own]
        if not gone:
            return False
        del self[min(gone, key=lambda each: (-topics[each[0]], self[each].series.end))]
        return True
