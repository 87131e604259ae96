"""A real terminal under a real command: a pseudo-terminal that a test reads, stalls, resizes and hangs up."""

import fcntl
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Mapping
from pathlib import Path

from tests.support.forker import Forked
from tests.support.waiting import pauses

COMMAND = Path(sys.executable).with_name("rsb-console")
TAKE_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl({}, termios.TIOCSCTTY, 0); os.execvp(sys.argv[1], sys.argv[1:])"
)
"""The program of a process that makes a descriptor its controlling terminal (ioctl_tty(2)) and becomes a command."""


_LOOKS = re.compile(rb"\x1b\[[\d;]*m")
"""SGR (ECMA-48)."""


def _resize(terminal: int, columns: int, lines: int) -> None:
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))


class Terminal:
    """A command in a pseudo-terminal of its own.

    Args:
        forked: the command is a module and its arguments, for `tests.support.forker`.

    Attributes:
        output: all that it wrote so far.
    """

    def __init__(
        self, *command: str, size: tuple[int, int] = (120, 36), environ: Mapping[str, str] = {}, forked: bool = False
    ) -> None:
        self.started = time.monotonic()
        settings = {"TERM": "xterm-256color", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **environ}
        self.fd, line = os.openpty()
        _resize(line, *size)
        self._process: Forked | subprocess.Popen[bytes]
        if forked:
            self._process = Forked(*command, environ=settings, terminal=True, stdin=line, stdout=line, stderr=line)
        else:
            # Not pty.fork: this process has threads, and a fork of it may stand still before it runs the command.
            take = [sys.executable, "-c", TAKE_TERMINAL.format(0), *command]
            environment = os.environ | settings
            self._process = subprocess.Popen(
                take, stdin=line, stdout=line, stderr=line, start_new_session=True, env=environment
            )
        self.pid = self._process.pid
        os.close(line)
        self.output = b""
        self.status: int | None = None
        self.hung_up = False

    def resize(self, columns: int, lines: int) -> None:
        _resize(self.fd, columns, lines)

    def type(self, text: str | bytes) -> None:
        os.write(self.fd, text.encode() if isinstance(text, str) else text)

    def read(self, seconds: float, most: int = 65536) -> None:
        """Take what it writes, of some bytes at most."""
        ready, _, _ = select.select([self.fd], [], [], seconds)
        if ready:
            try:
                self.output += os.read(self.fd, most)
            except OSError:  # it has closed its end
                time.sleep(min(seconds, 0.05))

    def _read_all(self) -> None:
        """Read the rest: the line gives a few kilobytes at a time."""
        while select.select([self.fd], [], [], 0.05)[0]:
            try:
                part = os.read(self.fd, 65536)
            except OSError:  # it has closed its end
                return
            self.output += part

    def wait_for(self, words: str, seconds: float = 120.0, *, after: int = 0) -> None:
        """Read until `words` have been written, beyond the first `after` bytes, in any look if they name none."""
        deadline = time.monotonic() + seconds
        while words.encode() not in _LOOKS.sub(b"" if "\x1b" not in words else rb"\g<0>", self.output[after:]):
            assert time.monotonic() < deadline, f"no {words!r} within {seconds} s:\n{self.output[after:][-4000:]!r}"
            self.read(0.05)

    def hang_up(self) -> None:
        """Do what sshd does when the line drops."""
        os.close(self.fd)
        self.hung_up = True

    def kill(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    @property
    def threads(self) -> int:
        return len(list(Path(f"/proc/{self.pid}/task").iterdir()))

    @property
    def alive(self) -> bool:
        """Whether the command still runs."""
        self.status = self._process.poll()
        return self.status is None

    def exit_code(self, seconds: float = 120.0, *, read: bool = True) -> int:
        deadline, pause = time.monotonic() + seconds, pauses()
        while self.alive:
            assert time.monotonic() < deadline, f"still running after {seconds} s:\n{self.output[-400:]!r}"
            if read and not self.hung_up:
                self.read(0.05)
            else:
                time.sleep(next(pause))
        if read and not self.hung_up:
            self._read_all()
        assert self.status is not None
        return self.status

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self.alive:
            self.kill(signal.SIGTERM)
            deadline = time.monotonic() + 5
            while self.alive and time.monotonic() < deadline:
                if not self.hung_up:
                    self.read(0.02)
        if self.alive:
            self.kill(signal.SIGKILL)
            while self.alive:
                time.sleep(0.005)
        if not self.hung_up:
            os.close(self.fd)
