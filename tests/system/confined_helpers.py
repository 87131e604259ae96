"""Helpers of `test_confined` and others."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


UNIT = ROOT / "configs" / "rsb-console@.service"


CONFINED = [sys.executable, "-m", "tests.support.sandbox", str(UNIT)]


def has_seccomp() -> bool:
    try:
        ctypes.CDLL("libseccomp.so.2")
    except OSError:
        return False
    return shutil.which("systemd-analyze") is not None


def confined(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*CONFINED, *command], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
