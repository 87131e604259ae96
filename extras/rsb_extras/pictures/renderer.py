"""Runs the process that draws, and ends it if it takes too long or nobody looks any more."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import IO, TYPE_CHECKING

from rsb_bridge.feature_api import Wording, sanitize_text
from rsb_extras.pictures.confinement import hide_memory
from rsb_extras.pictures.picture import PICTURE_LIMIT, Picture, PictureError, Wish, decode_picture
from rsb_extras.pictures.worker import Task, frame

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.feature_api import Context

SECONDS = 3.0
"""Longest time for one picture, beyond the start of the process: 100,000 points take 15 ms (docs/picture-costs.md)."""
START_SECONDS = 20.0
"""Longest time for the first picture of a process: a slow computer imports for seconds."""
IDLE_SECONDS = 10.0
"""The process ends this long after the last picture. Another start costs the next view 0.3 to 0.5 s
(docs/picture-costs.md)."""
_SLOW = 0.1
"""s for a picture, from which on a view leaves time to the others: a round figure."""
_TO_OTHERS = 3.0
"""Times as long as a slow picture took, its view waits for the next one: so it has a quarter of the process."""
_AT_ONCE = 1 << 16
"""Bytes: a pipe holds no more by default."""
_LENGTH_BYTES = 4


class NoPicture(Wording):
    """The reason why the process that draws gave no picture."""

    INVALID = "the drawing process answered nonsense: {error}"
    CLOSED = "the session ends"


class _StoppedError(Exception):
    """The process gave no answer; the message says why."""


class Renderer:
    """Draws pictures in a process of its own, one after the other.

    One thread handles the process, so a picture that nobody waits for any more is still read to its end, and the next
    view gets its own.

    Attributes:
        starts: number of processes so far. A new process knows nothing of earlier messages.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._thread: ThreadPoolExecutor | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._drawing = 0
        self._used_at = 0.0
        self._is_new = True
        self._is_closed = False
        self._views = 0
        self._took: dict[int, float] = {}
        self.starts = 0

    def next_view(self) -> int:
        """Return a number for a new view."""
        self._views += 1
        return self._views

    async def draw(self, task: Task) -> Picture:
        """Draw a picture. If that fails, the picture has the problem."""
        if self._is_closed:
            return _problem_of(task, NoPicture.CLOSED())
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, thread_name_prefix="rsb-draw")
        self._drawing += 1
        try:
            picture, took = await asyncio.get_running_loop().run_in_executor(self._thread, self._draw, task)
            self._took[task.view] = took
            return picture
        finally:
            self._drawing -= 1
            self._used_at = self._now()

    def pause_after(self, view: int) -> float:
        """Return the seconds that a view has to wait after its picture, so that others have their turn."""
        took = self._took.get(view, 0.0)
        return _TO_OTHERS * took if took > _SLOW and len(self._took) > 1 else 0.0

    def forget(self, view: int) -> None:
        """Have the process forget a view."""
        self._took.pop(view, None)
        if self._thread is not None and not self._is_closed:
            self._thread.submit(self._forget, view)

    def end_if_idle(self) -> None:
        """End the process if it has drawn nothing for a while. Call it once a second."""
        if self._thread is None or self._process is None or self._drawing or self._is_closed:
            return
        if self._now() - self._used_at > IDLE_SECONDS:
            self._thread.submit(self._end)

    def close(self) -> None:
        """End the process for good, without waiting for it."""
        self._is_closed = True
        if self._thread is not None:
            if (process := self._process) is not None:
                process.kill()  # the thread may wait for its answer
            self._thread.submit(self._end)
            self._thread.shutdown(wait=False)
            self._thread = None

    @property
    def pid(self) -> int | None:
        """The process's id, or None if there is no process."""
        return None if (process := self._process) is None else process.pid

    # --- on the thread

    def _draw(self, task: Task) -> tuple[Picture, float]:
        """Return a picture, and how long it took (s) beyond the start of the process."""
        began, starts = time.monotonic(), self._process is None or self._is_new
        try:
            picture = self._answer(task)
        except _StoppedError as error:
            self._end()
            return _problem_of(task, str(error)), time.monotonic() - began
        # To start the process is no fault of the view, and must not have it wait.
        return picture, 0.0 if starts else time.monotonic() - began

    def _forget(self, view: int) -> None:
        if self._process is None:
            return
        try:
            self._write(self._process, frame(Task(view, "", Wish(), ended=True)), time.monotonic() + SECONDS)
        except _StoppedError:  # half a task may be written
            self._end()

    def _answer(self, task: Task) -> Picture:
        process = self._process or self._start()
        deadline = time.monotonic() + (START_SECONDS if self._is_new else SECONDS)
        self._write(process, frame(task), deadline)
        length = int.from_bytes(self._read(process, _LENGTH_BYTES, deadline), "big")
        if length > PICTURE_LIMIT:
            raise _StoppedError(NoPicture.INVALID(error=f"{length:,} bytes"))
        try:
            picture = decode_picture(self._read(process, length, deadline))
        except PictureError as error:
            raise _StoppedError(NoPicture.INVALID(error=error)) from None
        self._is_new = False
        return picture

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "rsb_extras.pictures.worker"]  # -P: no module of the working folder
        if self._is_closed:
            raise _StoppedError(NoPicture.CLOSED())
        hide_memory()
        try:
            process = subprocess.Popen(  # noqa: S603 -- this program's own module
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # a Ctrl-C in the terminal is for this program, which ends it
            )
        except OSError as error:
            raise _StoppedError(f"the drawing process cannot be started: {error}") from None
        assert process.stdin is not None
        # A process that hangs reads nothing: a write of a large message would never return.
        os.set_blocking(process.stdin.fileno(), False)
        self.starts += 1
        self._process, self._is_new = process, True
        if self._is_closed:  # `close` came before there was a process to kill
            raise _StoppedError(NoPicture.CLOSED())
        return process

    def _write(self, process: subprocess.Popen[bytes], message: bytes, deadline: float) -> None:
        assert process.stdin is not None
        data = memoryview(message)
        while data:
            self._wait(process.stdin, select.POLLOUT, deadline)
            try:
                data = data[os.write(process.stdin.fileno(), data[:_AT_ONCE]) :]
            except BlockingIOError:
                continue
            except OSError:
                raise _ended(process) from None

    def _read(self, process: subprocess.Popen[bytes], length: int, deadline: float) -> bytes:
        assert process.stdout is not None
        parts: list[bytes] = []
        while length:
            self._wait(process.stdout, select.POLLIN, deadline)
            part = os.read(process.stdout.fileno(), min(length, _AT_ONCE))
            if not part:
                raise _ended(process)
            parts.append(part)
            length -= len(part)
        return b"".join(parts)

    def _wait(self, stream: IO[bytes], event: int, deadline: float) -> None:
        poll = select.poll()
        poll.register(stream, event)
        if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
            raise _StoppedError(f"drawing this message took more than {SECONDS:g} s: the drawing process was ended")

    def _end(self) -> None:
        if (process := self._process) is None:
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):  # unwritten bytes of a killed process's input
                    stream.close()
        self._process = None


def renderer_of(context: Context) -> Renderer:
    """Return the renderer of an engine's views (`Context.shared`)."""
    return Renderer(context.now)


def _problem_of(task: Task, problem: str) -> Picture:
    name = sanitize_text(task.type_name, 255)
    return Picture(type_name=name, messages=task.seen, size=task.size, problem=sanitize_text(problem))


def _ended(process: subprocess.Popen[bytes]) -> _StoppedError:
    """Return the error of a process that has closed its input or output."""
    with contextlib.suppress(subprocess.TimeoutExpired):  # it is about to end, or hangs and is killed
        process.wait(1.0)
    return _StoppedError(f"the drawing process ended (exit code {process.returncode})")
