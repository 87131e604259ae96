"""Helpers of `test_servers` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.fleet import ServerEngine

from rsb_extras.fleet.server_source import RobotEngine, ServerFleet

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.control import Machine


@pytest.fixture
def engine(machine: Machine) -> ServerEngine:
    return machine.have(ServerEngine("robot1", "robot2", "robot3"))


@pytest.fixture
def fleet(machine: Machine, engine: ServerEngine) -> Iterator[ServerFleet]:
    source = ServerFleet("control", machine.folder / "control.sock")
    source.start()
    yield source
    source.stop()


@pytest.fixture
def robot2(fleet: ServerFleet) -> Iterator[RobotEngine]:
    """The engine as far as it concerns robot2."""
    opened = fleet.open("robot2", read_only=False)
    assert isinstance(opened, RobotEngine)
    yield opened
    opened.stop()
