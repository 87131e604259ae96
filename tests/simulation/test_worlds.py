"""Worlds from fixed seeds: days in which much goes wrong, and nothing may stay wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.simulation.world import Violation, World

HOURS = {
    1: 2.0,
    2: 2.0,
    3: 4.0,
    6: 6.0,
    8: 1.0,
}
"""Simulated hours by seed."""


@pytest.mark.parametrize("seed", HOURS)
def test_nothing_stays_wrong(seed: int) -> None:
    """Every invariant holds all along, whatever happens."""
    play(World(seed), HOURS[seed])


def test_a_seed_is_a_world() -> None:
    """The same seed gives the same world, to the microsecond, in another process with another hash seed, too."""
    told = [played(hash_seed) for hash_seed in ("1", "2")]
    assert told[0] == told[1]


def play(world: World, hours: float) -> None:
    """Let a world live; a failure says how to see it again."""
    try:
        world.play(hours * 3600)
    except Violation as violation:
        days = world.loop.time() / 86_400 + 0.001
        pytest.fail(
            f"{violation}\nsee it again: python -m tests.simulation {world.seed} --days {days:.3f}", pytrace=False
        )


def played(hash_seed: str) -> str:
    """What the command says of a world, without the CPU time."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.simulation", "4", "--days", "0.01"],
        cwd=Path(__file__).parents[2],
        env={"PYTHONHASHSEED": hash_seed, "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.rpartition("\n")[0].rpartition("\n")[0]
