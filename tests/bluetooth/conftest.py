"""The VM, as a fixture; what is in `guest` is collected only in the VM."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
from tests.bluetooth.vm import debian, layers, machine

_PROBES = ["tests/bluetooth/guest/vm_probes.py"]
_GUEST = [f"tests/bluetooth/guest/test_{name}.py" for name in ("scan", "bridge", "rfcomm", "unplugged")]
"""The scan is first, while the adapters can pair: with traffic they cannot. They are unplugged last."""


class Outcomes(NamedTuple):
    """The results of the machine.

    Attributes:
        probes: of the tests that show how results come out of it.
        guest: for the tests of the bridge.
    """

    probes: machine.Outcome
    guest: machine.Outcome


_IN_THE_MACHINE = Path("/project").resolve() == Path(__file__).resolve().parents[2] and Path("/modules/order").exists()

collect_ignore = [] if _IN_THE_MACHINE else ["guest"]


@pytest.fixture(scope="session")
def boots_from() -> layers.Layers:
    """Return the layers that the machine boots from, made or from the cache; without them, skip the test with the
    reason.
    """
    try:
        return layers.prepare()
    except debian.UnavailableError as error:
        pytest.skip(f"no Bluetooth test machine: {error}")


@pytest.fixture(scope="session")
def outcomes(boots_from: layers.Layers) -> Outcomes:
    """One machine runs everything: to boot it takes as long as a quarter of its tests."""
    return Outcomes(*machine.run(boots_from, _PROBES, [*_GUEST, "-rP"]))
