"""Tests that are coroutines, on a real loop or in simulated time."""

from __future__ import annotations

from random import Random

import pytest
from tests.simulation.loop import SimulatedLoop
from tests.support.coroutines import pytest_pyfunc_call

__all__ = ["loop", "pytest_pyfunc_call"]


@pytest.fixture
def loop() -> SimulatedLoop:
    return SimulatedLoop(Random(0))  # type: ignore[abstract]  # what is not simulated raises
