"""Another terminal takes over, as where dtach is attached again: it is asked, and gets its modes and all of the screen.

The terminals here answer as kitty 0.26, xterm 379 and a VT220 do.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
from tests.console.driving import on_main
from tests.console.terminal import Terminal
from tests.support.waiting import eventually
from textual import events

from rsb_console.terminal.driver import ConsoleDriver
from rsb_console.terminal.known_terminal import KnownTerminal
from rsb_console.terminal.pulse import Pulse
from rsb_console.terminal.terminal_facts import TRUE_COLOUR, TerminalFacts, is_plain
from rsb_console.terminal_app import ShutdownReason

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

_DA1, _PLACE, _DECRQSS = rb"\x1b\[c", rb"\x1b\[(\d+);(\d+)H\x1b\[6n", rb"\x1bP\$qm\x1b\\"
MODES = ["\x1b[?1047h", "\x1b[?1000h", "\x1b[?1006h", "\x1b[?2004h", "\x1b[?1004h", "\x1b[?25l", "\x1b[?7l"]
LANDMARK = "/robot2/scan"


class Kind(NamedTuple):
    """A kind of terminal.

    Attributes:
        da2: the parameters of its answer to DA2.
        answers: by the question, as a pattern.
    """

    da2: str
    answers: dict[bytes, bytes]

    @property
    def rules(self) -> dict[bytes, bytes]:
        return self.answers and {_PLACE: b"\x1b[%s;%sR", rb"\x1b\[>c": b"\x1b[>%sc" % self.da2.encode(), **self.answers}


KITTY = Kind(
    "1;4000;26",
    {
        rb"\x1b\[>q": b"\x1bP>|kitty(0.26.5)\x1b\\", _DECRQSS: b"\x1bP1$r0;48:2:1:2:3m\x1b\\",
        rb"\x1b_Gi=31[^\x1b]*\x1b\\": b"\x1b_Gi=31;OK\x1b\\", _DA1: b"\x1b[?62;c",
    },
)  # fmt: skip
XTERM = Kind("41;379;0", {rb"\x1b\]4;200;\?\x07": b"\x1b]4;200;rgb:ffff/0000/d7d7\x07", _DA1: b"\x1b[?64;1;2;6c"})
MUTE = Kind("", {})
VT220 = Kind("1;20;0", {_DA1: b"\x1b[?62;1;2;6;7;8;9c"})


class Answering(Terminal):
    """A terminal of some kind, which may be another one from now on."""

    kind = KITTY
    _answered = 0
    _peace = 1.0  # s

    def take_over(self, kind: Kind) -> int:
        """Be another one, as dtach shows it; return how much was written before."""
        self.kind = kind
        self.type("\x0c")
        return len(self.output)

    def read(self, seconds: float, most: int = 65536) -> None:
        super().read(seconds, most)
        new = self.output[self._answered :]
        found = [(each, answer) for rule, answer in self.kind.rules.items() for each in re.finditer(rule, new)]
        for each, answer in sorted(found, key=lambda pair: pair[0].start()):
            self.type(answer % each.groups() if each.groups() else answer)
        # A question may have come in part.
        begun = re.search(rb"\x1b[^\x1b]{0,40}\Z", new)
        end = max([each.end() for each, _ in found], default=0)
        self._answered += max(end, begun.start() if begun else len(new))

    def frame(self) -> str:
        """Have all of the screen drawn, and return what was written for it.

        Ctrl-L makes it another terminal, which has to answer in peace: each time it gets longer for that.
        """
        deadline, self._peace = time.monotonic() + self._peace, 1.5 * self._peace
        while time.monotonic() < deadline:
            self.read(0.05)
        start = len(self.output)
        self.type("\x0c")
        self.wait_for(LANDMARK, after=start)
        self.wait_for("quit", after=start)
        return self.output[start:].decode(errors="ignore")  # it may end within a character


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Answering]:
    environ = {"TERM": "xterm-kitty", "COLORTERM": "truecolor", "LC_ALL": ""}
    for name in ("TMUX", "STY", "ZELLIJ"):
        monkeypatch.delenv(name, raising=False)
    made = Answering(sys.executable, "-m", "tests.console.scripted_console", environ=environ)
    with made:
        made.wait_for(LANDMARK)
        made.wait_for("\x1b[38;2;")
        yield made


def is_drawn_for(frame: str, kind: Kind) -> bool:
    """Whether a screen was drawn with what a kind of terminal has, and with no more."""
    if kind is KITTY:
        return "38;2;" in frame and not frame.isascii()
    few = "38;2;" not in frame and "48;2;" not in frame.replace("48;2;1;2;3m", "")  # which is a question
    if kind is XTERM:
        return few and "38;5;" in frame and not frame.isascii()
    return few and "38;5;" not in frame and "48;5;" not in frame and frame.isascii() and "\x1b_" not in frame


def test_each_terminal_gets_its_modes_and_colours(terminal: Answering) -> None:
    for kind in (XTERM, VT220, KITTY):
        start = terminal.take_over(kind)
        for mode in MODES:
            terminal.wait_for(mode, after=start)
        eventually(lambda kind=kind: is_drawn_for(terminal.frame(), kind), what=f"drawn for {kind.da2}")
    assert b"\x1b_G" in terminal.output[start:], "the last one is asked for pictures"
    assert b"\x1bP$q" not in terminal.frame().encode() or terminal.kind is KITTY


def test_terminal_that_answers_no_longer_gets_few_colours(terminal: Answering) -> None:
    start = terminal.take_over(MUTE)
    terminal.wait_for("\x1b[40m ", after=start)


def test_dtach_is_attached_from_another_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("dtach") is None:
        pytest.skip("needs dtach")
    for name in ("TMUX", "STY", "ZELLIJ"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-kitty")
    monkeypatch.setenv("COLORTERM", "truecolor")
    socket, console = tmp_path / "socket", (sys.executable, "-m", "tests.console.scripted_console")
    with subprocess.Popen(["dtach", "-N", socket, *console], stdin=subprocess.DEVNULL) as master:
        try:
            eventually(socket.exists, what="dtach")
            for kind in (KITTY, VT220, XTERM):
                terminal = Answering("dtach", "-a", str(socket))
                terminal.kind = kind
                with terminal:
                    terminal.wait_for(LANDMARK)
                    for mode in MODES if kind is not KITTY else ():
                        terminal.wait_for(mode)
                    eventually(lambda kind=kind, at=terminal: is_drawn_for(at.frame(), kind), what=kind.da2)
        finally:
            master.terminate()


# -- what is known


def known(environ: dict[str, str]) -> KnownTerminal:
    return KnownTerminal(TerminalFacts(colours=TRUE_COLOUR, light=True), environ, lambda: 0.0)


def test_environment_describes_first_terminal_only() -> None:
    terminal = known({"TERM": "xterm-kitty"})
    assert terminal.meet("1;4000;26", None)
    terminal.take("[?62;c")
    terminal.doubt()
    assert terminal.meet("41;379;0", (8.0, 16.0))
    assert (terminal.facts.colours, terminal.is_known) == (TRUE_COLOUR, False), "until it has told all"
    terminal.take("]4;200;rgb:ffff/0000/d7d7\x07")
    terminal.take("[?64;4c")
    assert terminal.facts == TerminalFacts(
        "", "41;379;0", 256, (8.0, 16.0), "sixel", None, answered=True, ascii_only=False
    )
    terminal.doubt()
    assert not terminal.is_known
    assert not terminal.meet("1;20;0", None), "it would print the questions"
    assert (terminal.facts.colours, terminal.facts.ascii_only, terminal.swallows) == (16, True, False)
    terminal.doubt()
    terminal.meet("1;4000;26", None)
    terminal.take("[?62;c")
    assert (terminal.facts.colours, terminal.facts.ascii_only) == (TRUE_COLOUR, False)


def test_same_terminal_is_asked_once() -> None:
    terminal = known({"TERM": "xterm"})
    assert terminal.meet("41;379;0", None)
    assert not terminal.meet("41;379;0", None)


@on_main()
async def test_title_is_set_once_for_each_terminal(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not again with each answer: they come several times a second."""
    monkeypatch.setenv("TERM", "xterm")
    driver = ConsoleDriver(app)
    written: list[str] = []
    vars(driver)["write"] = written.append
    driver.entitle("desk")

    def answer() -> None:
        question = re.search(r"\x1b\[(\d+);(\d+)H", driver.pulse.question())
        assert question is not None
        driver.pulse.answered(int(question[1]), int(question[2]))

    for kind in ("1;4000;35", "1;4000;35", "41;379;0", "41;379;0"):
        answer()
        driver.process_message(events.Key("<terminal-kind>", f"\x1b[>{kind}c"))
        await pilot.pause()
    assert sum("\x1b]0;desk" in each for each in written) == 3


@on_main()
async def test_nothing_is_erased_in_a_terminal_that_may_be_another_one(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One with as many colours may erase in another paper, and what is there would stay."""
    monkeypatch.setattr(app, "facts", TerminalFacts(colours=TRUE_COLOUR, erases=True))
    driver = ConsoleDriver(app)
    vars(driver)["write"] = lambda _: None

    async def tell(kind: str) -> None:
        question = re.search(r"\x1b\[(\d+);(\d+)H", driver.pulse.question())
        assert question is not None
        driver.pulse.answered(int(question[1]), int(question[2]))
        driver.process_message(events.Key("<terminal-kind>", f"\x1b[>{kind}c"))
        await pilot.pause()

    await tell("1;4000;26")
    assert driver.erases
    driver.process_message(events.Key("ctrl+l", None))
    assert not driver.erases
    await tell("41;379;0")
    assert not driver.erases, "it has not told all"


@on_main()
async def test_hangup_that_only_the_driver_sees_is_noted(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """A console that crashes as well asks for it, before its bridge goes on."""
    driver = ConsoleDriver(app)
    driver._terminal.hung_up()
    assert app.signals == {ShutdownReason.HANGUP}


@on_main()
async def test_line_of_another_terminal_that_answers_nothing_is_used(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Else each second carries some words of its first screen, for half a minute."""
    driver = ConsoleDriver(app)
    driver.line.wrote(3_000)
    driver.line.asked(time.monotonic())
    driver.line.answered(time.monotonic())
    driver.line.asked(time.monotonic())
    now = time.monotonic()
    driver.pulse = Pulse({}, lambda: now)
    driver.pulse.question()
    driver.pulse.answered(2, 2)
    now += 1.0
    driver.process_message(events.Key("ctrl+l", None))
    driver.look_for_answers()
    assert driver.line.answers
    now += 10.0
    driver.look_for_answers()
    assert not driver.line.answers


@pytest.mark.parametrize(
    ("kind", "plain"),
    [
        ("1;20;0", True), ("0;10;1", True), ("24;20;0", True), ("", True), ("1;10;0", False), ("84;0;0", False),
        ("83;40900;0", False), ("65;7002;1", False), ("1;95;0", False), ("0;136;0", False), ("41;379;0", False),
    ],
)  # fmt: skip
def test_vt_is_told_from_emulators(kind: str, plain: bool) -> None:
    assert is_plain(kind) is plain
