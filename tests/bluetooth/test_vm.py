"""The VM itself: it reports what happened inside, also when that is the machine's death."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.bluetooth.vm import machine

if TYPE_CHECKING:
    from pathlib import Path

    from tests.bluetooth.conftest import Outcomes
    from tests.bluetooth.vm.layers import Layers


def test_failures_inside_give_output_and_exit_code(outcomes: Outcomes) -> None:
    assert outcomes.probes.exit_code == 1
    assert "1 failed, 1 passed" in outcomes.probes.output
    assert "the answer is 42" in outcomes.probes.output
    assert "[init] ready" in outcomes.probes.console


def test_dead_machine_is_told_from_failed_test(boots_from: Layers, tmp_path: Path) -> None:
    """Without an init the kernel panics as soon as it has booted."""
    (nothing := tmp_path / "initrd").touch()
    with pytest.raises(machine.DiedError, match=r"no exit code: it ended\n(.|\n)*Kernel panic(.|\n)*Call Trace"):
        machine.run(boots_from._replace(initrd=nothing), ["any"])


def test_a_hung_machine_is_ended(boots_from: Layers) -> None:
    with pytest.raises(machine.DiedError, match="it was ended after 2 s"):
        machine.run(boots_from, ["any"], time_limit=2)
