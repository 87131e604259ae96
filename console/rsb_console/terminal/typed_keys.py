"""Keys that an operator types for a command in a shell, as far as they are young.

On a terminal, the terminal itself is asked, as the console does (`rsb_console.terminal.pulse`). It answers without a
newline, so standard input is read key by key meanwhile, and not echoed.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import termios
import time
import tty
from typing import TYPE_CHECKING, Any, Final, Self

from rsb_console.terminal.pulse import FRESH_FOR, Pulse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_READ_SIZE = 4096
_LOOKS, _LOOK_EVERY = 6, 0.05
"""Looks at the end for the terminal's last answer, which would go to the shell; and s between them: 0.3 s in all, as in
the console."""
_LONGEST_ANSWER = 16
"""Bytes, more than any answer has: a longer rest after an Escape is no answer that has come in part."""
_PIECES: Final = re.compile(rb"\x1b\[(?P<row>\d+);(?P<column>\d+)R|(?P<line>[\r\n])|(?P<end>\x04)")
_LOCAL_MODES = 3
"""The place of the local modes in `termios.tcgetattr`."""


class TypedKeys:
    """Lines on standard input, until its end. To be used as a context.

    Args:
        environ: the environment, which names some multiplexers.
    """

    def __init__(self, fd: int, environ: Mapping[str, str], clock: Callable[[], float] = time.monotonic) -> None:
        self._fd = fd
        self._clock = clock
        self._pulse = Pulse(environ, clock)
        self._modes: list[Any] | None = None
        self._terminal = -1
        self._begun = b""
        self._ended = False

    def __enter__(self) -> Self:
        if os.isatty(self._fd):
            with contextlib.suppress(OSError, termios.error):  # then its keys count, as if it gave no answers
                self._modes = termios.tcgetattr(self._fd)
                # A descriptor of its own: a terminal that hangs must not block the write, but O_NONBLOCK on standard
                # input would hold for the shell, too.
                self._terminal = os.open(os.ttyname(self._fd), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        return self

    def __exit__(self, *_exception: object) -> None:
        """Take the last answer, which the shell would take for keys, and give the terminal back as it was."""
        for _look in range(_LOOKS):
            if not self._pulse.waits or self._ended:
                break
            self._is_typed(_LOOK_EVERY)
        if self._modes is not None and self._is_in_foreground:
            with contextlib.suppress(termios.error):  # at once: a terminal that hangs takes no output
                termios.tcsetattr(self._fd, termios.TCSANOW, self._modes)
                termios.tcflush(self._fd, termios.TCIFLUSH)
        if self._terminal >= 0:
            os.close(self._terminal)

    def wait(self, seconds: float) -> bool:
        """Ask the terminal, and wait for a young line for at most some seconds; return whether one came."""
        self._ask()
        return self._is_typed(seconds)

    @property
    def _is_in_foreground(self) -> bool:
        """Whether this process may change the terminal: in the background it would be stopped."""
        try:
            return os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:
            return False

    def _ask(self) -> None:
        if self._terminal < 0 or not self._is_in_foreground:
            return
        with contextlib.suppress(OSError, termios.error):  # a terminal that takes nothing gives no answers
            if termios.tcgetattr(self._fd)[_LOCAL_MODES] & termios.ICANON:  # at first, and after Ctrl-Z
                tty.setcbreak(self._fd, termios.TCSANOW)
            if question := self._pulse.question():
                os.write(self._terminal, question.encode())

    def _is_typed(self, seconds: float) -> bool:
        """Whether a young line comes within some seconds."""
        if not select.select([] if self._ended else [self._fd], [], [], seconds)[0]:
            return False
        try:
            data = os.read(self._fd, _READ_SIZE)
        except OSError:  # the terminal is gone
            data = b""
        self._ended = not data
        return self._receive(data)

    def _receive(self, data: bytes) -> bool:
        """Take keys and answers, in their order; return whether there was a young line."""
        data, is_young, done = self._begun + data, False, 0
        for piece in _PIECES.finditer(data):
            if piece["row"] is not None:
                self._pulse.answered(int(piece["row"]), int(piece["column"]))
            elif piece["line"] is not None:
                # A pipe answers no questions, so its lines count.
                is_young |= self._terminal < 0 or self._clock() - self._pulse.heard_now < FRESH_FOR
            # Ctrl-D: without line editing, the kernel passes it on as a byte. In a pipe it is one of the data.
            elif self._terminal >= 0:
                self._ended = True
            done = piece.end()
        # Behind the last piece, so that a line after an arrow key does not count again with each further key.
        start = data.rfind(b"\x1b", done)
        is_cut = start >= 0 and len(data) - start < _LONGEST_ANSWER
        self._begun = data[start:] if is_cut else b""
        return is_young
