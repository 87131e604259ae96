"""Commands that run: what of their output is kept, and how they end."""

from __future__ import annotations

import os
import signal
import threading
from typing import TYPE_CHECKING

import pytest
from tests.support.waiting import eventually

from rsb_extras.own_commands import running
from rsb_extras.own_commands.running import KEPT_LINES, LINE_LENGTH, Output, RunningCommand, RunningCommands

if TYPE_CHECKING:
    from pathlib import Path


def ran(line: str) -> RunningCommand:
    """Run a line to its end."""
    ended = threading.Event()
    command = RunningCommand(line, lambda _: ended.set())
    assert ended.wait(100)
    return command


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    ("line", "lines", "code"),
    [
        ("echo out; echo err >&2", ["out", "err"], 0),
        ("echo one | tr a-z A-Z; exit 7", ["ONE"], 7),
        ("no_such_program_here 2>/dev/null", [], 127),
        ("printf 'no end'", ["no end"], 0),
        ("cat", [], 0),  # its input is empty
        ("tty", ["not a tty"], 1),
        ("kill -SEGV $$", [], -signal.SIGSEGV),
    ],
)
def test_output_and_exit_code_are_the_lines(line: str, lines: list[str], code: int) -> None:
    command = ran(line)
    assert (command.output.lines, command.code) == (lines, code)


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        (b"\x1b[1;31mred\x1b[0m\n\x1b]0;title\x07x\n", ["red", "x"]),
        (b"\x1b[\x1bP\x07\x9b\n", ["\\x1b[\\x1bP\\x07\N{REPLACEMENT CHARACTER}"]),
        (b"10 %\r20 %\r30 %\r\ndone\n", ["30 %", "done"]),
        (b"10 %\r20 %", ["20 %"]),
        (b"a\tb\n", ["a       b"]),
        ("\N{RIGHT-TO-LEFT OVERRIDE}x\n".encode(), ["\\u202ex"]),
        (b"\xff\xfe\n", ["\N{REPLACEMENT CHARACTER}" * 2]),
    ],
)
def test_output_is_safe_for_a_terminal(data: bytes, lines: list[str]) -> None:
    output = Output()
    output.write(data)
    assert output.lines == lines
    byte_by_byte = Output()
    for at in range(len(data)):
        byte_by_byte.write(data[at : at + 1])
    assert byte_by_byte.lines == lines


def test_only_the_newest_lines_are_kept() -> None:
    output = Output()
    for number in range(KEPT_LINES + 100):
        output.write(b"%d\n" % number)
    assert (len(output.lines), output.lines[-1], output.dropped) == (KEPT_LINES, str(KEPT_LINES + 99), 100)


def test_line_without_an_end_is_cut() -> None:
    output = Output()
    for _ in range(100):
        output.write(b"x" * 65536)
    (line,) = output.lines
    assert len(line) == LINE_LENGTH


def test_endless_output_is_bounded_and_stops() -> None:
    ended = threading.Event()
    command = RunningCommand("yes", lambda _: ended.set())
    eventually(lambda: command.output.dropped, what="lines that are not kept")
    assert len(command.output.lines) <= KEPT_LINES + 1
    command.stop()
    assert ended.wait(100)
    assert command.code == -signal.SIGTERM


def test_stop_kills_children_that_ignore_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(running, "KILLED_AFTER", 0.2)
    ended, pids = threading.Event(), tmp_path / "pids"
    line = f"trap '' TERM; (trap '' TERM; echo $$ >{pids}; exec sleep 1000) & echo ready; wait; sleep 1000"
    command = RunningCommand(line, lambda _: ended.set())
    eventually(lambda: command.output.lines == ["ready"] and pids.exists(), what="it runs")
    group = os.getpgid(command.pid)
    command.stop()
    assert ended.wait(100)
    assert command.code == -signal.SIGKILL
    eventually(lambda: not is_alive(-group), what="nothing of it is left")


def test_background_process_does_not_hold_its_end() -> None:
    command = ran("sleep 1000 & echo $!")
    assert command.code == 0
    os.kill(int(command.output.lines[0]), signal.SIGKILL)


def test_end_of_the_console_ends_all() -> None:
    commands = RunningCommands()
    one = commands.start("sleep 1000", lambda _: None)
    other = commands.start("trap '' TERM; echo ready; while :; do sleep 0.1; done", lambda _: None)
    eventually(lambda: other.output.lines == ["ready"], what="it runs")
    assert commands.find("sleep 1000") is one
    commands.end()
    eventually(lambda: one.code is not None and other.code is not None, what="their ends")
    assert not len(commands)
