"""Messages of a recording, read before they are due: to unpack a chunk takes some ms."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.recording.reading.stored_message import StoredMessage

_AT_ONCE, _BYTES_AT_ONCE = 64, 1 << 20
"""Messages and bytes that are handed over together. Round figures."""
_BYTES_AHEAD = 32 << 20  # A round figure: 1 s of six cameras
_MESSAGE_COST = 400  # bytes of a message's objects, by `sys.getsizeof`


class ReadAhead:
    """Reads messages on a thread of its own, up to some bytes ahead.

    Attributes:
        error: why there are no more messages, if not because of the end.
    """

    def __init__(self, messages: Iterator[StoredMessage]) -> None:
        self.error = ""
        self._batches: deque[tuple[int, list[StoredMessage]]] = deque()
        self._batch: list[StoredMessage] = []  # the newest is the next one
        self._ahead = 0
        self._has_all = self._is_closed = False
        self._changed = threading.Condition()
        thread = threading.Thread(target=self._read, args=(messages,), name="rsb-read-ahead", daemon=True)
        thread.start()

    def peek(self, wait: float) -> StoredMessage | None:
        """Return the next message, or None at the end, or if there is none within `wait` seconds."""
        if not self._batch:
            with self._changed:
                self._changed.wait_for(lambda: self._batches or self._has_all, wait)
                if not self._batches:
                    return None
                size, batch = self._batches.popleft()
                self._ahead -= size
                self._changed.notify_all()
            batch.reverse()
            self._batch = batch
        return self._batch[-1]

    def take(self) -> StoredMessage:
        """Return the message that `peek` has returned, once."""
        return self._batch.pop()

    @property
    def is_over(self) -> bool:
        """Whether all messages were taken."""
        with self._changed:
            return self._has_all and not self._batches and not self._batch

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def _read(self, messages: Iterator[StoredMessage]) -> None:
        batch: list[StoredMessage] = []
        size = 0
        try:
            for message in messages:
                batch.append(message)
                size += len(message.content) + _MESSAGE_COST
                if len(batch) >= _AT_ONCE or size >= _BYTES_AT_ONCE:
                    if not self._put(size, batch):
                        return
                    batch, size = [], 0
        except RecordingError as error:
            self.error = str(error)
        finally:
            if batch:
                self._put(size, batch)
            with self._changed:
                self._has_all = True
                self._changed.notify_all()

    def _put(self, size: int, batch: list[StoredMessage]) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._ahead < _BYTES_AHEAD or self._is_closed)
            if not self._is_closed:
                self._ahead += size
                self._batches.append((size, batch))
                self._changed.notify_all()
            return not self._is_closed
