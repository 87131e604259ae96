"""A bound on what a player keeps for late joiners: a recording says itself how much that is, and may be anybody's."""

from __future__ import annotations

from collections import Counter, deque
from itertools import chain
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_extras.playing.played_topics import PlayedPublishers, PlayedTopic
    from rsb_extras.recording.reading.stored_message import StoredMessage

LATCHED_BYTES = 256 << 20
"""Of all latched publishers together. A round figure: fifty maps of 5 MB."""


_COUNTED = 100_000
"""Messages without room that are counted. A round figure."""
_NOTHING = memoryview(b"")


class _Held:
    """The messages that DDS keeps of a publisher.

    Attributes:
        sizes: of these messages.
        is_before: whether all of them were published before the last seek.
    """

    def __init__(self, played: PlayedTopic) -> None:
        self.played = played
        self.sizes: deque[int] = deque()
        self.is_before = False


class LatchedRoom:
    """Counts the bytes that DDS keeps of latched publishers.

    Attributes:
        left_out: number of messages that found no room, by topic; one that is played again counts once.
    """

    def __init__(self) -> None:
        self._left_out: set[tuple[str, int, int]] = set()
        """Topics, times and numbers of these messages."""
        self._held: dict[int, _Held] = {}
        """By the `id` of their publishers."""
        self._size = 0

    @property
    def left_out(self) -> Counter[str]:
        return Counter(topic for topic, _, _ in self._left_out)

    def _leave_out(self, message: StoredMessage) -> None:
        if len(self._left_out) < _COUNTED:
            self._left_out.add((message.channel.topic, message.time, message.number))

    def seek(self) -> None:
        """Note that playing goes on elsewhere: late joiners need what comes then, and no more what DDS keeps now."""
        for held in self._held.values():
            held.is_before = True

    def take(self, played: PlayedTopic, message: StoredMessage) -> bool:
        """Take a message's room, or return False if there is none.

        Publishers that have published nothing since the last seek make room first.

        Raises:
            RosError: one of them was not made anew.
        """
        if not played.kept:
            return True
        held = self._held.setdefault(id(played), _Held(played))
        while self._size + (more := self._growth(held, message)) > LATCHED_BYTES:
            before = next((each for each in self._held.values() if each.is_before and each.sizes), None)
            if before is None:
                self._leave_out(message)
                return False
            self._size -= sum(before.sizes)
            before.sizes.clear()
            before.played.renew()
        if len(held.sizes) == played.kept:
            held.sizes.popleft()
        held.sizes.append(len(message.content))
        held.is_before = False
        self._size += more
        return True

    def _growth(self, held: _Held, message: StoredMessage) -> int:
        oldest = held.sizes[0] if len(held.sizes) == held.played.kept else 0
        return len(message.content) - oldest

    def newest(self, messages: Iterable[StoredMessage], publishers: PlayedPublishers) -> list[StoredMessage]:
        """Return the messages that late joiners get after all of these, in their order, as far as there is room."""
        kept: dict[int, deque[StoredMessage]] = {}
        lost: dict[int, deque[StoredMessage]] = {}  # of those that late joiners would get
        size = 0
        for message in messages:
            if (played := publishers.of(message.channel)) is None or not played.kept:
                continue
            own, gone = kept.setdefault(id(played), deque()), lost.setdefault(id(played), deque())
            # A view would hold the whole chunk.
            own.append(message._replace(content=memoryview(bytes(message.content))))
            size += len(message.content)
            if len(own) > played.kept:
                size -= len(own.popleft().content)
            while size > LATCHED_BYTES and own:
                oldest = own.popleft()
                size -= len(oldest.content)
                gone.append(oldest._replace(content=_NOTHING))
            while gone and len(gone) + len(own) > played.kept:  # newer ones have taken its place anyway
                gone.popleft()
        for each in chain(*lost.values()):
            self._leave_out(each)
        return sorted((each for own in kept.values() for each in own), key=lambda each: each.time)
