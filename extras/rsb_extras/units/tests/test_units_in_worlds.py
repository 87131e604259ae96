"""Actions on units in simulated worlds: each that was answered ran once, none twice, and none that was refused."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.simulation.asking import Asking
from tests.simulation.conditions import STILL
from tests.simulation.world import World
from tests.support.long import long

from rsb_bridge.feature import MAY
from rsb_extras.units import UNITS, ListedUnit
from rsb_extras.units.link_units import LinkUnits, RunUnit
from rsb_extras.units.tests.supervised import may
from rsb_extras.units.tests.units_places import ARMED, EXECUTE
from rsb_extras.units.unit_process import CommandEnd
from rsb_extras.units.unit_runner import STARTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_extras.units.unit_runner import UnitRunner

NAV = ListedUnit(restart=("restart",), status=("status",))


@pytest.mark.parametrize("outlive", [0.0, 60.0])
@pytest.mark.parametrize("seed", [1, *long(2, 3, 4, 5, 6)])
def test_an_action_runs_once(seed: int, outlive: float, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(seed, replace(STILL, faults=40.0, moves=40.0, outlive=outlive))
    (robot,) = world.robots
    features = {UNITS.name: {"nav": NAV}, MAY: may("nav")}
    robot.host.session = msgspec.structs.replace(robot.host.session, features=features)
    asking = Asking(world, lambda link: link.extensions.find(LinkUnits).give(RunUnit("nav", "restart")), STARTS)

    async def execute(runner: UnitRunner, words: Sequence[str], *_: object) -> CommandEnd:
        if words == NAV.restart:
            await asking.run(runner)
        return CommandEnd(0)

    EXECUTE.set(monkeypatch, execute)
    ARMED.set(monkeypatch, lambda *_: "/cmd_vel" if asking.armed else "")
    world.play(seconds=1e6, life=asking.live(60))
    assert asking.answers["ran"] > 5
