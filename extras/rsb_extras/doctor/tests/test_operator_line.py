"""The operator's line, measured at a terminal whose line has a rate and a delay."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
from typing import TYPE_CHECKING

import pytest
from tests.console.terminal import Terminal
from tests.support.wording import says

from rsb_bridge.model.finding import Grade
from rsb_console.terminal.terminal_facts import TRUE_COLOUR, TerminalFacts
from rsb_extras.doctor.operator_line import AskedTerminal, Bunches, Line, LineText, finding

if TYPE_CHECKING:
    from collections.abc import Iterator

QUESTION, ANSWER = b"\x1b[6n", b"\x1b[1;1R"


class LineClock:
    """A clock that advances by the time that a line would have taken for what it carries.

    Looks advance it by a little, so that a terminal that never answers is waited for, however long a look takes.
    """

    def __init__(self, look: float = 0.0) -> None:
        self.now = 0.0
        self._look = look

    def __call__(self) -> float:
        self.now += self._look
        return self.now


def carry(terminal: int, clock: LineClock, rate: float, delay: float, ended: threading.Event) -> None:
    """Be the terminal: read what is written, and answer each question once the line has carried all before it."""
    begun = b""
    while not ended.is_set():
        if not select.select([terminal], [], [], 0.02)[0]:
            continue
        with contextlib.suppress(OSError):
            *questions, begun = (begun + os.read(terminal, 65536)).split(QUESTION)
            for before in questions:
                clock.now += len(before + QUESTION) / rate + delay
                os.write(terminal, ANSWER)


@contextlib.contextmanager
def line(clock: LineClock, rate: float = 0.0, delay: float = 0.0) -> Iterator[int]:
    """A terminal at such a line, or one that answers nothing."""
    terminal, program = os.openpty()
    ended = threading.Event()
    reader = threading.Thread(target=carry, args=(terminal, clock, rate, delay, ended))
    if rate:
        reader.start()
    try:
        yield program
    finally:
        ended.set()
        if rate:
            reader.join()
        os.close(program)
        os.close(terminal)


@pytest.mark.parametrize(("rate", "delay"), [(300, 0.0), (960, 0.0), (1_920, 0.3), (11_520, 0.05), (300_000, 0.02)])
def test_rate_and_round_trip_are_the_line_s(rate: float, delay: float) -> None:
    clock = LineClock()
    with line(clock, rate, delay) as program, AskedTerminal(program, clock) as terminal:
        found = terminal.measure()
    assert found is not None
    assert found.round_trip == pytest.approx(delay + len(QUESTION) / rate)
    assert found.rate == pytest.approx(rate, rel=0.05)


@pytest.mark.parametrize("rate", [300, 960, 1_920, 11_520, 300_000, 1e9])
def test_measuring_takes_half_a_second_of_line(rate: float) -> None:
    clock = LineClock()
    with line(clock, rate) as program, AskedTerminal(program, clock) as terminal:
        found = terminal.measure()
    assert clock.now < 0.55
    assert found is not None
    assert (found.rate is None) == (rate > 1e6)


def test_terminal_without_answers_is_not_measured() -> None:
    clock = LineClock(look=0.5)
    with line(clock) as program, AskedTerminal(program, clock) as terminal:
        assert terminal.measure() is None


def test_terminal_is_given_back_as_it_was() -> None:
    clock = LineClock(look=0.5)
    with line(clock) as program:
        before = termios.tcgetattr(program)
        with AskedTerminal(program, clock) as terminal:
            assert termios.tcgetattr(program) != before
            terminal.measure()
        assert termios.tcgetattr(program) == before


class Bunching(AskedTerminal):
    """A terminal in simulated time, whose line brings all that waits at once, every so often.

    Args:
        every: s between two bunches, or 0 for a line that brings each thing at once.
        held: s between two repeats of a key that is held.
        answers: whether its answers come over the line.
    """

    def __init__(self, every: float, held: float = 0.0, *, answers: bool = True) -> None:
        self.now, self._every, self._held, self._answers = 0.0, every, held, answers
        self._waiting = b""
        self._repeated = self._brought = 0.0
        super().__init__(0, lambda: self.now)

    def _write(self, data: bytes) -> int:
        self._waiting += ANSWER if self._answers else b""
        return len(data)

    def _read(self, within: float) -> bytes:
        end = self.now + within
        while True:
            self.now += 0.001
            if self._held and self.now >= self._repeated + (self._held if self._repeated else 0.5):
                self._repeated = self.now
                self._waiting += b"i"
            if self._waiting and self.now >= self._brought + self._every:
                self._brought = self.now
                data, self._waiting = self._waiting, b""
                return data
            if self.now >= end:
                return b""


@pytest.mark.parametrize(
    ("line", "what", "size", "apart"),
    [
        (Bunching(0.1), "answers", 3.3, 0.1),
        (Bunching(0.1, 0.033, answers=False), "keys", 3, 0.1),
        (Bunching(0.2, 0.04, answers=False), "keys", 5, 0.2),
        (Bunching(0.0), "", 0, 0),
        (Bunching(0.0, 0.033), "", 0, 0),
    ],
)
def test_bunches_are_found(line: Bunching, what: str, size: float, apart: float) -> None:
    found = line.watch().bunches
    if not what:
        assert found is None
        return
    assert found is not None
    assert found.what == what
    assert found.size == pytest.approx(size, rel=0.25)
    assert found.apart == pytest.approx(apart, abs=0.025)


@pytest.mark.parametrize(("kind", "grade"), [("1;10;0", Grade.UNKNOWN), ("1;4000;26", Grade.NOTE)])
def test_bunches_are_shown_with_remedy(kind: str, grade: Grade) -> None:
    facts, bunches = TerminalFacts("", kind, 256), Bunches("keys", 3.2, 0.1)
    found = finding(Line(0.1, 40_000.0), facts, {}, bunches)
    assert "keys come in bunches of 3, each 0.10 s" in found.text
    assert (found.grade, found.remedy) == (grade, LineText.BUNCHED())
    assert found.facts["bunches"] == {"what": "keys", "size": 3.2, "apart": 0.1}


KITTY = TerminalFacts("kitty(0.26.5)", "1;4000;26", TRUE_COLOUR, (9, 18), "kitty")
TMUX = TerminalFacts("tmux 3.3a", "84;0;0", 256)


@pytest.mark.parametrize(
    ("measured", "facts", "environ", "grade", "text"),
    [
        (Line(0.02, 40_000.0), KITTY, {}, Grade.OK, LineText.LINE),
        (Line(0.0001, None), KITTY, {}, Grade.OK, LineText.LINE),
        (Line(0.1, 960.0), KITTY, {}, Grade.NOTE, LineText.LINE),
        (Line(1.2, 40_000.0), KITTY, {}, Grade.WARNING, LineText.LINE),
        (Line(0.0001, None), TMUX, {}, Grade.UNKNOWN, LineText.RELAYED),
        (Line(0.0001, None), TerminalFacts("", "1;10;0", 256), {}, Grade.UNKNOWN, LineText.RELAYED),
        (Line(0.0001, None), KITTY, {"ZELLIJ": "0"}, Grade.UNKNOWN, LineText.RELAYED),
        (None, TerminalFacts(colours=16), {}, Grade.UNKNOWN, LineText.MUTE),
    ],
)
def test_finding_says_what_line_is_good_for(
    measured: Line | None, facts: TerminalFacts, environ: dict[str, str], grade: Grade, text: LineText
) -> None:
    found = finding(measured, facts, environ)
    assert says(found.text, text)
    assert found.grade == grade
    assert found.facts["answers"] == (measured is not None)
    figures = measured if measured is not None and text is LineText.LINE else (None, None)
    assert (found.facts["round_trip"], found.facts["bytes_per_second"]) == figures


def test_doctor_says_that_mute_terminal_cannot_be_measured() -> None:
    with Terminal("rsb_console", "doctor", "--json", environ={"TERM": "vt220"}, forked=True) as terminal:
        terminal.exit_code()
        assert b'"answers":false' in terminal.output.replace(b" ", b"")
        assert b"Traceback" not in terminal.output
