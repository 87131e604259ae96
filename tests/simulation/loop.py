"""An event loop whose time jumps to the next timer.

Nothing in here waits, so a day costs as long as its callbacks run. Nothing in here is left to chance either: there is
no thread, no file descriptor and no clock of the machine's, callbacks run in the order in which they were asked for,
and two timers of the same moment in the order in which they were set. So what runs on this loop, and takes its random
numbers from a seed, runs the same way every time.

What code may ask of an event loop and this one does not simulate (subprocesses, signals, pipes, TLS) raises
`NotImplementedError` from `asyncio.AbstractEventLoop`: nothing escapes to the real world unseen. Sockets are the
network's business: the loop hands them on to `tests.simulation.sockets`.
"""

from __future__ import annotations

import asyncio
import contextvars
import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from random import Random
from typing import Any, Protocol, TypeVar, TypeVarTuple, cast

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_SWEEP_FROM = 512
"""Cancelled timers that are left in the heap until they would be due; from so many on they are swept out."""
_MOST_AT_ONCE = 1_000_000
_EXECUTOR = (0.0001, 0.002)
"""s, between which what an executor is asked for takes."""


class Deadlock(Exception):  # noqa: N818 — it says how things are
    """Everything waits, and no timer will ever wake anything."""


class Livelock(Exception):  # noqa: N818 — it says how things are
    """Something runs again and again, and time does not go on."""


class Program(Protocol):
    """The loop's view of a running program (`tests.simulation.machine.Process`)."""

    alive: bool

    def add_task(self, task: asyncio.Task[Any]) -> None: ...


PROGRAM: contextvars.ContextVar[Program] = contextvars.ContextVar("program")
"""The program of the running callback. Tasks and timers inherit it from their maker."""


class Timer(asyncio.TimerHandle):
    """A callback that is due at some time, or with a time of 0 as soon as those before it have run.

    asyncio's own handles do the same at three times the cost: they look for a debug mode first.
    """

    __slots__ = ("args", "callback", "context", "scheduled")

    def __init__(
        self,
        loop: SimulatedLoop,
        when: float,
        callback: Callable[..., object],
        args: tuple[Any, ...],
        context: contextvars.Context | None,
    ) -> None:
        self._loop = loop
        self._when = when
        self._cancelled = False
        self.scheduled = when > 0.0
        self.callback = callback
        self.args = args
        self.context = contextvars.copy_context() if context is None else context

    def __repr__(self) -> str:
        return f"<Timer {self._when:.6f} {self.callback}>"

    def cancel(self) -> None:
        if not self._cancelled:
            self._cancelled = True
            self.callback, self.args = _nothing, ()
            if self.scheduled:
                self._loop.timer_cancelled()

    def cancelled(self) -> bool:
        return self._cancelled

    def when(self) -> float:
        return self._when

    def program(self) -> Program | None:
        return self.context.get(PROGRAM)


class SimulatedLoop(asyncio.AbstractEventLoop):
    """Runs callbacks at once, and timers as soon as no callback waits.

    Attributes:
        on_error: called with what asyncio tells an exception handler: an exception that nobody caught. By default the
            loop stops and raises it.
    """

    def __init__(self, random: Random) -> None:
        self.on_error: Callable[[dict[str, Any]], None] = self._fail
        self.callbacks = 0
        self._random = random
        self._now = 0.0
        self._ready: deque[Timer] = deque()
        self._timers: list[tuple[float, int, Timer]] = []
        self._numbers = itertools.count()
        self._cancelled_timers = 0
        self._closed = False
        self._running = False
        self._stopping = False
        self._failure: BaseException | None = None
        self._frozen: dict[Program | None, list[Timer]] = {}

    # --- time

    def time(self) -> float:
        return self._now

    def call_soon(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: contextvars.Context | None = None
    ) -> Timer:
        handle = Timer(self, 0.0, callback, args, context)
        self._ready.append(handle)
        return handle

    def call_later(
        self, delay: float, callback: Callable[[*Ts], object], *args: *Ts, context: contextvars.Context | None = None
    ) -> Timer:
        when = self._now + delay
        if when == self._now and delay > 0.0:  # less than a float can tell: but time goes on
            when = math.nextafter(when, math.inf)
        return self.call_at(when, callback, *args, context=context)

    def call_at(
        self, when: float, callback: Callable[[*Ts], object], *args: *Ts, context: contextvars.Context | None = None
    ) -> Timer:
        handle = Timer(self, max(when, self._now) or 1e-9, callback, args, context)
        heapq.heappush(self._timers, (handle.when(), next(self._numbers), handle))
        return handle

    def timer_cancelled(self) -> None:
        """Note that a timer was cancelled; when they have become most of the heap, they are swept out."""
        self._cancelled_timers += 1
        if self._cancelled_timers > max(_SWEEP_FROM, len(self._timers) // 2):
            self._timers = [entry for entry in self._timers if not entry[2].cancelled()]
            heapq.heapify(self._timers)
            self._cancelled_timers = 0

    def timers(self) -> list[Timer]:
        return [handle for _, _, handle in self._timers if not handle.cancelled()]

    # --- running

    def run_until_complete(self, future: Any) -> Any:
        """Run until a future is done, and give its result.

        Raises:
            Deadlock: it never will be.
        """
        task: asyncio.Future[Any] = asyncio.ensure_future(future, loop=self)

        def stop(_: object) -> None:
            self.stop()

        task.add_done_callback(stop)
        try:
            self.run_forever()
        finally:
            task.remove_done_callback(stop)
        if not task.done():
            raise Deadlock("the loop was stopped")
        return task.result()

    def run_forever(self) -> None:
        self._running = True
        self._stopping = False
        before = asyncio._get_running_loop()
        asyncio._set_running_loop(self)
        try:
            self._run()
        finally:
            asyncio._set_running_loop(before)
            self._running = False
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def _run(self) -> None:
        ready = self._ready
        moment = self.callbacks  # when time last went on
        while not self._stopping:
            if ready:
                handle = ready.popleft()
            elif self._timers:
                when, _, handle = heapq.heappop(self._timers)
                if handle.cancelled():
                    self._cancelled_timers -= 1
                    continue
                handle.scheduled = False
                if when > self._now:
                    self._now = when
                    moment = self.callbacks
            else:
                raise Deadlock(f"at {self._now:.3f} s everything waits for ever")
            if self._frozen and (held := self._frozen.get(handle.program())) is not None:
                held.append(handle)
                continue
            self.callbacks += 1
            if self.callbacks - moment > _MOST_AT_ONCE:
                raise Livelock(f"{_MOST_AT_ONCE:,} callbacks have run at {self._now:.3f} s, and now comes {handle}")
            try:
                handle.context.run(handle.callback, *handle.args)
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:  # noqa: BLE001 — as every event loop does
                details = {"message": f"exception in {handle.callback}", "exception": error}
                handle.context.run(self.call_exception_handler, details)

    def freeze(self, program: Program) -> None:
        self._frozen.setdefault(program, [])

    def is_frozen(self, program: Program) -> bool:
        return program in self._frozen

    def thaw(self, program: Program, *, reads_first: bool) -> None:
        """Have all of it run that was due meanwhile.

        Args:
            reads_first: whether what has come runs before the timers that are overdue.
        """
        held = self._frozen.pop(program, [])
        if reads_first:
            held.sort(key=lambda handle: handle.when() > 0.0)
        self._ready.extendleft(reversed(held))

    def stop(self) -> None:
        self._stopping = True

    def is_running(self) -> bool:
        return self._running

    def is_closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        self._closed = True
        self._ready.clear()
        self._timers.clear()

    def get_debug(self) -> bool:
        return False

    async def shutdown_asyncgens(self) -> None:
        """Do nothing: the engine has no asynchronous generators."""

    async def shutdown_default_executor(self) -> None:
        """Do nothing: it has no executor."""

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        program = PROGRAM.get(None)
        if program is None or program.alive:  # a killed process tells nobody that its tasks have ended
            self.on_error(context)

    def fail(self, error: BaseException) -> None:
        """Stop, and raise an exception in the caller of `run_until_complete`."""
        if self._failure is None:
            self._failure = error
        self.stop()

    def _fail(self, details: dict[str, Any]) -> None:
        self.fail(details.get("exception") or RuntimeError(details.get("message")))

    # --- tasks, and what would be threads

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self)

    def create_task(
        self,
        coro: Generator[Any, None, T] | Coroutine[Any, Any, T],
        *,
        name: str | None = None,
        context: contextvars.Context | None = None,
        **options: Any,
    ) -> asyncio.Task[T]:
        # Their types differ from Python to Python: tasks take fewer kinds than loops, and newer ones more options.
        task = asyncio.Task(cast("Coroutine[Any, Any, T]", coro), loop=self, name=name, context=context, **options)
        program = PROGRAM.get(None) if context is None else context.get(PROGRAM)
        if program is not None:
            program.add_task(task)
        return task

    def call_soon_threadsafe(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: contextvars.Context | None = None
    ) -> Timer:
        return self.call_soon(callback, *args, context=context)

    def run_in_executor(self, executor: Any, func: Callable[[*Ts], T], *args: *Ts) -> asyncio.Future[T]:
        """Run a function in one go, a moment from now; `asyncio.to_thread` comes here."""
        future: asyncio.Future[T] = self.create_future()

        def run() -> None:
            if future.cancelled():
                return
            try:
                future.set_result(func(*args))
            except Exception as error:  # noqa: BLE001 — it is for the waiter
                future.set_exception(error)

        self.call_later(self._random.uniform(*_EXECUTOR), run)
        return future

    # --- sockets

    async def sock_connect(self, sock: Any, address: Any) -> None:
        await sock.connect_stream(address)

    async def create_connection(
        self, protocol_factory: Callable[[], Any], host: Any = None, port: Any = None, *, sock: Any = None, **_: Any
    ) -> tuple[Any, Any]:
        """Attach a protocol to a connected socket; `connection_made` has been called on return."""
        protocol = protocol_factory()
        transport = sock.attach(protocol)
        await asyncio.sleep(0)
        return transport, protocol

    async def connect_accepted_socket(
        self, protocol_factory: Callable[[], Any], sock: Any, **_: Any
    ) -> tuple[Any, Any]:
        return await self.create_connection(protocol_factory, sock=sock)

    def add_reader(self, fd: Any, callback: Callable[[*Ts], Any], *args: *Ts) -> None:
        fd.when_readable(lambda: callback(*args))

    def remove_reader(self, fd: Any) -> bool:
        fd.when_readable(None)
        return True

    def add_writer(self, fd: Any, callback: Callable[[*Ts], Any], *args: *Ts) -> None:
        """A simulated socket takes every datagram, so nobody should ever wait for that."""
        raise NotImplementedError

    def remove_writer(self, fd: Any) -> bool:
        return False


def _nothing() -> None:
    """Do nothing, in place of a cancelled callback."""
