"""Runs what is in `guest` in the machine."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.bluetooth.conftest import Run

_GUEST = Path(__file__).parent / "guest"
_TRAFFIC = ["test_bridge.py", "test_rfcomm.py"]
"""They share a machine, whose adapters do not pair; the others share one whose adapters do, and are unplugged last."""
_OTHERS = sorted(path.name for path in _GUEST.glob("test_*.py") if path.name not in _TRAFFIC)


@pytest.mark.parametrize("modules", [_TRAFFIC, _OTHERS], ids="+".join)
def test_in_the_machine(run: Run, modules: list[str]) -> None:
    outcome = run([*(f"tests/bluetooth/guest/{module}" for module in modules), "-rP"])
    sys.stdout.write(outcome.output)
    assert outcome.exit_code == 0, outcome.output
    assert re.search(r"= \d+ passed in .* =", outcome.output), "some were skipped, though the machine has all they need"
