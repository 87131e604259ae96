"""Late joiners on the far side get the last message of a latched topic, through all faults."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.simulation.conditions import STILL
from tests.simulation.world import World
from tests.support.long import long

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from tests.simulation.topic_flow import TopicFlow

    from rsb_bridge.model.transports import Protocol

_BURST = 7


def latched_world(seed: int, protocol: Protocol, max_rate: float | None, *, numbers: bool) -> tuple[World, TopicFlow]:
    """A world with one latched topic, of which one message is kept and only a test publishes."""
    world = World(seed, replace(STILL, periods=(1e9, 1e9)))
    world.invariants.check = lambda: None  # type: ignore[method-assign]  # they count what a probe of the depth takes
    (robot,), (flow,) = world.robots, world.topic_flows.values()
    topic = msgspec.structs.replace(
        flow.topic, protocol=protocol, port=None, qos="auto", max_rate=max_rate, paused=False
    )
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=(topic,))
    flow.topic, flow.qos, flow.period = topic, Qos(durability="transient_local", depth=1), 1e9
    flow.near.numbers = numbers
    return world, flow


@pytest.mark.parametrize("numbers", [True, False])
@pytest.mark.parametrize("seed", [1, *long(2, 3, 4, 5)])
def test_a_burst_that_is_reordered(seed: int, numbers: bool) -> None:
    """Datagrams overtake each other; an older message never takes the place of a newer one."""
    world, flow = latched_world(seed, "udp", None, numbers=numbers)

    async def burst() -> None:
        await asyncio.sleep(30.0)
        for path in world.network.both_ways(world.robots[0].host.machine, world.server.machine):
            path.latency = (0.01, 0.4)
        for _ in range(_BURST):
            flow.publish()
            await asyncio.sleep(0.02)
        await asyncio.sleep(10.0)
        flow.listen()
        await asyncio.sleep(5.0)
        assert max(flow.newest.values()) == flow.sent

    world.play(life=burst())


@pytest.mark.parametrize("seed", [1, *long(2, 3)])
def test_a_burst_that_is_throttled(seed: int) -> None:
    """The last message comes as soon as the limit allows, though nothing follows it; the others are left out."""
    world, flow = latched_world(seed, "tcp", 1.0, numbers=True)

    async def burst() -> None:
        await asyncio.sleep(30.0)
        for _ in range(_BURST):
            flow.publish()
            await asyncio.sleep(0.1)
        await asyncio.sleep(1.5)
        assert max(flow.newest.values()) == flow.sent
        assert flow.heard <= 4

    world.play(life=burst())


def test_the_last_publisher_has_gone() -> None:
    """Late joiners on the far side then get nothing, like those on the near side."""
    world, flow = latched_world(1, "tcp", None, numbers=False)

    async def vanish() -> None:
        await asyncio.sleep(30.0)
        flow.publish()
        await asyncio.sleep(5.0)
        assert list(flow.newest.values()) == [flow.sent]
        flow.vanish()
        await asyncio.sleep(60.0)
        flow.newest.clear()
        flow.listen()
        await asyncio.sleep(5.0)
        assert not flow.newest

    world.play(life=vanish())
