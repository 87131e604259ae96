"""Runs what is in `guest` in the machine."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.bluetooth.conftest import Outcomes


def test_in_the_machine(outcomes: Outcomes) -> None:
    exit_code, output, _ = outcomes.guest
    sys.stdout.write(output)
    assert exit_code == 0, output
    assert re.search(r"= \d+ passed in .* =", output), "some were skipped, though the machine has all they need"
