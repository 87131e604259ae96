"""Waits that no test could wait for."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.simulation.conditions import STILL
from tests.simulation.episodes import server_away, slow_motion, type_differs_for
from tests.simulation.world import World

from rsb_bridge.model.codes import EventCode

_DAY = 86_400.0
_TICK = 600.0
"""s from one round of the engines' regular work to the next; calls keep their pace."""
_SLOW = replace(STILL, checks=(_TICK, _TICK), patience=_TICK)


@pytest.mark.long
def test_a_server_that_is_away_for_two_days() -> None:
    """Its clients call for all that time, and are linked soon after it is back."""
    world = World(1, _SLOW)
    with slow_motion(_TICK):
        world.play(2.1 * _DAY, server_away(world, 2 * _DAY, machine=True))
    assert world.log.events[EventCode.LINK_UNREACHABLE] > 28_000
    assert world.invariants.worst_recovery <= _TICK  # when it is looked at next


@pytest.mark.long
def test_a_topic_that_is_refused_for_a_month() -> None:
    """It is asked for all that time, and flows soon after the reason is gone."""
    world = World(1, _SLOW)
    (flow,) = world.topic_flows.values()
    with slow_motion(_TICK):
        world.play(30.5 * _DAY, type_differs_for(world, 30 * _DAY))
    assert flow.heard
