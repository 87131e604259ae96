"""Tasks whose failures are always reported, long work in slices, and blocking calls on threads of their own."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from functools import partial
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable

    from rsb_bridge.model.budgets import Backoff

SLICE = 0.001
"""s of a turn of the loop, after which work in slices leaves the rest to later turns: no message notices as much."""
MOST_AT_ONCE = 20
"""Items of a slice at most. In a simulation no time passes while work is done, but its slices have to end, too."""
NOT_TOO_EARLY = 0.001
"""s by which a timer is set later than a moment that it must not come before: its clock is another one, and the time
left could be too short for that to move."""

T = TypeVar("T")


def turn_began(loop: asyncio.AbstractEventLoop) -> float:
    """Return when the present turn of a loop began, on its clock; now if the loop does not note that."""
    began: float | None = getattr(loop, "turn_began", None)
    return loop.time() if began is None else began


async def cancel_others() -> None:
    """Cancel all other tasks of the running loop, and wait for their ends."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for each in others:
        each.cancel()
    await asyncio.gather(*others, return_exceptions=True)


async def in_slices(items: Iterable[T], work: Callable[[T], object], at_once: int = MOST_AT_ONCE) -> None:
    """Do something with each item, letting the I/O loop do other work in between.

    A slice ends `SLICE` after its turn has begun, whatever else the turn had to do: several works in slices at the same
    time share that. Each of them gets on by one item a turn at least.

    Args:
        at_once: items of a slice at most.
    """
    loop = asyncio.get_running_loop()
    began, done = turn_began(loop), 0
    for item in items:
        work(item)
        done += 1
        if done == at_once or loop.time() - began >= SLICE:
            await asyncio.sleep(0)
            began, done = turn_began(loop), 0


async def in_thread(name: str, work: Callable[[], T], within: float) -> T:
    """Make a blocking call on a thread that nobody joins; return its result.

    The event loop's own pool is joined when the process ends, and other work shares it: a call that does not return
    would hold up both.

    Args:
        work: the call; it continues after a timeout.

    Raises:
        TimeoutError: the call takes longer.
        Exception: raised by the call.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def settle(result: T | None, error: Exception | None) -> None:
        if done.done():  # given up meanwhile
            return
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(result)  # type: ignore[arg-type]  # it is one, as there is no error

    def run() -> None:
        result, error = None, None
        try:
            result = work()
        except Exception as raised:  # noqa: BLE001 (raised again where it is waited for)
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, result, error)

    threading.Thread(target=run, name=name, daemon=True).start()
    async with asyncio.timeout(within):
        return await done


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
