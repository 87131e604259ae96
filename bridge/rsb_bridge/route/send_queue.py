"""Messages of one route that wait for its channel."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.wire.framing import Message


class QueueLimits(NamedTuple):
    """How much may wait. What is more is dropped, the oldest first; one message always may.

    Attributes:
        depth: messages of one publisher (of all, where publishers are not told apart); 0: any number.
        younger_than: s; younger messages may wait even beyond the depth.
        size: bytes.
    """

    depth: int
    younger_than: float
    size: int


class SendQueue:
    """A first-in, first-out queue that is bounded in messages and bytes. Every message passes through it."""

    def __init__(self) -> None:
        self._queue: deque[tuple[Message, bytes, float]] = deque()  # message, publisher, since when (s)
        self._size = 0
        self._counts: Counter[bytes] = Counter()  # of the publishers that are told apart

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def oldest_since(self) -> float | None:
        """When (s) the oldest message was added, or None if the queue is empty."""
        return self._queue[0][2] if self._queue else None

    def add(self, messages: Sequence[Message], now: float, publisher: bytes = b"") -> None:
        """Append messages of one publisher, at `now` (s)."""
        self._queue.extend([(message, publisher, now) for message in messages])
        self._size += sum([len(message[0]) for message in messages])
        if publisher:
            self._counts[publisher] += len(messages)

    def trim(self, limits: QueueLimits, now: float, publisher: bytes = b"") -> int:
        """Drop what is beyond the limits after messages of a publisher were added.

        Returns:
            How many messages were dropped.
        """
        before = len(self._queue)
        if limits.depth:
            while self._count(publisher) > limits.depth:
                index = self._oldest_of(publisher)
                if now - self._queue[index][2] < limits.younger_than:
                    break
                self._forget(*self._queue[index])
                del self._queue[index]
        while self._size > limits.size and len(self._queue) > 1:
            self._forget(*self._queue.popleft())
        return before - len(self._queue)

    def take(self, most: int, size: int) -> list[Message]:
        """Remove the oldest messages: at most `most`, and no further one once they have `size` bytes."""
        queue = self._queue
        taken: list[Message] = []
        taken_size = 0
        while queue and len(taken) < most and taken_size < size:
            message, publisher, _ = queue.popleft()
            taken.append(message)
            taken_size += len(message[0])
            if publisher:
                self._uncount(publisher)
        self._size -= taken_size
        return taken

    def clear(self) -> int:
        """Remove all messages; returns how many they were."""
        count = len(self._queue)
        self._queue.clear()
        self._size = 0
        self._counts.clear()
        return count

    def _count(self, publisher: bytes) -> int:
        return self._counts[publisher] if publisher else len(self._queue)

    def _oldest_of(self, publisher: bytes) -> int:
        if not publisher:
            return 0
        return next(index for index, waiting in enumerate(self._queue) if waiting[1] == publisher)

    def _forget(self, message: Message, publisher: bytes, _: float) -> None:
        self._size -= len(message[0])
        if publisher:
            self._uncount(publisher)

    def _uncount(self, publisher: bytes) -> None:
        self._counts[publisher] -= 1
        if not self._counts[publisher]:
            del self._counts[publisher]
