"""Failures that pytest itself cannot report."""

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


def test_failure_without_a_line_ends_no_run(tmp_path: Path) -> None:
    (tmp_path / "test_lines.py").write_text(FAILS_ON_NO_LINE, encoding="utf-8")
    command = (sys.executable, "-m", "pytest", "-q", "-p", "conftest", str(tmp_path))
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert "1 failed, 1 passed" in ran.stdout
    assert "ValueError: of no line" in ran.stdout
