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
echo "%s" >&2
exit %d
"""


NO_NETWORK = "WARNING: Retrying after connection broken by 'NewConnectionError(...)'"
NO_WHEEL = "ERROR: No matching distribution found for ros-jazzy-rclpy"
OTHER = "ERROR: something else"


def installed(tmp_path: Path, code: int, error: str) -> tuple[int, str, str]:
    """Run it with a pip that has found two packages of 15 MB together; return what a log and a terminal have."""
    python = tmp_path / "python"
    python.write_text(_PIP % (error, code))
    python.chmod(0o755)
    command = (sys.executable, _INSTALL, python, ".")
    logged = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path)
    reading, writing = pty.openpty()
    ran = subprocess.run(command, stdout=writing, timeout=60, check=False, cwd=tmp_path)
    os.close(writing)
    shown = os.read(reading, 10_000).decode()
    os.close(reading)
    assert ran.returncode == logged.returncode
    assert "\r" not in logged.stdout
    return logged.returncode, logged.stdout, shown


def test_success_is_three_lines_or_one(tmp_path: Path) -> None:
    code, logged, shown = installed(tmp_path, 0, "")
    assert code == 0
    assert "2 packages, 15 MB" in logged
    assert (len(logged.splitlines()), len(re.findall(r"\r\n", shown))) == (3, 1)


@pytest.mark.parametrize(("error", "remedy"), [(NO_NETWORK, "PIP_INDEX_URL"), (NO_WHEEL, "PYTHON="), (OTHER, OTHER)])
def test_failure_is_one_sentence_and_a_file(error: str, remedy: str, tmp_path: Path) -> None:
    code, logged, shown = installed(tmp_path, 1, error)
    assert code == 1
    assert len(re.findall(r"\r\n", shown)) == 2
    assert remedy in logged
    assert remedy in shown
    assert error in (tmp_path / "build/install.log").read_text()
