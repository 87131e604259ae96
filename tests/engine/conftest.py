"""Both ends of an action, beside the two sides of a bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.domain import Domain
    from tests.support.fibonacci import FibonacciClient, FibonacciServer


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
