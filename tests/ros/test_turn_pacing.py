"""Turns of the ROS thread part while there are many."""

from __future__ import annotations

from random import Random

import pytest

from rsb_bridge.model.limits import APART
from rsb_bridge.ros.turn_pacing import TurnPacing


def turns_of(pacing: TurnPacing, rate: float, seconds: float = 20.0) -> list[float]:
    """Return how long (s) each turn rested, of messages that come by chance at `rate` (Hz)."""
    chance, now, rests = Random(1), 0.0, []
    arrival = 0.0
    while arrival < seconds:
        arrival += chance.expovariate(rate)
        if arrival <= now:  # the turn before has taken it
            continue
        rest = pacing.rest(arrival)
        now = arrival + rest
        rests.append(rest)
        pacing.turned(now)
    return rests


@pytest.mark.parametrize("rate", [1.0, 20.0, 100.0])
def test_few_messages_do_not_wait(rate: float) -> None:
    rests = turns_of(TurnPacing(), rate)
    assert sum(rests) / len(rests) < 0.1 * APART


@pytest.mark.parametrize("longest", [APART, 0.02])
@pytest.mark.parametrize("rate", [1000.0, 20_000.0])
def test_many_messages_share_turns(rate: float, longest: float) -> None:
    pacing = TurnPacing()
    pacing.longest = longest
    rests = turns_of(pacing, rate)
    assert len(rests) < 20.0 / longest * 1.1
    assert max(rests) <= longest


def test_it_is_over_with_the_rush() -> None:
    pacing = TurnPacing()
    turns_of(pacing, 1000.0)
    for now in range(100, 110):
        pacing.turned(float(now))
    assert pacing.rest(109.0) == 0.0


def test_nothing_waits_without_a_pace() -> None:
    pacing = TurnPacing()
    pacing.longest = 0.0
    assert max(turns_of(pacing, 1000.0)) == 0.0
