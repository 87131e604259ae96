"""Failures that pytest itself cannot report, or reports of a stranger."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAILS_ON_NO_LINE = """
def fails():
    raise ValueError("of no line")

fails.__code__ = fails.__code__.replace(co_linetable=b"\\xff" * 16)  # eight instructions without a line, each

def test_fails():
    fails()

def test_passes():
    pass
"""

LEAVES = """
import socket

import pytest

class Holder:
    def __init__(self):
        self.itself, self.socket = self, socket.socket()

@pytest.fixture
def holder():
    return Holder()

def test_leaves():
    Holder()

def test_leaves_by_fixture(holder):
    pass

def test_closes(holder):
    holder.socket.close()

def test_makes_none():
    pass
"""


def run(test: str, folder: Path) -> str:
    (folder / "test_it.py").write_text(test, encoding="utf-8")
    command = (sys.executable, "-m", "pytest", "-q", "-p", "conftest", str(folder), "-W", "error")
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    return ran.stdout


def test_failure_without_a_line_ends_no_run(tmp_path: Path) -> None:
    said = run(FAILS_ON_NO_LINE, tmp_path)
    assert "1 failed, 1 passed" in said
    assert "ValueError: of no line" in said


def test_socket_is_missed_at_the_test_that_leaves_it(tmp_path: Path) -> None:
    said = run(LEAVES, tmp_path)
    left = [line.partition("::")[2].partition(" ")[0] for line in said.splitlines() if line.startswith("ERROR")]
    assert left == ["test_leaves", "test_leaves_by_fixture"]
    assert "4 passed, 2 errors" in said
