"""An operator's terminal for tests, and the line to it, which is a program of its own and may hang.

The line imports the standard library only, and a new process runs it. Before, it was forked from the process of the
tests: that has threads, and a fork of it may stand still before it runs the program, or end the tests' worker.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator, Mapping

_TAIL = 200_000
_READ_SIZE = 65_536
_LINES, _COLUMNS = 36, 120
_QUESTION = re.compile(rb"\x1b\[(\d+);(\d+)H\x1b\[6n")
_KIND = re.compile(rb"\x1b\[>0?c")


class Terminal:
    """An operator's terminal, which answers questions, at the end of a line that may hang.

    Args:
        command: what runs at the other end of the line.
        mute: whether it answers nothing.
        environ: variables of the command, besides the test's own.

    Attributes:
        output: the newest bytes that came.
    """

    def __init__(self, *command: str, mute: bool = False, environ: Mapping[str, str] = {}) -> None:
        inherited = {name: text for name, text in os.environ.items() if name not in ("TMUX", "STY", "ZELLIJ")}
        self._fd, its_end = os.openpty()
        try:
            self._line = subprocess.Popen(
                (sys.executable, __file__, *command),
                stdin=its_end,
                stdout=its_end,
                start_new_session=True,
                env=inherited | {"TERM": "xterm-256color", **environ},
            )
        finally:
            os.close(its_end)
        self.output = b""
        self._mute = mute
        self._delayed: list[bytes] | None = None
        self._unanswered = b""
        self._ended = threading.Event()
        self._reading = threading.Thread(target=self._read, name="terminal", daemon=True)
        self._reading.start()

    def type(self, keys: str) -> None:
        data = keys.encode()
        while data:
            data = data[os.write(self._fd, data[:256]) :]

    def type_late(self, keys: str, parts: int, apart: float) -> None:
        """Type keys that come late in parts, seconds apart. What the terminal answers meanwhile comes after them."""
        self._delayed = []
        for part in range(parts):
            time.sleep(apart if part else 0.0)
            self.type(keys[part * len(keys) // parts : (part + 1) * len(keys) // parts])
        delayed, self._delayed = self._delayed, None
        for answer in delayed:
            os.write(self._fd, answer)

    def shows(self, words: str, after: int = 0) -> bool:
        return words.encode() in self.output[after:]

    @contextlib.contextmanager
    def hung(self) -> Iterator[None]:
        """Stop the process that passes the bytes on, for the length of the block."""
        self._line.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._line.send_signal(signal.SIGCONT)

    def close(self) -> None:
        self._line.send_signal(signal.SIGHUP)
        self._line.send_signal(signal.SIGCONT)
        self._line.wait()
        self._ended.set()
        self._reading.join()
        os.close(self._fd)

    def state(self) -> str:
        """Return whether the line lives, and its newest output."""
        return f"the line has ended with {self._line.poll()}, its last output: {self.output[-2000:]!r}"

    def _read(self) -> None:
        while not self._ended.is_set():
            try:
                if not select.select([self._fd], [], [], 0.1)[0]:
                    continue
                data = os.read(self._fd, _READ_SIZE)
            except (OSError, ValueError):
                return
            self.output = (self.output + data)[-_TAIL:]
            self._answer(data)

    def _answer(self, data: bytes) -> None:
        """Answer DSR and DA2, as xterm does."""
        if self._mute:
            return
        data, self._unanswered = self._unanswered + data, b""
        found = [(each.end(), b"\x1b[%s;%sR" % each.groups()) for each in _QUESTION.finditer(data)]
        found += [(each.end(), b"\x1b[>41;390;0c") for each in _KIND.finditer(data)]
        for _, answer in sorted(found):
            if (delayed := self._delayed) is not None:
                delayed.append(answer)
            else:
                os.write(self._fd, answer)
        rest = data[max((end for end, _ in found), default=0) :]
        self._unanswered = rest[-24:]


def pass_on(command: list[str]) -> None:
    """Run a command in a pseudo-terminal, and pass bytes on in both directions, as sshd does."""
    pid, fd = pty.fork()
    if not pid:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", _LINES, _COLUMNS, 0, 0))
        os.execvp(command[0], command)
    tty.setraw(0)
    while True:
        for source in select.select([0, fd], [], [])[0]:
            try:
                data = os.read(source, _READ_SIZE)
            except OSError:
                data = b""
            if not data:
                os.kill(pid, signal.SIGHUP)
                return
            os.write(1 if source == fd else fd, data)


if __name__ == "__main__":
    pass_on(sys.argv[1:])
