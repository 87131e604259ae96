"""Large messages by UDP between two machines whose kernels keep little."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.simulation.conditions import STILL
from tests.simulation.world import World

from rsb_bridge.channel.datagram_channel import DatagramSender
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.simulation.engine_host import EngineHost
    from tests.simulation.topic_flow import TopicFlow

_DEBIAN = 212_992
"""Bytes: net.core.rmem_max of most distributions."""
_ENOUGH = 8 << 20


def datagrams(receive_buffer: int) -> tuple[World, TopicFlow]:
    """A world in which a robot's topic crosses by UDP to a server whose kernel keeps so many bytes."""
    world = World(1, replace(STILL, topics=(0,), periods=(1e9, 1e9)))
    (robot,) = world.robots
    topic = Topic("/cloud", "transmit", protocol="udp")
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=(topic,))
    flow = world.add_topic_flow(robot, topic, world.random("flow"))
    world.server.machine.receive_buffer = receive_buffer
    for path in world.network.both_ways(robot.host.machine, world.server.machine):
        path.latency, path.mtu = (0.0002, 0.0002), 9000
    return world, flow


async def sent(flow: TopicFlow, count: int, size: int, every: float) -> None:
    """Publish messages of some bytes on average, and see that all come out."""
    heard, flow.size = flow.heard, size
    for _ in range(count):
        flow.publish()
        await asyncio.sleep(every)
    await asyncio.sleep(2.0)
    assert flow.heard == heard + count


def told(host: EngineHost) -> list[str]:
    assert host.run is not None
    return [event.text for event in host.run.events.after(0) if event.code == EventCode.LINK_UDP_BUFFER]


@pytest.mark.parametrize("receive_buffer", [_DEBIAN, _ENOUGH])
def test_large_messages_arrive_whatever_the_kernel_keeps(receive_buffer: int) -> None:
    """Both sides say once where a kernel's limit is too small, with what to run there."""
    world, flow = datagrams(receive_buffer)

    async def live() -> None:
        await asyncio.sleep(20.0)
        await sent(flow, 20, 1_000_000, 0.2)
        for host, where in ((world.server, "here"), (world.robots[0].host, "there")):
            if receive_buffer == _DEBIAN:
                (text,) = told(host)
                assert f"Run {where}: sudo sysctl -w net.core.rmem_max=8388608" in text
            else:
                assert not told(host)

    world.play(life=live())


def test_a_limit_that_is_raised_counts_at_once() -> None:
    world, flow = datagrams(_DEBIAN)

    def window() -> int:
        run = world.robots[0].host.run
        assert run is not None
        (half,) = [route.half for route in run.links()[0].routes.values()]
        assert isinstance(half.carried.channel, DatagramSender)
        return half.carried.channel.via.pacer.window

    async def live() -> None:
        await asyncio.sleep(20.0)
        await sent(flow, 2, 1_000_000, 0.2)
        assert window() <= _DEBIAN
        world.server.machine.receive_buffer = _ENOUGH
        await asyncio.sleep(2.0)
        await sent(flow, 20, 1_000_000, 0.2)
        assert window() > _DEBIAN

    world.play(life=live())


def test_small_messages_need_no_large_buffer() -> None:
    world, flow = datagrams(_DEBIAN)

    async def live() -> None:
        await asyncio.sleep(20.0)
        await sent(flow, 1000, 2_500, 0.002)
        assert not told(world.server)
        assert not told(world.robots[0].host)

    world.play(life=live())
