"""Changes of nodes in simulated worlds: each that was answered was made once, none twice, and none that was refused."""

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
from rsb_bridge.model.session import session_keys
from rsb_extras.node_control.link_changes import LinkChanges, RunChange
from rsb_extras.node_control.node_changer import STARTS
from rsb_extras.node_control.tests.control_places import ARMED, WORK

if TYPE_CHECKING:
    from rsb_extras.node_control.node_changer import NodeChanger


@pytest.mark.parametrize("outlive", [0.0, 60.0])
@pytest.mark.parametrize("seed", [1, *long(2, 3, 4, 5, 6)])
def test_a_change_is_made_once(seed: int, outlive: float, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(seed, replace(STILL, faults=40.0, moves=40.0, outlive=outlive))
    (robot,) = world.robots
    features = {MAY: session_keys()[MAY].type(nodes=("/lidar",))}
    robot.host.session = msgspec.structs.replace(robot.host.session, features=features)
    asking = Asking(
        world, lambda link: link.extensions.find(LinkChanges).give(RunChange("/lidar", "configure")), STARTS
    )

    async def work(changer: NodeChanger, *_: object) -> str:
        await asking.run(changer)
        return ""

    WORK.set(monkeypatch, work)
    ARMED.set(monkeypatch, lambda *_: "/cmd_vel" if asking.armed else "")
    world.play(seconds=1e6, life=asking.live(60))
    assert asking.answers["ran"] > 5
