"""An event loop whose time jumps to the next timer, for code that waits for hours."""

from __future__ import annotations

import asyncio
import contextlib
import selectors
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar, TypeVarTuple

from rsb_bridge.model.clock import Clock

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
L = TypeVar("L", bound="VirtualLoop")


class VirtualLoop(asyncio.SelectorEventLoop):
    """Runs what is ready, and then moves its time to the next timer instead of waiting for it.

    Attributes:
        errors: what nobody caught, as given to the exception handler.
        in_thread: whether a function runs that would run in another thread.
        thread_takes: s until the loop hears of such a function's end.
    """

    def __init__(self) -> None:
        self._time = 0.0
        self.in_thread, self.thread_takes = False, 0.0
        self.errors: list[dict[str, Any]] = []
        super().__init__(_NeverWaits(self))
        self.set_exception_handler(lambda _, details: self.errors.append(details))

    def time(self) -> float:
        return self._time

    def run_in_executor(self, executor: Any, func: Callable[[*Ts], T], *args: *Ts) -> asyncio.Future[T]:
        """Call a function at once, and report its end at a later turn."""
        done: asyncio.Future[T] = self.create_future()
        self.in_thread = True
        try:
            end = partial(done.set_result, func(*args))
        except Exception as error:  # noqa: BLE001 -- the future's
            end = partial(done.set_exception, error)
        finally:
            self.in_thread = False
        if self.thread_takes:
            self.call_later(self.thread_takes, end)
        else:
            end()
        return done

    def jump(self, seconds: float) -> None:
        """Move time on; called by the selector."""
        self._time += seconds


class _NeverWaits(selectors.DefaultSelector):
    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if not ready:
            assert timeout is not None, "everything waits, and no timer will ever wake anything"
            self._loop.jump(timeout)
        return ready


class VirtualClock(Clock):
    """A wall clock that goes with a loop's time, and that a test may set.

    Attributes:
        epoch: s since 1970 at the loop's time 0.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self.epoch = 1.7e9
        self._loop = loop

    def time_ns(self) -> int:
        return int((self.epoch + self._loop.time()) * 1e9)

    def steady(self) -> float:
        return self._loop.time()


def set_clock(clock: Clock, seconds: float) -> None:
    """Set a context's wall clock forward, or back."""
    assert isinstance(clock, VirtualClock)
    clock.epoch += seconds


@contextlib.contextmanager
def virtual_loop() -> Iterator[VirtualLoop]:
    """A loop for the length of a `with`; its tasks are cancelled at the end."""
    with closed_in_the_end(VirtualLoop()) as loop:
        yield loop


@contextlib.contextmanager
def closed_in_the_end(loop: L) -> Iterator[L]:
    """Cancel a loop's tasks at the end of a `with`, and close it."""
    try:
        yield loop
    finally:
        tasks = asyncio.all_tasks(loop)
        for task in tasks:
            task.cancel()
        if tasks:
            loop.run_until_complete(asyncio.wait(tasks))
        loop.close()
