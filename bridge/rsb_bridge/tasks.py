"""Tasks whose failures are always reported, and long work in slices."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable

    from rsb_bridge.model.budgets import Backoff

SLICE = 20
"""Routes handled in one go: about 1 ms, which no message notices."""
NOT_TOO_EARLY = 0.001
"""s by which a timer is set later than a moment that it must not come before: its clock is another one, and the time
left could be too short for that to move."""

T = TypeVar("T")


async def in_slices(items: Iterable[T], work: Callable[[T], None]) -> None:
    """Do something with each item, letting the I/O loop do other work in between."""
    for index, item in enumerate(items, 1):
        work(item)
        if index % SLICE == 0:
            await asyncio.sleep(0)


class Tasks:
    """The tasks of one owner. An exception that ends one goes to the loop's exception handler, which logs it.

    Args:
        on_failure: called after a task has ended with an exception.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, on_failure: Callable[[], None]) -> None:
        self._loop = loop
        self._on_failure = on_failure
        # The loop refers to its tasks weakly only: without this, one may be collected while it waits.
        self._tasks: set[asyncio.Task[None]] = set()
        self._cancelled = False

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine that ends by itself. Cancelling its task is no failure."""
        task = self._add(work)
        task.add_done_callback(self._ended)
        return task

    def keep(self, make: Callable[[], Coroutine[None, None, None]], backoff: Backoff) -> None:
        """Run a coroutine that should never end; start it again, after a delay, whenever it does end."""
        if not self._cancelled:
            self._add(make()).add_done_callback(partial(self._ended_early, make, backoff))

    def cancel(self) -> None:
        """Cancel all tasks, and start none again."""
        self._cancelled = True
        for task in self._tasks:
            task.cancel()

    def _add(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self._report(task, error)

    def _ended_early(
        self, make: Callable[[], Coroutine[None, None, None]], backoff: Backoff, task: asyncio.Task[None]
    ) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None or not self._cancelled:
            self._report(task, error)
        self._loop.call_later(backoff.next(), self.keep, make, backoff)  # which does nothing once cancelled

    def _report(self, task: asyncio.Task[None], error: BaseException | None) -> None:
        what = "a task failed" if error else "a task ended that should go on"
        self._loop.call_exception_handler({"message": what, "exception": error, "task": task})
        self._on_failure()
