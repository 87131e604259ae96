"""Worlds whose links outlive their connections: nothing stays wrong, and calls end only as they should."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from tests.simulation.conditions import ACTIONS, CALLS, KEEPING, LIVELY, STILL, STORM
from tests.simulation.episodes import connections_forgotten, delayed, tunnelled
from tests.simulation.world import Violation, World
from tests.support.long import long

from rsb_bridge.link.client_link import ClientLink
from rsb_bridge.link.link_session import LinkSession

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.simulation.conditions import Conditions

_SEEDS = (1, 2)
_BUSY = replace(CALLS, faults=10.0, commands=60.0)


@pytest.mark.parametrize("seed", [*_SEEDS, *long(*range(3, 12))])
@pytest.mark.parametrize("conditions", [LIVELY, STORM, _BUSY, ACTIONS, KEEPING], ids=lambda each: each.name)
def test_nothing_stays_wrong(conditions: Conditions, seed: int) -> None:
    world = World(seed, replace(conditions, outlive=conditions.outlive or 60.0, moves=conditions.faults, nights=0.0))
    with patch.object(LinkSession, "resume", autospec=True, side_effect=LinkSession.resume) as resumed:
        try:
            world.play(1800)
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert resumed.called or seed not in _SEEDS, "no link went on with its session"


@pytest.mark.parametrize("seed", [*_SEEDS, *long(*range(3, 12))])
def test_link_moves_from_connections_that_carry_nothing(seed: int) -> None:
    """Only the old ones carry nothing: another one is up before either side gives the link up."""
    world = World(seed, replace(LIVELY, outlive=60.0, nights=0.0, faults=0.0, commands=0.0))
    with (
        patch.object(LinkSession, "resume", autospec=True, side_effect=LinkSession.resume) as resumed,
        patch.object(LinkSession, "suspend", autospec=True, side_effect=LinkSession.suspend) as suspended,
    ):
        try:
            world.play(900, connections_forgotten(world))
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert resumed.call_count > 40
    assert not suspended.called


@pytest.mark.parametrize(
    "course",
    [lambda world: tunnelled(world, 300.0, 2_000.0, 60.0), lambda world: delayed(world, 300.0, 1.5)],
    ids=["tunnel of 2 kB/s", "round trip of 3 s"],
)
def test_link_stays_on_a_thin_or_slow_path(course: Callable[[World], Coroutine[None, None, None]]) -> None:
    """Its connection is doubted when the path gets so, at most, and not each second."""
    world = World(1, replace(STILL, outlive=60.0, topics=(2,)))
    with (
        patch.object(ClientLink, "_connect", autospec=True, side_effect=ClientLink._connect) as attempts,
        patch.object(LinkSession, "resume", autospec=True, side_effect=LinkSession.resume) as resumed,
    ):
        try:
            world.play(420.0, course(world))
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert attempts.call_count <= 4
    assert resumed.call_count <= 4
