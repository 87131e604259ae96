"""Runs tests that are coroutines in simulated time.

A coroutine that is a test lives in the world of its *bed*, a fixture: `harness`, `court`, `yard` or `edits`. The marker
`bed` has the arguments that the bed is made of. The world's nodes and engines start before the test, and the world ends
with it.
"""

from __future__ import annotations

from typing import Any

import pytest
from tests.simulation.beds import Bed, Yard
from tests.simulation.call_harness import CallHarness
from tests.support.coroutines import arguments_of

_PARAMETERS = ("seed", "provider", "lister", "direction")
"""Of a test, and of its bed."""


def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine in the world of its bed."""
    if (given := arguments_of(pyfuncitem)) is None:
        return None
    bed = next(each for each in given.values() if isinstance(each, Bed))
    bed.world.play(life=bed.live(pyfuncitem.obj(**given)))
    return True


@pytest.fixture
def harness(request: pytest.FixtureRequest) -> CallHarness:
    return CallHarness(**bed_of(request))


@pytest.fixture
def yard(request: pytest.FixtureRequest) -> Yard:
    marker = request.node.get_closest_marker("bed")
    return Yard(*marker.args, **marker.kwargs) if marker is not None else Yard()


def bed_of(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Return the arguments that a test's marker `bed`, and its parameters, have for its bed."""
    marker = request.node.get_closest_marker("bed")
    given = {name: request.getfixturevalue(name) for name in _PARAMETERS if name in request.fixturenames}
    return given | (marker.kwargs if marker is not None else {})
