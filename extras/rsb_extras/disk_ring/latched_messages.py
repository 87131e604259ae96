"""The messages that late joiners get, with which each segment begins."""

from __future__ import annotations

from collections import deque
from operator import attrgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.recording.message_ring import RingMessage

_SIZE = 128 << 20
"""Bytes of all. A round figure: beyond it, the topic with the most gives up its oldest message."""
_OLDER = 64 << 10
"""Bytes of a publisher's older messages that stay with its newest one. A round figure; those that came over a link,
whose publishers nobody tells apart, have 16 times as much."""
_PUBLISHERS = 256
"""Publishers of a topic. A round figure: a node that starts again and again with other content has the oldest go."""


class LatchedMessages:
    """The newest messages of latched topics, by publisher: those of one never push out another's, as on /tf_static.

    Of the same content from two publishers, such as a node and itself started again, the newer one stays.
    """

    def __init__(self) -> None:
        self._topics: dict[str, dict[bytes, deque[RingMessage]]] = {}
        self.size = 0

    def __iter__(self) -> Iterator[RingMessage]:
        """Yield all, oldest first."""
        found = (each for publishers in self._topics.values() for kept in publishers.values() for each in kept)
        return iter(sorted(found, key=attrgetter("at")))

    def add(self, message: RingMessage) -> None:
        """Keep a latched topic's message."""
        publishers = self._topics.setdefault(message.topic.topic, {})
        self._forget_same(publishers, message)
        kept = publishers.pop(message.publisher, None) or deque()
        publishers[message.publisher] = kept  # the newest publisher last
        kept.append(message)
        self.size += message.cost
        older = _OLDER if message.publisher else 16 * _OLDER
        while len(kept) > 1 and sum(each.cost for each in kept) - message.cost > older:
            self.size -= kept.popleft().cost
        if len(publishers) > _PUBLISHERS:
            self.size -= sum(each.cost for each in publishers.pop(next(iter(publishers))))
        while self.size > _SIZE and self.size > message.cost:
            self._shrink()

    def _forget_same(self, publishers: dict[bytes, deque[RingMessage]], message: RingMessage) -> None:
        for publisher, kept in [*publishers.items()]:
            for each in [each for each in kept if each.content == message.content]:
                kept.remove(each)
                self.size -= each.cost
            if not kept:
                del publishers[publisher]

    def _shrink(self) -> None:
        largest = max(self._topics.values(), key=lambda of: sum(each.cost for kept in of.values() for each in kept))
        publisher, kept = next(iter(largest.items()))
        self.size -= kept.popleft().cost
        if not kept:
            del largest[publisher]
