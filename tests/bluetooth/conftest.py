"""The VM, as a fixture; what is in `guest` is collected only in the VM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from tests.bluetooth.vm import debian, layers, machine

Run = Callable[[Sequence[str]], machine.Outcome]

_IN_THE_MACHINE = Path("/project").resolve() == Path(__file__).resolve().parents[2] and Path("/modules/order").exists()

collect_ignore = [] if _IN_THE_MACHINE else ["guest"]


@pytest.fixture(scope="session")
def boots_from() -> layers.Layers:
    """What the machine boots from, made or from the cache; without it the tests are skipped, and say why."""
    try:
        return layers.prepare()
    except debian.UnavailableError as error:
        pytest.skip(f"no Bluetooth test machine: {error}")


@pytest.fixture(scope="session")
def run(boots_from: layers.Layers) -> Run:
    """Run pytest with these arguments in the machine."""
    return lambda selection: machine.run(boots_from, selection)
