"""Log lines on a file descriptor that may be slow, full or gone; the program never waits for it."""

from __future__ import annotations

import os
import threading
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.text import one_line
from rsb_console.command.shell import encoded

if TYPE_CHECKING:
    from collections.abc import Callable

WAITING_LIMIT = 1 << 20
"""Bytes of lines that wait for a slow reader; a status line of 500 topics has 200 kB as JSON."""
_TOO_SLOW = "they were not read fast enough"


class LogWriter:
    """Writes lines on a thread of its own.

    Counts the lines that cannot be written; when too many wait, the oldest go. As soon as writing works again, one line
    says how many are missing and why.

    Args:
        fd: the file descriptor; stays open.
        lost_line: makes that line, given the number of lines and the reason.
    """

    def __init__(self, fd: int, lost_line: Callable[[int, str], str]) -> None:
        self._fd = fd
        self._lost_line = lost_line
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._lost = 0
        self._reason = ""
        self._torn = False
        self._closing = False
        self._changed = threading.Condition()
        # A daemon: a write that never returns must not hold up the interpreter's exit.
        self._thread = threading.Thread(target=self._run, name="log-writer", daemon=True)
        self._thread.start()

    def write(self, text: str) -> None:
        """Hand over a line; returns at once."""
        line = encoded(f"{one_line(text)}\n")
        with self._changed:
            self._waiting.append(line)
            self._waiting_bytes += len(line)
            while self._waiting_bytes > WAITING_LIMIT and len(self._waiting) > 1:
                self._waiting_bytes -= len(self._waiting.popleft())
                self._lost += 1
                self._reason = _TOO_SLOW
            self._changed.notify()

    def close(self, timeout: float) -> None:
        """Wait until all lines are written, for `timeout` s at the most."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                line = self._waiting.popleft()
                self._waiting_bytes -= len(line)
                lost, reason = self._lost, self._reason
            try:
                if lost:
                    self._write(encoded(f"{one_line(self._lost_line(lost, reason))}\n"))
                    with self._changed:
                        self._lost -= lost
                self._write(line)
            except OSError as error:
                with self._changed:
                    self._lost += 1
                    self._reason = error.strerror or str(error)

    def _write(self, line: bytes) -> None:
        if self._torn:  # what comes now must not continue a line of which only the beginning was written
            line = b"\n" + line
        written = 0
        try:
            while written < len(line):
                written += os.write(self._fd, line[written:])
        finally:
            self._torn = written < len(line) if written else self._torn
