"""A unit's command: what it gets, its time, its end and its output."""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.support.waiting import eventually

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.text import is_clean
from rsb_extras.units.tests.supervised import Supervised
from rsb_extras.units.unit_process import OUTPUT, CommandEnd, run_words, state_of
from rsb_extras.units.unit_records import LINES, UnitState

if TYPE_CHECKING:
    import pytest


def run(*words: str, seconds: float = 60.0, stop: threading.Event | None = None) -> CommandEnd:
    return run_words(words, seconds, Clock(), stop or threading.Event())


def python(program: str, *arguments: str, seconds: float = 60.0) -> CommandEnd:
    return run(sys.executable, "-c", program, *arguments, seconds=seconds)


def test_no_shell_reads_the_words(tmp_path: Path) -> None:
    words = ("a b", "$HOME", "; touch x", "`id`", "*", "")
    ended = python("import sys; print(*map(repr, sys.argv[1:]), sep='\\n')", *words)
    assert ended.lines == tuple(map(repr, words))


def test_it_gets_no_input_and_little_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PYTHONPATH", "LD_PRELOAD", "NOTIFY_SOCKET", "RSB_SECRET"):
        monkeypatch.setenv(name, "")
    names = {line.partition("=")[0] for line in run("/usr/bin/env").lines}
    passed = {"PATH", "HOME", "USER", "LOGNAME", "LANG", "LC_ALL", "TZ", "XDG_RUNTIME_DIR", "DBUS_SESSION_BUS_ADDRESS"}
    assert names == passed & {*os.environ}
    folder, pid, group_and_session = run("sh", "-c", "cat; pwd; echo $$; cut -d' ' -f5,6 /proc/$$/stat").lines
    assert folder == "/"
    assert group_and_session == f"{pid} {pid}"


def test_one_that_takes_too_long_ends_with_all_that_it_started(tmp_path: Path) -> None:
    """It ignores SIGTERM, and so does its child."""
    program = (
        "import os, pathlib, signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "child = os.fork()\n"
        "if child: pathlib.Path(sys.argv[1]).write_text(str(child))\n"
        "print('begun', flush=True); time.sleep(1000)"
    )
    ended = python(program, str(tmp_path / "child"), seconds=1.0)
    assert (ended.code, ended.was_late) == (-9, True)
    child = int((tmp_path / "child").read_text())
    eventually(lambda: not _runs(child), what="the end of its child")


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_it_ends_at_once_with_the_bridge() -> None:
    stop, ends = threading.Event(), []
    thread = threading.Thread(target=lambda: ends.append(run("sleep", "1000", stop=stop)))
    thread.start()
    stop.set()
    thread.join(60)
    assert [(each.code, each.was_late) for each in ends] == [(-15, True)]


def test_what_it_leaves_in_the_background_goes_on(tmp_path: Path) -> None:
    """It even holds the pipe."""
    began = time.monotonic()
    ended = run("sh", "-c", 'sleep 1000 & echo $! > "$1"', "sh", str(tmp_path / "pid"))
    assert time.monotonic() - began < 900
    assert ended.code == 0
    pid = int((tmp_path / "pid").read_text())
    assert _runs(pid)
    os.kill(pid, 9)


def test_the_end_of_the_output_is_kept_and_clean() -> None:
    ended = python("for number in range(100_000): print(number, '\\x1b[2J\\u202e\\ttab', 'x' * 300)")
    assert len(ended.output) == OUTPUT
    assert len(ended.lines) <= LINES
    assert all(is_clean(line) and len(line) <= 255 for line in ended.lines)
    assert ended.lines[-1].startswith("99999 ")
    assert python("print('\\n' * 1000 + 'last')").lines == ("last",)
    assert run("sh", "-c", r"printf 'caf\351\n'").lines == ("caf\N{REPLACEMENT CHARACTER}",)


def test_one_that_cannot_begin_says_why() -> None:
    assert run("/no/such").problem == "No such file or directory"
    assert run("/etc/passwd").problem == "Permission denied"
    assert run("true", "\ud800").problem == "its words are not valid"


def test_states_are_those_of_exit_codes(tmp_path: Path) -> None:
    codes = {code: state_of(CommandEnd(code)) for code in (0, 1, 2, 3, 4, 127, -9, None)}
    assert codes == {
        0: UnitState.RUNNING, 1: UnitState.FAILED, 2: UnitState.FAILED, 3: UnitState.STOPPED, 4: UnitState.UNKNOWN,
        127: UnitState.UNKNOWN, -9: UnitState.UNKNOWN, None: UnitState.UNKNOWN,
    }  # fmt: skip
    assert state_of(CommandEnd(3, output=b"failed\n")) is UnitState.FAILED  # systemctl is-active
    assert state_of(CommandEnd(3, output=b"inactive\n")) is UnitState.STOPPED
    assert state_of(CommandEnd(0, was_late=True)) is UnitState.UNKNOWN
    supervised = Supervised(tmp_path / "nav")
    assert state_of(run(*supervised.unit.status)) is UnitState.STOPPED
    assert run(*supervised.unit.start).code == 0
    assert state_of(run(*supervised.unit.status)) is UnitState.RUNNING
    os.kill(supervised.pid, 9)
    eventually(lambda: state_of(run(*supervised.unit.status)) is UnitState.FAILED)
