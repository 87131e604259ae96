"""What an endpoint sends: at once where that cannot take long, else on a thread.

Zenoh holds back whoever sends while its queue is full (`CongestionControl.BLOCK`), for up to 5 s, and the loop must not
wait. The queue of each priority has 16 batches of 64 kB; what was sent in the last 5 s at less than `AT_ONCE` bytes a
second fits it, even where the router takes nothing. Whatever is more than that is sent by a thread.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import asyncio

    import zenoh

    from rsb_bridge.transport.zenoh.endpoint import Header

AT_ONCE = 160 * 1024
"""Bytes of one priority in one second that are sent on the loop's thread."""
LINK_RANK = 0
"""Of streams that carry a link's own messages, before all routes."""
_OWN_COST = 200
"""Bytes that a sample takes beside its payload."""


class Outbox:
    """Sends samples in order.

    Ranks are those of `LINK_RANK` and, from 1 on, of `rsb_bridge.model.priority`, highest first.
    """

    def __init__(self, session: zenoh.Session, loop: asyncio.AbstractEventLoop) -> None:
        import zenoh as package  # noqa: PLC0415 (an extra)

        priority, control = package.Priority, package.CongestionControl
        self._priorities = (priority.INTERACTIVE_HIGH, priority.DATA_HIGH, priority.DATA, priority.DATA_LOW)
        self._block, self._drop = control.BLOCK, control.DROP
        self._closed_error = package.ZError
        self._session = session
        self._now = loop.time
        self._spent = [0] * len(self._priorities)
        self._second = 0.0
        self._queue: deque[tuple[str, bytes, bytes, Any]] = deque()
        self._filled = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    def put(self, key: str, payload: bytes | bytearray | memoryview[int], header: Header) -> None:
        """Send a sample of a stream; it is held back, and never dropped, while the network is congested."""
        rank = min(header.rank, len(self._priorities) - 1)
        size = len(payload) + _OWN_COST
        if not self._queue and self._has_room(rank, size):
            self._send(key, bytes(payload), header.pack(), self._priorities[rank])
            return
        with self._filled:
            self._queue.append((key, bytes(payload), header.pack(), self._priorities[rank]))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="zenoh-send", daemon=True)
                self._thread.start()
            self._filled.notify()

    def drop(self, key: str, payload: bytes) -> None:
        """Send a datagram, or lose it."""
        try:
            self._session.put(key, payload, congestion_control=self._drop)
        except self._closed_error:
            return

    def close(self) -> None:
        """Send no more; what waits is lost."""
        with self._filled:
            self._closed = True
            self._filled.notify()

    def _has_room(self, rank: int, size: int) -> bool:
        now = self._now()
        if now - self._second >= 1.0:
            self._second = now
            self._spent = [0] * len(self._priorities)
        self._spent[rank] += size
        return self._spent[rank] <= AT_ONCE

    def _run(self) -> None:
        while True:
            with self._filled:
                self._filled.wait_for(lambda: self._queue or self._closed)
                if self._closed:
                    return
            while self._queue and not self._closed:
                self._send(*self._queue[0])
                self._queue.popleft()  # not before: as long as it is there, whatever comes goes behind it

    def _send(self, key: str, payload: bytes, attachment: bytes, priority: Any) -> None:
        try:
            self._session.put(key, payload, attachment=attachment, congestion_control=self._block, priority=priority)
        except self._closed_error:
            return  # the network is closed: so is every stream
