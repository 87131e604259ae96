"""A tunnel that carries less than is published, and can hold minutes of it: messages arrive fresh."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.simulation.conditions import STILL
from tests.simulation.episodes import tunnelled
from tests.simulation.invariants import route_of
from tests.simulation.world import World
from tests.support.long import long


@pytest.mark.parametrize("topics", [3, *long(1)])
@pytest.mark.parametrize("speed", [2_000.0, 5_000.0, *long(50_000.0)])
def test_messages_stay_fresh(topics: int, speed: float) -> None:
    """Several topics and the link's own stream share the tunnel's one queue; the link stays up all the time."""
    world = World(1, replace(STILL, topics=(topics,)))
    (robot,) = world.robots

    async def live() -> None:
        await tunnelled(world, 120.0, speed, fresh_within=8.0 if speed > 2_000 else 15.0)
        here, there = world.link_ends(robot) or (None, None)
        assert here is not None
        assert there is not None
        assert (here.connections, there.connections) == (1, 1)
        for flow in robot.topic_flows:
            half = next(route for link in (here, there) if (route := route_of(link, flow)) and route.outgoing)
            ledger = half.snapshot().ledger
            parts = ledger.delivered + ledger.throttled + ledger.expired + ledger.dropped_total + ledger.open
            assert ledger.offered == parts
            assert ledger.throttled or ledger.delivered * flow.size > 0.5 * 120.0 * speed / topics

    world.play(life=live())
