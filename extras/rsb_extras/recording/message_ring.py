"""The newest messages of all topics, in memory, within bounds of bytes and seconds."""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections import deque
from itertools import chain
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.feature_api import TopicSpec
from rsb_extras.recording.latched_messages import LatchedMessages

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MESSAGE_COST = 256
"""Bytes that are counted with each message, for the objects around it: 241 by `tracemalloc`."""


class RingMessage(msgspec.Struct, frozen=True, gc=False):
    """A message in the ring.

    Attributes:
        at: s, when it was added.
        time: ns since the epoch, when it passed.
        published: ns since the epoch, when it was published, as far as known.
        number: among its publisher's messages, or 0 if unknown.
        publisher: its id in the middleware, or empty if it came over a link.
    """

    at: float
    topic: TopicSpec
    content: bytes
    time: int
    published: int
    number: int
    publisher: bytes = b""

    @property
    def cost(self) -> int:
        return len(self.content) + MESSAGE_COST


class MessageRing:
    """Keeps messages until they are too old or too many.

    Of a latched topic, each publisher's newest stays: a late joiner gets it after any time. It may still give way to
    bytes.

    Args:
        seconds: age of the oldest message.
        size: bytes of all messages together, with what Python needs for them.

    Attributes:
        left_out: number of messages that were larger than `size` alone.
    """

    def __init__(self, seconds: float, size: int) -> None:
        self.seconds = seconds
        self.size = size
        self.left_out = 0
        self._messages: deque[RingMessage] = deque()
        self._size = 0  # of `_messages`
        self._latched = LatchedMessages(size)

    def __len__(self) -> int:
        return len(self._messages) + len(self._latched)

    @property
    def held(self) -> int:
        """Bytes of all kept messages."""
        return self._size + self._latched.size

    def add(self, message: RingMessage) -> None:
        cost = message.cost
        if cost > self.size:
            self.left_out += 1
            return
        self._size += cost
        self._messages.append(message)
        self.trim(message.at)
        while self.held > self.size:
            if len(self._messages) > 1:
                self._evict()
            else:
                self._latched.give_way()

    def trim(self, now: float) -> None:
        """Forget what is too old at `now` (s)."""
        oldest = now - self.seconds
        while self._messages and self._messages[0].at < oldest:
            self._evict()

    def copy(self, now: float) -> tuple[list[RingMessage], list[RingMessage]]:
        """Return the kept messages of latched topics that are older, and all others, oldest first."""
        self.trim(now)
        return [*self._latched], [*self._messages]

    def _evict(self) -> None:
        message = self._messages.popleft()
        self._size -= message.cost
        if message.topic.qos.latched:
            self._latched.add(message)


def of_last(
    latched: Iterable[RingMessage], messages: Sequence[RingMessage], began: float
) -> tuple[list[RingMessage], Sequence[RingMessage]]:
    """Return the messages of latched topics that a late joiner had got at `began` (s), and all messages since.

    Args:
        latched: older than all others, oldest first.
        messages: oldest first.
    """
    first = bisect_left(messages, began, key=lambda each: each.at)
    newest = LatchedMessages(sys.maxsize)  # the ring has bounded them: what it has kept is not left out here
    for each in chain(latched, (each for each in messages[:first] if each.topic.qos.latched)):
        newest.add(each)
    return [*newest], messages[first:]
