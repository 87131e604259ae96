"""Messages on their way from the ROS thread to the I/O loop."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

_BACKLOG = 64
_PATIENCE = 0.1


T_contra = TypeVar("T_contra", contravariant=True)
T = TypeVar("T")


class Receiver(Protocol[T_contra]):
    """Where an endpoint's messages, requests or responses go on the I/O loop."""

    def offer(self, batch: Sequence[T_contra]) -> None:
        """Take them, oldest first."""
        ...


class RosToLoopQueue:
    """Messages on their way from the ROS thread to the I/O loop: no wake-up while the loop waits, else one a drain.

    Whoever has the loop's turn drains it, so messages keep their order whichever way they go. While the loop is
    `_BACKLOG` batches behind, the ROS thread waits; DDS keeps each topic's newest messages meanwhile.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, do_now: Callable[[Callable[[], object]], bool] | None = None
    ) -> None:
        """Begin.

        Args:
            loop: the I/O loop.
            do_now: does the loop's work on the thread that calls, or says that it cannot; None: the loop has none.
        """
        self._loop = loop
        self._do_now = do_now or _never
        self._batches: deque[tuple[Receiver[Any], Sequence[Any]]] = deque()
        self._room = threading.Event()
        self._scheduled = False

    def put(self, receiver: Receiver[T], batch: Sequence[T]) -> None:
        """Called on the ROS thread."""
        self._batches.append((receiver, batch))
        if self._do_now(self._drain):
            return
        if not self._scheduled:
            self._schedule()
        if len(self._batches) > _BACKLOG:
            self._room.clear()
            self._room.wait(_PATIENCE)

    def _drain(self) -> None:
        self._scheduled = False
        try:
            while self._batches:
                receiver, batch = self._batches.popleft()
                receiver.offer(batch)
        finally:
            self._room.set()
            if self._batches:  # a receiver has failed: the others' go on
                self._schedule()

    def _schedule(self) -> None:
        self._scheduled = True
        try:
            self._loop.call_soon_threadsafe(self._drain)
        except RuntimeError:  # the loop is closed: the engine has stopped
            self._batches.clear()


def _never(work: Callable[[], object]) -> bool:
    return False
