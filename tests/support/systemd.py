"""Reads systemd's assessment of a unit."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path


def exposure(unit: Path) -> float:
    """Return the exposure of a unit, of 10, as `systemd-analyze security` computes it."""
    run = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    found = re.search(r"Overall exposure level for .*: ([0-9.]+)", run.stdout)
    assert found, run.stdout + run.stderr
    return float(found[1])
