"""Checks of `make test` that are no tests: style, layers, types, and the wire with its coverage."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_OF_MAKE = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")
"""Variables by which an outer make talks to an inner one."""


@pytest.mark.parametrize("target", ["types", "test-wire", "quick-lint"])
def test_it_passes(target: str) -> None:
    environ = {
        name: value for name, value in os.environ.items() if name not in _OF_MAKE and not name.startswith("PYTEST")
    }
    ran = subprocess.run(
        ["make", "--no-print-directory", f"VENV={sys.prefix}", target], cwd=ROOT, env=environ, check=False
    )
    assert ran.returncode == 0, f"make {target}"
