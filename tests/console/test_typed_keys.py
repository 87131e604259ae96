"""Lines that an operator types for `rsb-console arm`: only young ones count, and the terminal is given back."""

from __future__ import annotations

import fcntl
import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator

import pytest
from tests.console.late_input_helpers import Time
from tests.support import surroundings

from rsb_console.terminal.pulse import ANSWERS_WITHIN, FRESH_FOR, WHO_ARE_YOU, TypedKeys


class Terminal:
    """A terminal whose line may hang: the test decides when it answers.

    The kernel carries bytes between the two ends in a thread of its own, so both directions are waited for.

    Attributes:
        here: the program's end.
        asks_kind: whether the newest question asks for its kind, too.
    """

    def __init__(self) -> None:
        self.asks_kind = False
        self._there, self.here = os.openpty()

    def questions(self) -> list[bytes]:
        """Wait for a question, and return the places of all that have come."""
        data = b""
        found: list[bytes] = []
        while not found:
            assert select.select([self._there], [], [], 30)[0], f"no question but {data!r}"
            data += os.read(self._there, 4096)
            found = re.findall(rb"\x1b\[(\d+;\d+)H\x1b\[6n\x1b8", data)
        self.asks_kind = WHO_ARE_YOU.encode() in data
        return found

    @property
    def is_silent(self) -> bool:
        return not select.select([self._there], [], [], 0.2)[0]

    def send(self, text: str) -> None:
        wanted, deadline = self._unread() + len(text), time.monotonic() + 30
        os.write(self._there, text.encode())
        while self._unread() < wanted:
            assert time.monotonic() < deadline, f"{text!r} does not arrive"
            time.sleep(0.001)

    def _unread(self) -> int:
        return int.from_bytes(fcntl.ioctl(self.here, termios.FIONREAD, bytes(4)), sys.byteorder)

    def answer(self, *places: bytes) -> None:
        for place in places:
            self.send(f"\x1b[{place.decode()}R")

    @property
    def is_plain(self) -> bool:
        """Whether it echoes, and passes on whole lines."""
        wanted = termios.ICANON | termios.ECHO
        return bool(termios.tcgetattr(self.here)[tty.LFLAG] & wanted == wanted)

    def close(self) -> None:
        os.close(self._there)
        os.close(self.here)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    made = Terminal()
    surroundings.set_foreground(monkeypatch, is_ours=True)  # it is not this process's terminal
    yield made
    made.close()


def test_a_line_counts_while_the_terminal_answers(terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        assert not keys.wait(0)
        terminal.answer(*terminal.questions())
        terminal.send("\n")
        assert keys.wait(1)
        terminal.answer(*terminal.questions())
        terminal.send("x")
        assert not keys.wait(1)
    assert terminal.is_plain


@pytest.mark.parametrize("typed", ["\n", "\n\n\n", "\r"])
def test_late_lines_of_hung_line_do_not_count(typed: str, terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        terminal.answer(*terminal.questions())
        keys.wait(1)
        asked = terminal.questions()
        clock.now += 8.0
        terminal.answer(*asked)
        terminal.send(typed)
        assert not keys.wait(1)
        terminal.answer(*terminal.questions())
        terminal.send("\n")
        assert keys.wait(1)


def test_an_answer_may_come_in_two_parts(terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        (place,) = terminal.questions()
        row, column = place.decode().split(";")
        terminal.send(f"\x1b[{row};")
        assert not keys.wait(1)
        terminal.send(f"{column}R\n")
        assert keys.wait(1)


def test_terminal_tells_its_kind_after_gap(terminal: Terminal) -> None:
    """Then with each answer, which is no line."""
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        terminal.answer(*terminal.questions())
        keys.wait(1)
        clock.now += 2 * FRESH_FOR  # no answer to the question that is open
        for typed, counts in (("", False), ("\n", True)):
            keys.wait(0)
            terminal.send("\x1b[>41;390;0c")
            terminal.answer(*terminal.questions())
            terminal.send(typed)
            assert keys.wait(1) is counts
        keys.wait(0)
        terminal.questions()
        assert terminal.asks_kind


def test_a_line_after_an_arrow_key_counts_once(terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        terminal.answer(*terminal.questions())
        terminal.send("\x1b[A\n")
        assert keys.wait(1)
        for key in ("x", "y"):
            terminal.answer(*terminal.questions())
            terminal.send(key)
            assert not keys.wait(1)


def test_a_terminal_that_never_answers_is_believed(terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        terminal.send("\n")
        assert not keys.wait(1)
        clock.now += ANSWERS_WITHIN + FRESH_FOR
        terminal.send("\n")
        assert keys.wait(1)


def test_in_the_background_the_terminal_is_left_alone(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.set_foreground(monkeypatch, is_ours=False)
    with TypedKeys(terminal.here, {}, Time()) as keys:
        assert not keys.wait(0)
        assert terminal.is_plain
        assert terminal.is_silent


def test_last_answer_is_not_left_to_shell(terminal: Terminal) -> None:
    clock = Time()
    with TypedKeys(terminal.here, {}, clock) as keys:
        keys.wait(0)
        terminal.answer(*terminal.questions())
        keys.wait(1)
        terminal.answer(*terminal.questions())
    assert not select.select([terminal.here], [], [], 0)[0]


def test_lines_of_a_pipe_count_until_its_end() -> None:
    here, there = os.pipe()
    with TypedKeys(here, {}, Time()) as keys:
        os.write(there, b"\n")
        assert keys.wait(1)
        os.close(there)
        assert not keys.wait(1)
        assert not keys.wait(0)
    os.close(here)
