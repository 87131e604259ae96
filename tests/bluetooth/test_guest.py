"""Runs what is in `guest` in the machine, a fresh one for each module."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.bluetooth.conftest import Run

_MODULES = sorted(path.name for path in Path(__file__).parent.glob("guest/test_*.py"))


@pytest.mark.parametrize("module", _MODULES)
def test_in_the_machine(run: Run, module: str) -> None:
    outcome = run([f"tests/bluetooth/guest/{module}", "-rP"])
    sys.stdout.write(outcome.output)
    assert outcome.exit_code == 0, outcome.output
    assert re.search(r"= \d+ passed in .* =", outcome.output), "some were skipped, though the machine has all they need"
