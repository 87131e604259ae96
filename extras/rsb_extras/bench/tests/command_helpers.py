"""Helpers of `test_command` and others."""

from __future__ import annotations

import subprocess
import sys

WITHIN = 240.0


TINY = ("--sizes", "2500", "--seconds", "3", "--json")


def bench(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output, errors."""
    command = [sys.executable, "-m", "rsb_console", "bench", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WITHIN, check=False)
    return done.returncode, done.stdout, done.stderr
