"""A side that stops says goodbye, and the log of the other one says no more than that."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import replace

import pytest
from tests.simulation.conditions import STILL
from tests.simulation.episodes import client_restarts, server_restarts
from tests.simulation.world import World
from tests.support.long import long

from rsb_bridge.model.codes import EventCode

_TIMES = 3
_CONDITIONS = replace(STILL, topics=(8,), periods=(0.5, 2.0))


@pytest.mark.parametrize("restarts", [client_restarts, *long(server_restarts)])
@pytest.mark.parametrize("seed", [3, *long(1, 2)])
def test_goodbye_ends_topics_streams_without_error(
    seed: int, restarts: Callable[[World, int], Coroutine[None, None, None]]
) -> None:
    """The connection of the goodbye may end before or after the TCP topics' connections."""
    world = World(seed, _CONDITIONS)
    world.play(life=restarts(world, _TIMES))
    assert any(flow.topic.protocol == "tcp" for flow in world.topic_flows.values())
    assert world.log.events[EventCode.LINK_CLOSED_BY_PEER] >= _TIMES
    assert not world.log.events[EventCode.ROUTE_CHANNEL_LOST]
