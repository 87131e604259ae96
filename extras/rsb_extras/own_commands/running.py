"""A command that runs: its output as far as it is kept, its end, and how to stop it."""

from __future__ import annotations

import atexit
import codecs
import contextlib
import os
import re
import select
import signal
import subprocess
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

from rsb_bridge.feature_api import one_line

if TYPE_CHECKING:
    from collections.abc import Callable

KEPT_LINES, LINE_LENGTH = 2000, 1000
"""The newest lines of the output that are kept, and characters of each: 2 MB at most, as much as an operator reads."""
_READ_SIZE, _READ_EVERY = 64 << 10, 0.05
"""Bytes at once, and s between two reads: a command that writes more waits, so that it costs the bridge no more than a
few % of a core."""
_LAST_READS = 4
"""Reads after the shell has ended: more than a pipe holds, but no end of what goes on in the background."""
_LOOK_EVERY = 0.1
"""s between two looks whether the shell has ended, which its output need not show: what it left in the background may
still hold the pipe."""
KILLED_AFTER = 3.0
"""s from SIGTERM to SIGKILL: a round figure, in which a program can put its files in order."""
_SEQUENCE: Final = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|[()][0-9A-Z]|[=>78])")
"""Sequences that only colour and move, which a pane leaves out."""


class Output:
    """The newest lines of what a command has written, safe for a terminal. One thread writes, others read.

    Attributes:
        dropped: number of lines that are not kept any more.
        changes: number of changes.
    """

    def __init__(self) -> None:
        self.dropped = self.changes = 0
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._rest = ""  # of a line whose end has not come
        self._decode = codecs.getincrementaldecoder("utf-8")("replace").decode
        self._lock = threading.Lock()

    def write(self, data: bytes) -> None:
        *lines, rest = (self._rest + self._decode(data)).split("\n")
        with self._lock:
            self.dropped += max(0, len(self._lines) + len(lines) - KEPT_LINES)
            self._lines.extend(map(_shown, lines))
            # What a line without an end has beyond its limit would be cut later anyway.
            self._rest = _last_state(rest)[: 2 * LINE_LENGTH] + "\r" * rest.endswith("\r")
            self.changes += 1

    @property
    def lines(self) -> list[str]:
        with self._lock:
            return [*self._lines, *([_shown(self._rest)] if self._rest else [])]


def _last_state(line: str) -> str:
    """Return what a carriage return has left of a line, as of a bar that shows progress."""
    return line.rstrip("\r").rpartition("\r")[2]


def _shown(line: str) -> str:
    text = one_line(_SEQUENCE.sub("", _last_state(line[: 64 * LINE_LENGTH])).expandtabs(8)[: LINE_LENGTH + 1])
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 1]}…"


class RunningCommand:
    """A line that ``/bin/sh`` runs, in a process group of its own, without a terminal.

    Args:
        ended: called once it has ended, on another thread.

    Attributes:
        code: its exit code, below 0 a signal's number, or None while it runs.
        pid: number of the shell's process, and of the group of all that it has started.
        is_shown: whether a pane shows it.
        seconds: for which it has run.
    """

    def __init__(self, line: str, ended: Callable[[RunningCommand], None]) -> None:
        self.line = line
        self.output = Output()
        self.code: int | None = None
        self.is_shown = False
        self._ended = ended
        self._began, self._took = time.monotonic(), 0.0
        self._stopped_at: float | None = None
        self._lock = threading.Lock()
        # A session of its own: without it, ssh would ask for a password on the console's terminal.
        self._process = subprocess.Popen(  # noqa: S603 -- the operator's own line; `OwnCommand.line` makes it
            ["/bin/sh", "-c", line],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        self.pid = self._process.pid
        threading.Thread(target=self._follow, name="own-command", daemon=True).start()

    @property
    def seconds(self) -> float:
        return self._took if self.code is not None else time.monotonic() - self._began

    @property
    def is_stopping(self) -> bool:
        return self.code is None and self._stopped_at is not None

    def stop(self) -> None:
        """Have the command and all its processes end: SIGTERM now, SIGKILL after `KILLED_AFTER`."""
        if self._stopped_at is None:
            self._stopped_at = time.monotonic()
            self._signal(signal.SIGTERM)

    def kill(self) -> None:
        self._signal(signal.SIGKILL)

    def _signal(self, number: int) -> None:
        # Until somebody waits for the process, no other one gets its number, which is the group's, too.
        with self._lock:
            if self._process.returncode is None:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.pid, number)

    def _follow(self) -> None:
        """Read the output until the shell ends."""
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            os.set_blocking(pipe.fileno(), False)
            is_open = True
            while not self._has_ended():
                if self._stopped_at is not None and time.monotonic() - self._stopped_at > KILLED_AFTER:
                    self.kill()
                if is_open and select.select([pipe], [], [], _LOOK_EVERY)[0]:
                    is_open = self._read(pipe.fileno())
                    time.sleep(_READ_EVERY)
                elif not is_open:
                    time.sleep(_LOOK_EVERY)
            for _ in range(_LAST_READS):
                if not (is_open and select.select([pipe], [], [], 0)[0] and self._read(pipe.fileno())):
                    break
        if self._stopped_at is not None:
            self.kill()  # what has not ended with its shell
        self._took = time.monotonic() - self._began
        with self._lock:
            self.code = self._process.wait()
        self._ended(self)

    def _read(self, pipe: int) -> bool:
        """Read a piece, and return whether there may be more."""
        try:
            data = os.read(pipe, _READ_SIZE)
        except OSError:
            return False
        self.output.write(data)
        return bool(data)

    def _has_ended(self) -> bool:
        """Whether the shell has ended, which keeps its number until somebody waits for it."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


class RunningCommands:
    """The commands that run, by their lines, and those that have ended and are still shown."""

    def __init__(self) -> None:
        self._running: dict[str, RunningCommand] = {}
        self._lock = threading.Lock()

    def find(self, line: str) -> RunningCommand | None:
        return self._running.get(line)

    def __len__(self) -> int:
        return len(self._running)

    def start(self, line: str, ended: Callable[[RunningCommand], None]) -> RunningCommand:
        """Run a line; raise OSError if that is impossible."""

        def has_ended(command: RunningCommand) -> None:
            with self._lock:
                self._running.pop(line, None)
            ended(command)

        with self._lock:
            command = self._running[line] = RunningCommand(line, has_ended)
        return command

    def end(self) -> None:
        """Stop all at the end of the process; without their console, nobody sees them."""
        left = [*self._running.values()]
        for command in left:
            command.stop()
        deadline = time.monotonic() + 1.0  # a round figure: the shell waits for it
        while any(command.code is None for command in left) and time.monotonic() < deadline:
            time.sleep(0.02)
        for command in left:
            command.kill()


RUNNING = RunningCommands()
"""Of all consoles of this process: that of a fleet makes one for each robot that it opens."""
atexit.register(RUNNING.end)
