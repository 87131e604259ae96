"""The newest messages of all topics, in memory, within bounds of bytes and seconds."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from operator import attrgetter
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.feature_api import TopicSpec

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MESSAGE_COST = 256
"""Bytes that are counted with each message, for the objects around it: 241 by `tracemalloc`."""
_LATCHED_TOGETHER = 64 << 10
"""Bytes of one latched topic's older messages that stay with its newest one, as /tf_static has several publishers. A
round figure: a transform takes 200."""
_at = attrgetter("at")


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

    Of latched topics, the newest stays: a late joiner gets it after any time. It may still give way to bytes.

    Args:
        seconds: age of the oldest message.
        size: bytes of all messages together, with what Python needs for them.

    Attributes:
        held: bytes of all kept messages.
        left_out: number of messages that were larger than `size` alone.
    """

    def __init__(self, seconds: float, size: int) -> None:
        self.seconds = seconds
        self.size = size
        self.held = 0
        self.left_out = 0
        self._messages: deque[RingMessage] = deque()
        self._latched: dict[str, deque[RingMessage]] = {}

    def __len__(self) -> int:
        return len(self._messages) + sum(map(len, self._latched.values()))

    def add(self, message: RingMessage) -> None:
        cost = message.cost
        if cost > self.size:
            self.left_out += 1
            return
        self.held += cost
        self._messages.append(message)
        if message.topic.qos.latched:
            self._shorten(message.topic.topic, _LATCHED_TOGETHER - cost)
        self.trim(message.at)
        while self.held > self.size:
            if len(self._messages) > 1:
                self._evict()
            else:
                self._shorten(next(iter(self._latched)), 0)

    def trim(self, now: float) -> None:
        """Forget what is too old at `now` (s)."""
        oldest = now - self.seconds
        while self._messages and self._messages[0].at < oldest:
            self._evict()

    def copy(self, now: float) -> tuple[list[RingMessage], list[RingMessage]]:
        """Return the kept messages of latched topics that are older, and all others, oldest first."""
        self.trim(now)
        return [each for kept in self._latched.values() for each in kept], [*self._messages]

    def _evict(self) -> None:
        message = self._messages.popleft()
        if message.topic.qos.latched:
            self._latched.setdefault(message.topic.topic, deque()).append(message)
            self._shorten(message.topic.topic, _LATCHED_TOGETHER, least=1)
        else:
            self.held -= message.cost

    def _shorten(self, topic: str, most: int, *, least: int = 0) -> None:
        """Forget the oldest messages of a latched topic, until they have at most so many bytes, or are so few."""
        kept = self._latched.get(topic, ())
        size = sum(each.cost for each in kept)
        while len(kept) > least and size > most:
            cost = self._latched[topic].popleft().cost
            size -= cost
            self.held -= cost
        if not kept:
            self._latched.pop(topic, None)


def of_last(
    latched: Iterable[RingMessage], messages: Sequence[RingMessage], began: float
) -> tuple[list[RingMessage], Sequence[RingMessage]]:
    """Return the messages of latched topics that a late joiner had got at `began` (s), and all messages since.

    Args:
        latched: older than all others.
        messages: oldest first.
    """
    first = bisect_left(messages, began, key=lambda each: each.at)
    by_topic: dict[str, list[RingMessage]] = {}
    for each in sorted((*latched, *(each for each in messages[:first] if each.topic.qos.latched)), key=_at):
        by_topic.setdefault(each.topic.topic, []).append(each)
    return sorted((each for found in by_topic.values() for each in _newest(found)), key=_at), messages[first:]


def _newest(messages: Sequence[RingMessage]) -> Sequence[RingMessage]:
    """Return the newest message of a topic, and the ones before it as far as they are small."""
    size = 0
    for count, each in enumerate(reversed(messages)):
        size += each.cost
        if count and size > _LATCHED_TOGETHER:
            return messages[-count:]
    return messages
