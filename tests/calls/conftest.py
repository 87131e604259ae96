"""Nodes on both sides: callers in the client's domain, servers in the server's, each in a process of its own."""

from __future__ import annotations

import itertools
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.calls import CallNode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.domain import Domain
    from tests.support.spun import Spun

_numbers = itertools.count()


@pytest.fixture(scope="session")
def _near(_robot_domain: object, _domains: int) -> Iterator[CallNode]:
    with closing(CallNode(_domains)) as made:
        yield made


@pytest.fixture(scope="session")
def _far(_pc_domain: object, _domains: int) -> Iterator[CallNode]:
    with closing(CallNode(_domains + 1)) as made:
        yield made


@pytest.fixture
def near(_near: CallNode) -> Iterator[CallNode]:
    """Start nodes in the client's domain."""
    yield _near
    _near.clear()


@pytest.fixture
def far(_far: CallNode) -> Iterator[CallNode]:
    """Start nodes in the server's domain."""
    yield _far
    _far.clear()


@pytest.fixture
def another() -> Iterator[Callable[[int], CallNode]]:
    """Begins further nodes, by domain."""
    made: list[CallNode] = []

    def begin(domain_id: int) -> CallNode:
        made.append(CallNode(domain_id))
        return made[-1]

    yield begin
    for node in made:
        node.close()


@pytest.fixture
def start() -> Iterator[Callable[..., Spun]]:
    """Starts stock nodes in this process."""
    from tests.support.spun import Spun

    made: list[Spun] = []

    def begin(domain: Domain, name: str, **how: Any) -> Spun:
        made.append(Spun(domain.id, name, **how))
        return made[-1]

    yield begin
    for each in made:
        each.close()


@pytest.fixture
def service() -> str:
    """A name that no other test has: DDS may still see the servers of that one."""
    return f"/map{next(_numbers)}"
