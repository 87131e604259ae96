"""The I/O loop. While it waits, another thread may do a moment's work for it.

A message that the ROS thread has taken would otherwise wait until the loop's thread is awake, and on an idle core that
takes longer than to seal and send the message. So the loop has a turn, a lock that its thread holds while it runs
callbacks, and releases only while it waits for sockets and timers. A thread that gets the turn without waiting (a
visitor) is the I/O thread for as long as its work takes. So only one thread at a time touches the engine's state and
sockets, and only the loop's thread waits for the turn, so that nothing can deadlock.
"""

from __future__ import annotations

import asyncio
import math
import selectors
import threading
import time
from typing import TYPE_CHECKING, Any, TypeVarTuple

from rsb_bridge.python_internals.asyncio_internals import ObservedLoop, poll_of, reader_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextvars import Context

    from _typeshed import FileDescriptorLike

Ts = TypeVarTuple("Ts")


class IoLoop(ObservedLoop):
    """An event loop that can be visited. It runs on a thread that handles no signals, so never on the main one."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._waits = _Selector(self._turn)
        super().__init__(self._waits)
        self._waits.failed = self.call_exception_handler
        # The sockets registered from the start are for other threads, which wake the loop after adding callbacks.
        self._waits.leave_all_to_the_loop()

    def do_now(self, work: Callable[[], object]) -> bool:
        """Call `work` on this thread as if it were the loop's. From any thread.

        Its exceptions go to the loop's exception handler, as from a callback.

        Returns:
            Whether `work` was called. It is not called while the loop runs callbacks, has some to run, or does not run.
        """
        if self._waits.over or not self._turn.acquire(False):
            return False
        # The visiting thread may run a loop of its own.
        before = asyncio._get_running_loop()
        try:
            # A visitor overtakes no earlier callback, so that messages keep their order.
            if not self.waits:
                return False
            # What every event loop does around its callbacks: the work may ask which loop is running.
            asyncio._set_running_loop(self)
            self._waits.due = False
            try:
                work()
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:  # noqa: BLE001 — as every event loop does
                self.call_exception_handler({"message": f"exception in {work}", "exception": error})
            # The loop has begun a wait that knows nothing of this work's callbacks and timers.
            if self._waits.due:
                self.call_soon_threadsafe(_nothing)
        finally:
            asyncio._set_running_loop(before)
            self._turn.release()
        return True

    @property
    def turn_began(self) -> float:
        """When the loop's thread began its present turn, on the loop's clock (`rsb_bridge.tasks.in_slices`)."""
        return self._waits.ended_at

    time = staticmethod(time.monotonic)
    """As asyncio's, without a call in between: every message asks for it several times."""

    def run_forever(self) -> None:
        with self._turn:
            super().run_forever()

    def stop(self) -> None:
        self._waits.due = True
        super().stop()

    def call_soon(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        self._waits.due = True
        return super().call_soon(callback, *args, context=context)

    def call_at(
        self, when: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        self._waits.due = True
        return super().call_at(when, callback, *args, context=context)


class _Selector(selectors.EpollSelector):
    """Gives the turn away while it waits. Epoll also waits for sockets that a visitor registers meanwhile.

    Attributes:
        over: whether the wait is over, and the loop's thread wants the turn back before the next visitor.
        due: whether the loop has to run a callback or a timer, or to stop.
        ended_at: when the last wait has ended, on the loop's clock.
        failed: takes a reader's exception, as the loop's exception handler does.
    """

    failed: Callable[[dict[str, Any]], None]

    def __init__(self, turn: threading.Lock) -> None:
        super().__init__()
        self.over = False
        self.due = False
        self.ended_at = time.monotonic()
        self._turn = turn
        self._changes = 0
        self._readers: dict[int, Callable[[], object]] = {}  # of the descriptors that are waited for to read only
        self._poll = poll_of(self)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait. If only one socket is readable, read from it here, and wait on."""
        until = math.inf if timeout is None else time.monotonic() + timeout
        self.due = False
        # At 0, callbacks are ready. The turn is not given away then: a visitor would overtake them.
        while timeout is None or timeout > 0:
            changes = self._changes
            self._turn.release()
            try:
                # Two events show whether one socket alone is ready. Of several, asyncio asks for all below.
                found = self._poll(-1 if timeout is None else timeout, 2)
            finally:
                self.over = True
                self._turn.acquire()
                self.over = False
            # A visitor may have closed the socket, and a new socket may have its number.
            reader = self._readers.get(found[0][0]) if len(found) == 1 and changes == self._changes else None
            if reader is None:
                break
            self.ended_at = time.monotonic()
            try:
                reader()
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:  # noqa: BLE001 — as every event loop does
                self.failed({"message": f"exception in {reader}", "exception": error})
            if self.due:
                break
            if timeout is not None:
                # Else a socket that always has something to read would hold up timers.
                timeout = until - time.monotonic()
        found_now = super().select(0)
        self.ended_at = time.monotonic()
        return found_now

    def leave_all_to_the_loop(self) -> None:
        """Leave reading from all sockets that are registered by now to asyncio."""
        self._readers.clear()

    def register(self, fileobj: FileDescriptorLike, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._changed(super().register(fileobj, events, data))

    def unregister(self, fileobj: FileDescriptorLike) -> selectors.SelectorKey:
        key = super().unregister(fileobj)
        self._changes += 1
        self._readers.pop(key.fd, None)
        return key

    def modify(self, fileobj: FileDescriptorLike, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._changed(super().modify(fileobj, events, data))

    def _changed(self, key: selectors.SelectorKey) -> selectors.SelectorKey:
        self._changes += 1
        self._readers.pop(key.fd, None)
        # Of a socket that also waits to write, only asyncio finds out for which of the two it was woken.
        if key.events == selectors.EVENT_READ:
            self._readers[key.fd] = reader_of(key)
        return key


def _nothing() -> None:
    """Wake the loop."""
