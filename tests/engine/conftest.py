"""Surroundings of engines: both ends of an action, consoles; and fixtures of tests on virtual time."""

from __future__ import annotations

import sys
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.long_lease import lengthen_lease
from tests.support.offline import loop, make_context

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
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
def long_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    """Topics stay armed while a busy machine stands still for more than a second."""
    lengthen_lease(monkeypatch)


@pytest.fixture
def threads_change_often() -> Iterator[None]:
    """At nearly every bytecode."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.fixture
def consoles() -> Iterator[Consoles]:
    """Consoles that give signs of life."""
    from tests.support.consoles import Consoles

    with closing(Consoles()) as made:
        yield made


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, _robot_domain: Domain, _pc_domain: Domain) -> Iterator[Bridge]:
    """Makes engines that serve all tests of a file."""
    from tests.support.bridge import Bridge

    with closing(Bridge(tmp_path_factory.mktemp("shared"), _robot_domain, _pc_domain)) as made:
        yield made


@pytest.fixture
def server(robot: Domain) -> Iterator[FibonacciServer]:
    """The robot's."""
    from tests.support.fibonacci import FibonacciServer

    with closing(FibonacciServer(robot.id)) as made:
        yield made


@pytest.fixture
def client(pc: Domain) -> Iterator[FibonacciClient]:
    """The control PC's."""
    from tests.support.fibonacci import FibonacciClient

    with closing(FibonacciClient(pc.id)) as made:
        yield made
