"""Desktop notifications with the bell: which terminals get them, and what they are told."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.console.scripted import route
from tests.console.terminal import Terminal
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State
from rsb_console.app import fault_text
from rsb_console.terminal.desktop_notification import names_of_terminal, sequence

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot

ROOT = Path(__file__).parents[2]

KITTYS = "\x1b]99;i=rsb:d=0;robot1\x1b\\\x1b]99;i=rsb:d=1:p=body;/scan down\x1b\\"
WITH_A_FAULT = """
import sys, time
from dataclasses import replace
from pathlib import Path
from tests.console.driving import scripted_app
from tests.console.scripted import ROUTES, ScriptedEngine, route
from rsb_bridge.model.snapshot import State

class Faulty(ScriptedEngine):
    begins = time.monotonic() + 2

    def snapshot(self):
        state = State.DOWN if time.monotonic() > self.begins else State.OK
        return replace(super().snapshot(), routes=(route("/scan", state, reason="no publisher"),))

scripted_app(make_engine=Faulty, config=Path(sys.argv[1])).run()
"""
"""A console whose only topic fails after a while."""


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"TERM": "xterm-kitty"}, KITTYS),
        ({"TERM": "xterm-256color", "KITTY_WINDOW_ID": "1"}, KITTYS),
        ({"TERM": "foot"}, "\x1b]777;notify;robot1;/scan down\x1b\\"),
        ({"TERM": "rxvt-unicode-256color"}, "\x1b]777;notify;robot1;/scan down\x1b\\"),
        ({"TERM": "xterm-256color", "TERM_PROGRAM": "WezTerm"}, "\x1b]777;notify;robot1;/scan down\x1b\\"),
        ({"TERM": "xterm-256color", "TERM_PROGRAM": "iTerm.app"}, "\x1b]9; robot1: /scan down\x1b\\"),
        ({"TERM": "xterm-ghostty"}, "\x1b]9; robot1: /scan down\x1b\\"),
        ({"TERM": "xterm-256color"}, ""),
        ({"TERM": "linux"}, ""),
        ({"TERM": "screen"}, ""),
        ({}, ""),
    ],
)  # fmt: skip
def test_terminal_gets_what_it_knows(environ: dict[str, str], expected: str) -> None:
    assert sequence(environ, "", "robot1", "/scan down") == expected


@pytest.mark.parametrize("term", ["xterm-kitty", "foot", "xterm-ghostty"])
def test_text_of_others_ends_no_sequence(term: str) -> None:
    nasty = "\x1b\\\x07\x9c\x1b]0;title\x07\n" + "x" * 1000
    harmless = sequence({"TERM": term}, "", "a", "b")
    made = sequence({"TERM": term}, "", nasty, nasty)
    for control in "\x1b\x07\x9c\n":
        assert made.count(control) == harmless.count(control)
    assert len(made) < 400
    assert sequence({"TERM": "foot"}, "", "a;b", "c").count(";") == 3


@pytest.mark.parametrize(
    ("faulty", "text"),
    [
        ([route("/scan", State.DOWN, reason="no publisher")], "/scan DOWN: no publisher"),
        ([route("/a", State.SLOW), route("/b", State.DOWN)], "/a SLOW (and 1 more)"),
    ],
)
def test_first_fault_is_named(faulty: list[RouteSnapshot], text: str) -> None:
    assert fault_text(faulty) == text


def console(tmp_path: Path, settings: str) -> tuple[str, ...]:
    """Return a command: a console with such settings, whose only topic fails after a while."""
    (tmp_path / "console.yaml").write_text(settings)
    (tmp_path / "faulty.py").write_text(WITH_A_FAULT)
    path = os.pathsep.join(each for each in (str(ROOT), *sys.path) if each)
    return ("env", f"PYTHONPATH={path}", sys.executable, str(tmp_path / "faulty.py"), str(tmp_path))


def rings(terminal: Terminal) -> int:
    """Return how often the bell has rung: the same character ends other sequences."""
    terminal.read(0.05)
    return re.sub(rb"\x1b\]\d+;[^\x07\x1b]*\x07", b"", terminal.output).count(b"\x07")


@pytest.mark.parametrize("notify", [True, False])
def test_bell_notifies_and_the_title_counts(tmp_path: Path, notify: bool) -> None:
    environ = {"TERM": "xterm-ghostty", "TMUX": "", "KITTY_WINDOW_ID": ""}
    with Terminal(*console(tmp_path, f"bell: true\nnotify: {notify}"), environ=environ) as terminal:
        terminal.wait_for("\x1b]0;robot1 \N{BALLOT X}1\x07")
        eventually(lambda: rings(terminal) == 1, what="a ring")
        if notify:
            terminal.wait_for("\x1b]9; robot1: /scan DOWN: no publisher\x1b\\")
        terminal.kill(signal.SIGTERM)
        terminal.exit_code()
        assert terminal.output.count(b"\x1b]9;") == notify
        assert rings(terminal) == 1


NEEDS_TMUX = pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
OUTER = {"TERM": "rxvt-unicode-256color", "TMUX": "", "KITTY_WINDOW_ID": "", "LC_ALL": "C.UTF-8"}


def in_tmux(tmp_path: Path, passes: str) -> tuple[str, ...]:
    """Return the beginning of a command in tmux, which passes sequences on or does not."""
    (tmp_path / "tmux.conf").write_text(f"set -g allow-passthrough {passes}\n")
    return "tmux", "-S", str(tmp_path / "tmux"), "-f", str(tmp_path / "tmux.conf"), "new-session"


@NEEDS_TMUX
def test_notification_passes_tmux(tmp_path: Path) -> None:
    command = (*in_tmux(tmp_path, "on"), *console(tmp_path, "bell: true\nnotify: true"))
    with Terminal(*command, environ=OUTER) as terminal:
        terminal.wait_for("\x1b]777;notify;robot1;/scan DOWN: no publisher\x1b\\")
        subprocess.run(["tmux", "-S", str(tmp_path / "tmux"), "kill-server"], check=True)
        terminal.exit_code()


@NEEDS_TMUX
def test_tmux_that_passes_nothing_gets_none(tmp_path: Path) -> None:
    program = "import os; from rsb_console.terminal.desktop_notification import names_of_terminal as names; "
    program += f"open({str(tmp_path / 'names')!r}, 'w').write(repr(names(os.environ, '')))"
    environ = ("env", f"PYTHONPATH={os.pathsep.join(filter(None, sys.path))}")
    with Terminal(*in_tmux(tmp_path, "off"), *environ, sys.executable, "-c", program, environ=OUTER) as terminal:
        terminal.exit_code()
    assert (tmp_path / "names").read_text() == "('', True)"


def test_names_of_a_dead_tmux_are_none(tmp_path: Path) -> None:
    assert names_of_terminal({"TMUX": f"{tmp_path}/none,1,0", "TERM": "xterm-kitty"}, "") == ("", True)


def test_name_of_terminal_counts_as_term() -> None:
    """SSH carries neither KITTY_WINDOW_ID nor, where its TERM is unknown, kitty's own."""
    assert sequence({"TERM": "xterm-256color"}, "kitty(0.26.5)", "a", "b") == sequence(
        {"TERM": "xterm-kitty"}, "", "a", "b"
    )
