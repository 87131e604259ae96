"""Fixtures of the tests that run the whole bridge. ROS is imported by those that ask for it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

_DOMAINS = 30 + os.getpid() % 15 * 2  # 30 to 59: two runs on one machine seldom meet


@pytest.fixture(scope="session")
def _robot_domain() -> Iterator[Domain]:
    yield from _domain(_DOMAINS)


@pytest.fixture(scope="session")
def _pc_domain() -> Iterator[Domain]:
    yield from _domain(_DOMAINS + 1)


def _domain(domain_id: int) -> Iterator[Domain]:
    from tests.support.domain import Domain

    domain = Domain(domain_id)
    yield domain
    domain.close()


@pytest.fixture
def robot(_robot_domain: Domain) -> Iterator[Domain]:
    """The client's domain."""
    yield _robot_domain
    _robot_domain.clear()


@pytest.fixture
def pc(_pc_domain: Domain) -> Iterator[Domain]:
    """The server's domain."""
    yield _pc_domain
    _pc_domain.clear()


@pytest.fixture
def bridge(tmp_path: Path, robot: Domain, pc: Domain) -> Iterator[Bridge]:
    """Makes engines, and stops them at the end."""
    from tests.support.bridge import Bridge

    made = Bridge(tmp_path, robot, pc)
    yield made
    made.close()
