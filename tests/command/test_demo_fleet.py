"""The demo of a fleet, headless: every robot is linked, and a summary says so."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from rsb_console.command.arguments import parser_and_commands

if TYPE_CHECKING:
    from pathlib import Path

WITHIN = 120.0


def test_each_robot_is_linked_and_has_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    command = [sys.executable, "-m", "rsb_console", "demo", "--fleet", "--robots", "3", "--no-ui", "--seconds", "0.1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WITHIN, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith("robot00")]
    assert [row[:2] for row in rows[-3:]] == [[f"robot00{number}", "ok"] for number in range(3)]
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("text", ["0", "-1", "many"])
def test_how_many_robots_is_a_number_above_0(text: str) -> None:
    parser, _ = parser_and_commands()
    with pytest.raises(SystemExit):
        parser.parse_args(["demo", "--fleet", "--robots", text])
