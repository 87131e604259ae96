"""Helpers of `test_fleet_command` and others."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import pytest
from tests.support.fleet import ServerEngine
from tests.support.waiting import eventually

from rsb_extras.fleet.tests import fleet_places
from rsb_extras.fleet.tests.scripted_fleet import state_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.commands import Ran
    from tests.support.control import Machine

    from rsb_bridge.model.robot_summary import RobotSummary
    from rsb_extras.fleet.server_source import ServerFleet

Fleet: TypeAlias = "Callable[..., Ran]"


@pytest.fixture
def fleet(ran: Fleet, machine: Machine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Fleet:
    robots: Callable[[ServerFleet], list[RobotSummary]] = fleet_places.ROBOTS.value

    def newest(source: ServerFleet) -> list[RobotSummary]:
        """Look once the last edit shows, up to 0.25 s later: to the program, which waits for 10 s, that is nothing."""
        edited = [each for each in machine.engines if isinstance(each, ServerEngine)]
        if edited and not source.problem:
            eventually(lambda: state_of(source).time == edited[-1].now.time)
        return robots(source)

    fleet_places.ROBOTS.set(monkeypatch, newest)
    monkeypatch.setenv("RSB_CONSOLE_ISOLATED", "1")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return partial(ran, "fleet")
