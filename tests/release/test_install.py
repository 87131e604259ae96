"""`make demo` tells how far its installation is."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

_INSTALL = Path(__file__).parents[2] / ".ci/install.py"
_PIP = """#!/bin/sh
echo 'Collecting textual'
echo '  Downloading textual-8.2.8-py3-none-any.whl (700 kB)'
echo 'Collecting numpy'
echo '  Using cached numpy-2.3.0.whl (14.3 MB)'
echo 'Installing collected packages: numpy, textual'
echo 'ERROR: no space' >&2
exit %d
"""


@pytest.fixture(params=[0, 1])
def code(request: pytest.FixtureRequest, tmp_path: Path) -> int:
    """The exit code of a pip that has found two packages of 15 MB together."""
    python = tmp_path / "python"
    python.write_text(_PIP % request.param)
    python.chmod(0o755)
    return int(request.param)


def test_a_log_has_few_lines_and_pips_own_if_it_fails(code: int, tmp_path: Path) -> None:
    command = (sys.executable, _INSTALL, tmp_path / "python", ".")
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == code
    assert "2 packages, 15 MB" in ran.stdout
    assert ("ERROR: no space" in ran.stdout) == bool(code)
    assert "\r" not in ran.stdout
    if code == 0:
        assert len(ran.stdout.splitlines()) == 3


def test_a_terminal_has_one_line(tmp_path: Path, code: int) -> None:
    reading, writing = pty.openpty()
    command = (sys.executable, _INSTALL, tmp_path / "python", ".")
    ran = subprocess.run(command, stdout=writing, timeout=60, check=False)
    os.close(writing)
    shown = os.read(reading, 10_000).decode()
    os.close(reading)
    assert ran.returncode == code
    ends = len(re.findall(r"\r\n", shown))
    assert ends == 1 if code == 0 else ends > 5
