"""Helpers of `test_files` and others."""

from __future__ import annotations

import stat
from pathlib import Path

EVIL = "\x1b]0;evil\x07\x1b[2J\u202eevil\u200b\x9b31m\n2026-01-01 forged\r"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)
