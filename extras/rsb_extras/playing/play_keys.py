"""Keys at the terminal of a player, without a screen."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import time
import tty
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

KEYS = {
    b" ": "pause", b".": "step", b"q": "end", b"\x1b[C": "+5", b"\x1b[D": "-5", b"\x1b[A": "+60", b"\x1b[B": "-60",
    b"\x1bOC": "+5", b"\x1bOD": "-5", b"\x1bOA": "+60", b"\x1bOB": "-60",
}  # fmt: skip
"""What a key means, by what the terminal sends; a number is of seconds."""
_AT_ONCE = 1024  # bytes: more than a key that is held down sends in a turn


class PlayKeys:
    """Waits, and tells which keys were pressed meanwhile.

    Args:
        terminal: descriptor to read, or None if there is none.
    """

    def __init__(self, terminal: int | None) -> None:
        self._terminal = terminal

    def wait(self, seconds: float) -> list[str]:
        """Wait, at most so long, for keys, and return what they mean (`KEYS`)."""
        if self._terminal is None:
            if seconds > 0:
                time.sleep(seconds)
            return []
        if not select.select((self._terminal,), (), (), max(0.0, seconds))[0]:
            return []
        with contextlib.suppress(OSError):  # a terminal that is gone
            if typed := os.read(self._terminal, _AT_ONCE):
                return list(_meanings(typed))
        self._terminal = None
        return []


def _meanings(typed: bytes) -> Iterator[str]:
    while typed:
        key = next((each for each in KEYS if typed.startswith(each)), b"")
        if key:
            yield KEYS[key]
        typed = typed[len(key) or 1 :]


@contextlib.contextmanager
def play_keys() -> Iterator[PlayKeys]:
    """The keys of this terminal, if standard input and output are one; without echo until the end."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        yield PlayKeys(None)
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield PlayKeys(terminal)
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
