"""Forked processes are like started ones: input, output, environment, terminal, exit code and end."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
from pathlib import Path

import pytest
from tests.support.forker import Forked

MODULE = """
import atexit, os, sys
atexit.register(print, "at exit")
print(sys.argv[1:], os.environ["GIVEN"], os.environ["MORE"], os.getcwd(), sys.stdin.read())
print("error", file=sys.stderr)
{end}
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIVEN", "by the test")
    return "in_the_folder"


@pytest.mark.parametrize(("end", "code"), [("", 0), ("sys.exit(3)", 3), ("sys.exit('words')", 1), ("1 / 0", 1)])
def test_it_is_like_one_that_is_started(end: str, code: int, module: str, tmp_path: Path) -> None:
    (tmp_path / f"{module}.py").write_text(MODULE.format(end=end))
    pipes = subprocess.PIPE
    with Forked(module, "-x", stdin=pipes, stdout=pipes, stderr=pipes, environ={"MORE": "to it"}) as process:
        process.stdin.write("words")
        output, errors = process.communicate(60)
    assert process.returncode == code
    assert output == f"['-x'] by the test to it {tmp_path} words\nat exit\n"
    assert errors.startswith("error\n")
    assert ("ZeroDivisionError" in errors) == ("/" in end)


def test_signal_ends_process_with_its_own_terminal(module: str, tmp_path: Path) -> None:
    (tmp_path / f"{module}.py").write_text("import os, time\nprint(os.tcgetpgrp(0), flush=True)\ntime.sleep(600)\n")
    ours, theirs = pty.openpty()
    with Forked(module, stdin=theirs, stdout=theirs, stderr=theirs, terminal=True) as process:
        os.close(theirs)
        assert os.read(ours, 100).split() == [str(process.pid).encode()]
        assert process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.0)
        process.kill()
        assert process.wait(60) == -signal.SIGKILL
    os.close(ours)
