"""Both ends of an action, in the domains of a bridge's two sides, and fixtures of tests on virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.offline import loop, make_context

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.domain import Domain
    from tests.support.fibonacci import FibonacciClient, FibonacciServer

__all__ = ["loop", "make_context"]


@pytest.fixture(autouse=True)
def _answers_take_their_time() -> Iterator[None]:
    """A slow machine may need more than the 5 s that an operator waits: no test here is about that deadline."""
    with pytest.MonkeyPatch.context() as patch:
        constants.RESTART_WITHIN.set(patch, 60.0)
        constants.QUESTION_ANSWERED_WITHIN.set(patch, 60.0)
        constants.ARMING_ANSWERED_WITHIN.set(patch, 25.0)
        yield


@pytest.fixture
def server(robot: Domain) -> Iterator[FibonacciServer]:
    """The robot's."""
    from tests.support.fibonacci import FibonacciServer

    made = FibonacciServer(robot.id)
    yield made
    made.close()


@pytest.fixture
def client(pc: Domain) -> Iterator[FibonacciClient]:
    """The control PC's."""
    from tests.support.fibonacci import FibonacciClient

    made = FibonacciClient(pc.id)
    yield made
    made.close()
