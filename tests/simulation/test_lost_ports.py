"""An engine stops at a port in shared memory that DDS has lost, but only if it had time to follow its senders."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from unittest.mock import patch

from tests.simulation.conditions import STILL
from tests.simulation.world import World

from rsb_bridge.model.codes import EventCode
from rsb_bridge.ros.ros_interface import LostPort

_LOST = frozenset({LostPort("/dev/shm/fastrtps_port7410", 1)})
_FOLLOWS_AFTER = 3.0


async def stopped_at_looks(world: World) -> None:
    """Have a process lose its port, stop it at the next look, and have it follow some seconds after it goes on."""
    run = world.server.run
    assert run is not None
    looked, lost = asyncio.Event(), frozenset[LostPort]()

    def look() -> frozenset[LostPort]:
        looked.set()
        return lost

    with patch.object(run.node, "lost_ports", look):
        for seconds in (2.0, 9.0, 11.0, 25.0, 600.0):
            lost = _LOST
            looked.clear()
            await looked.wait()
            world.loop.freeze(run.process)
            await asyncio.sleep(seconds)
            world.loop.thaw(run.process, reads_first=False)
            await asyncio.sleep(_FOLLOWS_AFTER)
            lost = frozenset()
            await asyncio.sleep(30.0)


def test_stopped_process_has_time_to_follow() -> None:
    world = World(1, replace(STILL, checks=(1e9, 1e9)))
    world.play(life=stopped_at_looks(world))
    assert not world.log.events[EventCode.ENGINE_ROS_FAILED]
