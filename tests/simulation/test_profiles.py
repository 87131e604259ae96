"""A gap between two cells of a phone network costs no connection under the profile `lte`."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.simulation.conditions import STILL
from tests.simulation.world import World

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from rsb_bridge.model.transports import ProfileName

_GAP = 9.0


@pytest.mark.parametrize(("profile", "connections"), [(None, 2), ("lte", 1)])
def test_a_gap(profile: ProfileName | None, connections: int) -> None:
    world = World(1, STILL)
    (robot,) = world.robots
    for host in (robot.host, world.server):
        host.session = msgspec.structs.replace(host.session, profile=profile)

    async def live() -> None:
        await asyncio.sleep(20.0)
        with world.trouble("gap", robot):
            world.network.cut(robot.host.machine, world.server.machine)
            await asyncio.sleep(_GAP)
            world.network.heal(robot.host.machine, world.server.machine)
            await asyncio.sleep(20.0)
        assert world.log.events[EventCode.LINK_UP] == 2 * connections

    world.play(life=live())
