"""A working folder with entry points of its own, which no command may run."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def trap(tmp_path: Path) -> Path:
    """A folder whose feature leaves a file behind."""
    information = tmp_path / "trap-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: trap\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[rsb_console.feature]\ntrap = trap:FEATURE\n")
    (tmp_path / "trap.py").write_text("import pathlib\npathlib.Path('sprung').touch()\n")
    return tmp_path


@pytest.mark.parametrize("variable", ["", ":", os.curdir])
def test_no_entry_point_of_working_folder_runs(trap: Path, variable: str) -> None:
    command = [sys.executable, "-m", "rsb_console", "completion", "bash"]
    environ = os.environ | {"PYTHONPATH": variable}
    subprocess.run(command, cwd=trap, env=environ, check=True, stdout=subprocess.DEVNULL)
    assert not (trap / "sprung").exists()
