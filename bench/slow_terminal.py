"""A terminal behind a line of so many bytes a second: a pseudo-terminal, a reader that waits, and an emulator.

The reader takes no more than the line carries, so that the program's writes wait, as they do at a serial port or at an
SSH connection whose window is full. What has passed goes to `pyte`, whose screen is what the operator sees.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import re
import select
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pyte
from tests.console.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Shows = Callable[[Sequence[str]], bool]

NEVER = float("inf")
_TICK = 0.005
"""s between two reads of a limited line."""
_SAVED = 0.1
"""s of the line that a reader without a processor makes up for, while something waits: a line at rest saves nothing."""
_REPEATS_AFTER, _REPEATS_EVERY = 0.4, 0.033
"""s of a key that is held, as usual keyboards send it."""
_CURSOR_MODE = 1 << 5
"""DECCKM, as pyte notes private modes."""
_PIECE = re.compile(
    rb"\x1b\[[0-?]*[ -/]*[@-~]"
    rb"|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)"
    rb"|\x1b[P_X^](?:[^\x1b]|\x1b(?!\\))*\x1b\\"
    rb"|\x1b(?![\[\]P_X^])[ -/]*[0-~]"
    rb"|[^\x1b]+"
)
_SKIPPED = (b"\x1b]", b"\x1bP", b"\x1b_", b"\x1bX", b"\x1b^", b"\x1b[<", b"\x1b[=", b"\x1b[>")
"""Beginnings of what pyte would show as text: strings, and the private sequences that it does not know."""


@dataclass(frozen=True)
class Kind:
    """A kind of terminal by its environment, and its answers by the questions; a mute one has none."""

    term: str
    answers: Mapping[bytes, bytes]

    @property
    def is_mute(self) -> bool:
        return not self.answers


def _kind(name: bytes, kind: bytes, device: bytes = b"62", **more: bytes) -> dict[bytes, bytes]:
    return {
        b"\x1b[>c": b"\x1b[>%bc" % kind,
        b"\x1b[c": b"\x1b[?%bc" % device,
        b"\x1b[>q": b"\x1bP>|%b\x1b\\" % name,
        b"\x1b]11;?\x07": b"\x1b]11;rgb:1212/1212/1212\x1b\\",
        b"\x1b]4;200;?\x07": b"\x1b]4;200;rgb:ffff/0000/d7d7\x1b\\",
        b"\x1b[16t": b"\x1b[6;20;10t",
        **{key.encode(): value for key, value in more.items()},
    }


_TRUE = {b"\x1bP$qm\x1b\\": b"\x1bP1$r0;48:2:1:2:3m\x1b\\"}
_KITTY = _kind(b"kitty(0.35.2)", b"1;4000;35")
_GRAPHICS = {b"\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\": b"\x1b_Gi=31;OK\x1b\\"}
KINDS = {
    "24bit": Kind("xterm-256color", _KITTY | _TRUE),
    "256": Kind("xterm-256color", _kind(b"XTerm(379)", b"41;379;0", b"64;1")),
    "vt220": Kind("vt220", {}),
    "kitty": Kind("xterm-kitty", _KITTY | _TRUE | _GRAPHICS),
    "sixel": Kind("xterm-256color", _kind(b"XTerm(379)", b"41;379;0", b"64;1;4") | _TRUE),
}
"""The terminals, after those whose answers they give: kitty without and with its graphics, xterm without and with
sixel, and a VT220 behind a line that brings no answers."""


class NotShownError(SystemExit):
    """The screen does not show in time what is expected of it; the message has the screen."""


class SlowTerminal:
    """A program in a terminal whose line has a rate. A context manager.

    Attributes:
        rate: bytes/s that the line carries to the terminal, or None for no limit; may be set at any time.
        received: bytes that it has carried.
    """

    def __init__(
        self, command: Sequence[str], kind: Kind, environ: Mapping[str, str], size: tuple[int, int] = (80, 24)
    ) -> None:
        self.rate: float | None = None
        self.received = 0
        self._kind = kind
        self._screen = pyte.Screen(*size)
        self._emulator = pyte.Stream(self._screen)
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._begun = b""
        self._lock = threading.Lock()
        self._awaited: list[Shows] = []
        self._came = threading.Event()
        self._came_at: list[float] = []
        self._stopping = threading.Event()
        self._terminal = Terminal(*command, size=size, environ={"COLORTERM": "", "TERM": kind.term, **environ})
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> SlowTerminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.rate = None
        self._stopping.set()
        self._reader.join()
        self._terminal.__exit__()

    @property
    def lines(self) -> list[str]:
        """The lines that the terminal shows."""
        with self._lock:
            return list(self._screen.display)

    @property
    def down(self) -> str:
        """The cursor key, as the program has asked for it."""
        return "\x1bOB" if _CURSOR_MODE in self._screen.mode else "\x1b[B"

    def type(self, keys: str) -> None:
        self._terminal.type(keys)

    def key_to_screen(self, key: str, shows: Sequence[Shows], within: float, *, held: bool = False) -> list[float]:
        """Press a key, or hold it, and return the s until the screen behind the line shows each thing, or `NEVER`."""
        self._await(*shows)
        began, repeat = time.monotonic(), _REPEATS_AFTER
        self.type(key)
        while not self._came.wait(repeat if held else within):
            if time.monotonic() - began > within:
                break
            if held:
                self.type(key)
                repeat = _REPEATS_EVERY
        with self._lock:
            self._awaited = []
            return [each - began for each in self._came_at]

    def until(self, shows: Shows, within: float = 60.0) -> None:
        """Wait until the screen shows something.

        Raises:
            NotShownError: it does not.
        """
        if not self.shows(shows, within):
            shown = "\n".join(self.lines)
            raise NotShownError(f"the program in the terminal does not show what is expected of it:\n{shown}")

    def shows(self, shows: Shows, within: float) -> bool:
        """Return whether the screen shows something, or comes to show it in time."""
        self._await(shows)
        return self._came.wait(within)

    def _await(self, *shows: Shows) -> None:
        with self._lock:
            self._awaited, self._came_at = [*shows], [NEVER] * len(shows)
            self._came.clear()
            self._look()

    def _look(self) -> None:
        if not self._awaited:
            return
        lines = self._screen.display
        for number, shows in enumerate(self._awaited):
            if self._came_at[number] == NEVER and shows(lines):
                self._came_at[number] = time.monotonic()
        if NEVER not in self._came_at:
            self._awaited = []
            self._came.set()

    def _read(self) -> None:
        budget, before = 0.0, time.monotonic()
        while not self._stopping.is_set():
            now, rate = time.monotonic(), self.rate
            if rate is None:
                budget = 65536.0
            else:
                time.sleep(_TICK)
                budget = min(budget + rate * (now - before), max(1.0, rate * _SAVED))
            before = now
            if budget < 1:
                continue
            if not select.select([self._terminal.fd], [], [], _TICK)[0]:
                budget, before = 0.0, time.monotonic()
                continue
            with contextlib.suppress(OSError):  # the program has closed its end
                data = os.read(self._terminal.fd, int(budget))
                budget -= len(data)
                self._take(data)

    def _take(self, data: bytes) -> None:
        with self._lock:
            self.received += len(data)
            whole, data = 0, self._begun + data
            for piece in _PIECE.finditer(data):
                if piece.start() != whole:  # an Escape whose sequence has not come whole
                    break
                whole = piece.end()
                self._show(piece[0])
            self._begun = data[whole:]
            self._look()

    def _show(self, piece: bytes) -> None:
        if (answer := self._kind.answers.get(piece)) is not None:
            self._terminal.type(answer)
        elif piece == b"\x1b[6n":
            if not self._kind.is_mute:
                cursor = self._screen.cursor
                self._terminal.type(f"\x1b[{cursor.y + 1};{cursor.x + 1}R")
        elif not piece.startswith(_SKIPPED):
            self._emulator.feed(self._decoder.decode(piece))
