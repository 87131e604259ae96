"""What is made to happen in a world: waits that no test could wait for, and courses of events that are rare."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING
from unittest.mock import patch

from tests.simulation import station

from rsb_bridge import bridge
from rsb_bridge.link import graph_watch, keepalive
from rsb_bridge.route import route

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.simulation.world import World


async def server_away(world: World, seconds: float, *, machine: bool) -> None:
    """The server goes, and comes back.

    Args:
        world: in which.
        seconds: for how long.
        machine: whether its machine is off, so that nobody even refuses.
    """
    await asyncio.sleep(60.0)
    with world.trouble("server away", *world.robots):
        if machine:
            world.server.power_off()
        else:
            world.server.kill()
        await asyncio.sleep(seconds)
        if machine:
            world.server.machine.power_on()
        world.server.start()


async def server_restarts(world: World, times: int) -> None:
    """The server is stopped as an operator does it, and started again."""
    for _ in range(times):
        await asyncio.sleep(60.0)
        with world.trouble("server stopped", *world.robots):
            await world.server.stop()
            await asyncio.sleep(10.0)
            world.server.start()


async def client_restarts(world: World, times: int) -> None:
    """A robot's engine is stopped as an operator does it, and started again."""
    robot = world.robots[0]
    for _ in range(times):
        await asyncio.sleep(60.0)
        with world.trouble("client stopped", robot):
            await robot.station.stop()
            await asyncio.sleep(10.0)
            robot.station.start()


async def type_differs_for(world: World, seconds: float) -> None:
    """The two sides disagree on what a type is from the beginning, so that its topic is refused; then they agree."""
    flow = world.robots[0].flows[0]
    with world.flow_trouble(flow, "type differs"):
        flow.update_sink(1)
        await asyncio.sleep(seconds)
        flow.update_sink(0)


async def restarted_while_cut(world: World) -> None:
    """A robot's network comes and goes, and its engine is killed and started again around that."""
    random = world.random("restarts")
    robot = world.robots[0]
    ends = robot.station.machine, world.server.machine
    with world.trouble("restarted while cut", robot):
        while True:
            await asyncio.sleep(random.uniform(1.0, 6.0))
            world.network.cut(*ends)
            if random.random() < 0.2:
                robot.station.kill()
                await asyncio.sleep(random.uniform(0.0, 2.0))
                robot.station.start()
            await asyncio.sleep(random.uniform(0.0, 8.0))
            world.network.heal(*ends)


@contextlib.contextmanager
def slow_motion(tick: float) -> Iterator[None]:
    """Have engines do every `tick` s what they do once a second, and ask for what was refused no more often than that.

    A month of pings, answers, reports and refusals alone would take ten minutes, and is none of what a month is about.
    """
    slower = {
        (bridge, "_TICK"): tick,
        (station, "_SNAPSHOT_EVERY"): tick,
        (graph_watch, "_ALWAYS_AFTER"): tick,
        (keepalive, "DEAD_AFTER"): 5 * tick,
        (route, "_LONGEST_PAUSE"): tick,
    }
    with contextlib.ExitStack() as stack:
        for (module, name), seconds in slower.items():
            stack.enter_context(patch.object(module, name, seconds))
        yield
