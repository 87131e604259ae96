"""The messages that late joiners get, with which each recording begins."""

from __future__ import annotations

from collections import OrderedDict
from operator import attrgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.recording.message_ring import RingMessage

_SIZE = 128 << 20  # A round figure
_OLDER = 64 << 10
"""Bytes of a publisher's older messages that stay with its newest one. A round figure; those that came over a link,
whose publishers nobody tells apart, have 16 times as much."""
_PUBLISHERS = 256
"""Publishers of a topic. A round figure: a node that starts again and again with other content has the oldest go."""


class _Kept:
    """Messages of one publisher by their content, oldest first."""

    def __init__(self) -> None:
        self.messages: OrderedDict[bytes, RingMessage] = OrderedDict()
        self.size = 0


class _Topic:
    """Messages of one topic, by publisher, of which the newest is last; and whose message has a content."""

    def __init__(self) -> None:
        self.publishers: OrderedDict[bytes, _Kept] = OrderedDict()
        self.publisher_of: dict[bytes, bytes] = {}
        self.size = 0


class LatchedMessages:
    """The newest messages of latched topics, by publisher: those of one never push out another's, as on /tf_static.

    Of the same content from two publishers, such as a node and itself started again, the newer one stays.

    Args:
        most: bytes of all, beyond which the topic with the most gives up its oldest message.

    Attributes:
        size: bytes of all.
    """

    def __init__(self, most: int = _SIZE) -> None:
        self._topics: dict[str, _Topic] = {}
        self._most = most
        self.size = 0

    def __len__(self) -> int:
        return sum(len(topic.publisher_of) for topic in self._topics.values())

    def __iter__(self) -> Iterator[RingMessage]:
        """Yield all, oldest first."""
        kept = (each for topic in self._topics.values() for each in topic.publishers.values())
        return iter(sorted((message for each in kept for message in each.messages.values()), key=attrgetter("at")))

    def add(self, message: RingMessage) -> None:
        """Keep a latched topic's message."""
        if (topic := self._topics.get(message.topic.topic)) is None:
            topic = self._topics[message.topic.topic] = _Topic()
        content, publisher, cost = message.content, message.publisher, message.cost
        if (known := topic.publisher_of.get(content)) is not None:
            self._forget(topic, known, content)
        if (kept := topic.publishers.get(publisher)) is None:
            kept = topic.publishers[publisher] = _Kept()
        topic.publishers.move_to_end(publisher)
        kept.messages[content] = message
        topic.publisher_of[content] = publisher
        for each in (self, topic, kept):
            each.size += cost
        older = _OLDER if publisher else 16 * _OLDER
        while len(kept.messages) > 1 and kept.size - cost > older:
            self._forget_oldest(topic, publisher)
        if len(topic.publishers) > _PUBLISHERS:
            oldest = next(iter(topic.publishers))
            while oldest in topic.publishers:
                self._forget_oldest(topic, oldest)
        while self.size > self._most and self.size > cost:
            self.give_way()

    def give_way(self) -> None:
        """Forget the oldest message of the topic that has the most bytes."""
        largest = max(self._topics.values(), key=attrgetter("size"))
        self._forget_oldest(largest, next(iter(largest.publishers)))

    def _forget_oldest(self, topic: _Topic, publisher: bytes) -> None:
        self._forget(topic, publisher, next(iter(topic.publishers[publisher].messages)))

    def _forget(self, topic: _Topic, publisher: bytes, content: bytes) -> None:
        kept = topic.publishers[publisher]
        cost = kept.messages.pop(content).cost
        del topic.publisher_of[content]
        for each in (self, topic, kept):
            each.size -= cost
        if not kept.messages:
            del topic.publishers[publisher]
