"""A bound on what a player keeps for late joiners: a recording says itself how much that is, and may be anybody's."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_extras.playing.played_topics import PlayedPublishers, PlayedTopic
    from rsb_extras.recording.reading.stored_message import StoredMessage

LATCHED_BYTES = 256 << 20
"""Of all latched publishers together. A round figure: fifty maps of 5 MB."""


class LatchedRoom:
    """Counts the bytes that DDS keeps of latched publishers.

    Attributes:
        left_out: number of messages that found no room, by topic.
    """

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._kept: dict[int, deque[int]] = {}
        """Sizes of the messages that DDS keeps, by the `id` of their publishers."""
        self._size = 0

    def has_room(self, played: PlayedTopic, message: StoredMessage) -> bool:
        """Whether a message may be published, which takes its room."""
        if not played.kept:
            return True
        sizes = self._kept.setdefault(id(played), deque())
        more = len(message.content) - (sizes[0] if len(sizes) == played.kept else 0)
        if self._size + more > LATCHED_BYTES:
            self.left_out[message.channel.topic] += 1
            return False
        if len(sizes) == played.kept:
            sizes.popleft()
        sizes.append(len(message.content))
        self._size += more
        return True

    def newest(self, messages: Iterable[StoredMessage], publishers: PlayedPublishers) -> list[StoredMessage]:
        """Return the messages that late joiners get after all of these, in their order, as far as there is room."""
        kept: dict[int, deque[StoredMessage]] = {}
        size = 0
        for message in messages:
            if (played := publishers.of(message.channel)) is None or not played.kept:
                continue
            own = kept.setdefault(id(played), deque())
            # A view would hold the whole chunk.
            own.append(message._replace(content=memoryview(bytes(message.content))))
            size += len(message.content)
            if len(own) > played.kept:
                size -= len(own.popleft().content)
            while size > LATCHED_BYTES and own:
                size -= len(own.popleft().content)
                self.left_out[message.channel.topic] += 1
        return sorted((each for own in kept.values() for each in own), key=lambda each: each.time)
