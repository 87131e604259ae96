"""Worlds in which services are called and goals are sent all the time, and much goes wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.simulation.conditions import ACTIONS, CALLS
from tests.simulation.world import Violation, World
from tests.support.long import long

_HOURS = dict.fromkeys((1, 2, 3, 4), 0.3)
_OF_ACTIONS = {1: 0.35, 4: 0.5, 5: 0.35}


@pytest.mark.parametrize("seed", [2, *long(1, 3, 4)])
def test_every_answer_is_right_nothing_remains(seed: int) -> None:
    world = World(seed, CALLS if seed % 2 else replace(CALLS, faults=10.0, commands=60.0))
    try:
        world.play(_HOURS[seed] * 3600)
    except Violation as violation:
        pytest.fail(str(violation), pytrace=False)
    assert sum(service.answered for service in world.service_flows.values()) > 100


@pytest.mark.parametrize("seed", [1, *long(4, 5)])
def test_goals_outlive_whatever_goes_wrong(seed: int) -> None:
    world = World(seed, replace(ACTIONS, faults=20.0) if seed == 1 else ACTIONS)
    try:
        world.play(_OF_ACTIONS[seed] * 3600)
    except Violation as violation:
        pytest.fail(str(violation), pytrace=False)
    assert sum(action.answered for action in world.action_flows.values()) > 20
