"""A way that takes seconds: both sides say that messages are late, and no longer than that lasts."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from tests.simulation.beds import until
from tests.simulation.conditions import STILL
from tests.simulation.episodes import delayed
from tests.simulation.invariants import route_of
from tests.simulation.topic_flow import LATE
from tests.simulation.world import World

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

_SAID_WITHIN, _OVER_WITHIN = 5.0, 8.0


@pytest.mark.parametrize(
    ("seed", "protocol", "direction"),
    [(1, "tcp", "transmit"), (2, "tcp", "receive"), (12, "udp", "transmit"), (7, "udp", "receive")],
)
def test_both_sides_say_that_messages_are_late(seed: int, protocol: str, direction: str) -> None:
    """Within 5 s of the first message that comes out late; and both are content again 8 s after the way is fast."""
    world = World(seed, replace(STILL, checks=(1.0, 1.0)))
    (robot,) = world.robots
    (flow,) = robot.topic_flows
    assert (flow.topic.protocol, flow.topic.direction) == (protocol, direction), "the seed's topic is another one"
    said: dict[bool, float] = {}
    content: dict[bool, float] = {}

    def states() -> dict[bool, tuple[State, str]]:
        found = {}
        for link in world.link_ends(robot) or ():
            route = route_of(link, flow)
            if route is not None:
                verdict = route.judged.shown(route.verdict()).verdict
                found[link.is_client] = verdict.state, verdict.cause
        return found

    async def watch() -> None:
        while True:
            await asyncio.sleep(0.1)
            now = world.loop.time()
            for side, (state, cause) in states().items():
                if flow.late and (state, cause) == (State.LATE, Cause.LATE):
                    said.setdefault(side, now - flow.late_since)
                elif said and not flow.late and state is State.OK:
                    content.setdefault(side, now)

    async def live() -> None:
        watching = asyncio.ensure_future(watch())
        await delayed(world, 60.0)
        mended_at = world.loop.time()
        await asyncio.sleep(30.0)
        watching.cancel()
        assert flow.oldest > LATE
        assert set(said) == {True, False}, said
        assert max(said.values()) <= _SAID_WITHIN, said
        assert set(content) == {True, False}, content
        assert max(content.values()) - mended_at <= _OVER_WITHIN, (content, mended_at)

    world.play(life=live())


def test_link_comes_up_over_way_of_two_seconds() -> None:
    """And stays up: a packet's answer takes almost as long as a peer may be silent."""
    world = World(1, STILL)
    (robot,) = world.robots
    for path in world.network.both_ways(robot.host.machine, world.server.machine):
        path.latency = (2.0, 2.01)

    async def live() -> None:
        with world.trouble("delayed", robot):
            await until(lambda: (ends := world.link_ends(robot)) and all(link.linked for link in ends), 15.0)
            await asyncio.sleep(30.0)
            assert [link.connections for link in world.link_ends(robot) or ()] == [1, 1]

    world.play(life=live())
