"""A feature that judges, rings and has keys of its own is installed as a package, and tried on both sides of a link."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from tests.feature.own_process import ROOT, describe, passed

if TYPE_CHECKING:
    from pathlib import Path


def test_band_works(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "tests/feature/band", tmp_path / "rsb_band", ignore=shutil.ignore_patterns("__pycache__"))
    describe(tmp_path, "rsb-band", "band = rsb_band:FEATURE\n")
    assert "5 passed" in passed(tmp_path, "band_inside.py")
