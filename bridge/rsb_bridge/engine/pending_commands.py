"""Commands that other threads give to the I/O thread: each of their futures ends, whatever the engine does."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge.api import EngineError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

T = TypeVar("T")


class PendingCommands:
    """Runs commands on an event loop from `open` to `refuse`; `end` fails those that are still under way."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        """None: commands are refused."""
        self._futures: set[Future[object]] = set()
        """Whoever takes a future out gives it its result."""
        self._tasks: set[asyncio.Task[None]] = set()

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def run(self, work: Callable[[], Coroutine[None, None, T]]) -> Future[T]:
        """Run a command on the loop. May be called from any thread."""
        future: Future[T] = Future()
        with self._lock:
            if self._loop is None:
                return not_running()
            self._loop.call_soon_threadsafe(self._begin, self._loop, work, future)
            self._futures.add(future)  # type: ignore[arg-type]
        return future

    def refuse(self) -> None:
        """Take no more commands. May be called from any thread."""
        with self._lock:
            self._loop = None

    def end(self) -> None:
        """Take no more commands, and fail those under way. May be called from any thread; the loop cancels the rest."""
        with self._lock:
            self._loop = None
            left = tuple(self._futures)
        for future in left:
            self._failed(future, _error())

    def _begin(
        self, loop: asyncio.AbstractEventLoop, work: Callable[[], Coroutine[None, None, T]], future: Future[T]
    ) -> None:
        if future.cancelled():
            self._take(future)
        elif not future.done():
            task = loop.create_task(self._run(work, future))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            future.add_done_callback(lambda done: _cancel(task, loop) if done.cancelled() else None)

    async def _run(self, work: Callable[[], Coroutine[None, None, T]], future: Future[T]) -> None:
        # Given a turn later: what the command has begun goes first, so that whoever waits sees it.
        later = asyncio.get_running_loop().call_soon
        try:
            later(self._succeeded, future, await work())
        except asyncio.CancelledError:  # by whoever waits for the future, or by what ends with the engine
            later(self._failed, future, _error())
            raise
        except Exception as error:  # noqa: BLE001 — it is the future's
            later(self._failed, future, error)

    def _succeeded(self, future: Future[T], result: T) -> None:
        if self._take(future):
            future.set_result(result)

    def _failed(self, future: Future[T], error: Exception) -> None:
        if self._take(future):
            future.set_exception(error)

    def _take(self, future: Future[T]) -> bool:
        """Whether it is up to the caller to give the future its result."""
        with self._lock:
            if future not in self._futures:
                return False
            self._futures.remove(future)  # type: ignore[arg-type]
        return future.set_running_or_notify_cancel()


def not_running() -> Future[T]:
    """What a command gets that is refused."""
    failed: Future[T] = Future()
    failed.set_exception(_error())
    return failed


def _error() -> EngineError:
    return EngineError("the engine is not running")


def _cancel(task: asyncio.Task[None], loop: asyncio.AbstractEventLoop) -> None:
    with contextlib.suppress(RuntimeError):  # the loop is closed, and has ended its tasks
        loop.call_soon_threadsafe(task.cancel)
