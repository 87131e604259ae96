"""Worlds from fixed seeds: days in which much goes wrong, and nothing may stay wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.simulation.world import Violation, World

DAYS = {1: 0.2, 3: 0.4, 5: 0.35, 6: 0.4, 8: 0.2, 58: 0.02}
"""Simulated days by seed: robots that are used now and then (3, 6) or all the time (1, 5), a world where something
happens every few seconds (8), and many robots on one server (58)."""

BEGINNINGS = {3: 0.02, 8: 0.01, 58: 0.002}
"""What `make test` plays of these worlds."""


@pytest.mark.parametrize(
    ("seed", "days"), [*BEGINNINGS.items(), *(pytest.param(*each, marks=pytest.mark.long) for each in DAYS.items())]
)
def test_nothing_stays_wrong(seed: int, days: float) -> None:
    world = World(seed)
    try:
        world.play(days * 86_400)
    except Violation as violation:
        pytest.fail(f"{violation}\nsee it again: {world.command()}", pytrace=False)


def test_a_seed_is_a_world() -> None:
    """The same seed gives the same world, to the microsecond, in another process with another hash seed, too."""
    world = World(4)
    world.play(0.005 * 86_400)
    done = subprocess.run(
        [sys.executable, "-m", "tests.simulation", "4", "--days", "0.005"],
        cwd=Path(__file__).parents[2],
        env={"PYTHONHASHSEED": "1", "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(world.summary())
