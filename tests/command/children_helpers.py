"""Helpers of `test_children` and others."""

from __future__ import annotations

from pathlib import Path

import pytest

PLANTED = "import pathlib\npathlib.Path({marker!r}).touch()\nraise ImportError('planted')\n"


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with modules that the program imports; each leaves a mark if it runs."""
    marker = tmp_path / "ran"
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("msgspec", "resource", "rclpy", "std_msgs", "runpy", "signal", "numpy", "yaml", "weakref"):
        (folder / f"{name}.py").write_text(PLANTED.format(marker=str(marker)))
    monkeypatch.chdir(folder)
    return marker
