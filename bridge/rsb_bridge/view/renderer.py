"""Runs the process that draws, and ends it if it takes too long or nobody looks any more."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import subprocess
import sys
import time
from typing import IO, TYPE_CHECKING

from rsb_bridge.model.pictures import PICTURE_LIMIT, Picture, PictureError, Wish, decode_picture
from rsb_bridge.model.wording import Wording
from rsb_bridge.view.worker import Task, frame

if TYPE_CHECKING:
    from collections.abc import Callable

SECONDS = 3.0
"""Longest time for one picture, beyond the start of the process."""
START_SECONDS = 20.0
"""Longest time for the first picture of a process: a slow computer imports for seconds."""
IDLE_SECONDS = 10.0
"""The process ends this long after the last picture."""
_AT_ONCE = 1 << 16
_LENGTH_BYTES = 4


class NoPicture(Wording):
    """The reason why the process that draws gave no picture."""

    TOO_SLOW = "drawing this message took more than {seconds:g} s: the drawing process was ended"
    ENDED = "the drawing process ended (exit code {code})"
    NOT_STARTED = "the drawing process cannot be started: {error}"
    INVALID = "the drawing process answered nonsense: {error}"


class _StoppedError(Exception):
    """The process gave no answer; the message says why."""


class Renderer:
    """Draws pictures in a process of its own, one after the other.

    Args:
        now: s on a monotonic clock.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._process: subprocess.Popen[bytes] | None = None
        self._turn = asyncio.Lock()
        self._used_at = 0.0
        self._is_new = True
        self._views = 0

    def next_view(self) -> int:
        """Return a number for a new view."""
        self._views += 1
        return self._views

    async def draw(self, task: Task) -> Picture:
        """Draw a picture. If that fails, the picture has the problem."""
        async with self._turn:
            picture = await asyncio.to_thread(self._draw, task)
            self._used_at = self._now()
        return picture

    async def forget(self, view: int) -> None:
        """Have the process forget a view."""
        async with self._turn:
            if self._process is not None:
                await asyncio.to_thread(self._forget, self._process, view)

    def end_if_idle(self) -> None:
        """End the process if it has drawn nothing for a while. Call it once a second."""
        if self._process is not None and not self._turn.locked() and self._now() - self._used_at > IDLE_SECONDS:
            self._end()

    def close(self) -> None:
        """End the process."""
        self._end()

    @property
    def pid(self) -> int | None:
        """The process's id, or None if there is no process."""
        return None if self._process is None else self._process.pid

    def _draw(self, task: Task) -> Picture:
        try:
            return self._answer(task)
        except _StoppedError as error:
            self._end()
            return Picture(type_name=task.type_name, messages=task.seen, size=task.size, problem=str(error))

    def _forget(self, process: subprocess.Popen[bytes], view: int) -> None:
        with contextlib.suppress(_StoppedError):
            self._write(process, frame(Task(view, "", Wish(), ended=True)), time.monotonic() + SECONDS)

    def _answer(self, task: Task) -> Picture:
        process = self._process or self._start()
        deadline = time.monotonic() + (START_SECONDS if self._is_new else SECONDS)
        assert process.stdout is not None
        self._write(process, frame(task), deadline)
        length = int.from_bytes(self._read(process.stdout, _LENGTH_BYTES, deadline), "big")
        if length > PICTURE_LIMIT:
            raise _StoppedError(NoPicture.INVALID(error=f"{length:,} bytes"))
        try:
            picture = decode_picture(self._read(process.stdout, length, deadline))
        except PictureError as error:
            raise _StoppedError(NoPicture.INVALID(error=error)) from None
        self._is_new = False
        return picture

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "rsb_bridge.view.worker"]
        try:
            process = subprocess.Popen(  # noqa: S603 -- this program's own module
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            raise _StoppedError(NoPicture.NOT_STARTED(error=error)) from None
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)
        self._process, self._is_new = process, True
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
                raise _StoppedError(NoPicture.ENDED(code=process.wait())) from None

    def _read(self, stream: IO[bytes], length: int, deadline: float) -> bytes:
        parts: list[bytes] = []
        while length:
            self._wait(stream, select.POLLIN, deadline)
            part = os.read(stream.fileno(), min(length, _AT_ONCE))
            if not part:
                assert self._process is not None
                raise _StoppedError(NoPicture.ENDED(code=self._process.wait()))
            parts.append(part)
            length -= len(part)
        return b"".join(parts)

    def _wait(self, stream: IO[bytes], event: int, deadline: float) -> None:
        poll = select.poll()
        poll.register(stream, event)
        if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
            raise _StoppedError(NoPicture.TOO_SLOW(seconds=SECONDS))

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):  # unwritten bytes of a killed process's input
                    stream.close()
