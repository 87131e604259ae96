"""Worlds from fixed seeds: days in which much goes wrong, and nothing may stay wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.simulation.world import Violation, World

if TYPE_CHECKING:
    from tests.simulation.conftest import Play

DAYS = {
    1: 0.2,
    3: 0.4,
    5: 0.35,
    6: 0.4,
    8: 0.2,
    58: 0.02,
}
"""Simulated days by seed: robots that are used now and then (3, 6) or all the time (1, 5), a world where something
happens every few seconds (8), and many robots on one server (58)."""

BEGINNINGS = {
    3: 0.02,
    8: 0.01,
    58: 0.002,
}
"""What `make test` plays of these worlds."""


@pytest.mark.parametrize(
    ("seed", "days"), [*BEGINNINGS.items(), *(pytest.param(*each, marks=pytest.mark.long) for each in DAYS.items())]
)
def test_nothing_stays_wrong(seed: int, days: float, play: Play) -> None:
    """Every invariant holds all along."""
    world = World(seed)
    try:
        play(world, days * 86_400)
    except Violation as violation:
        pytest.fail(f"{violation}\nsee it again: {world.command()}", pytrace=False)


def test_a_day_and_a_half_is_played() -> None:
    """`make test-all` plays at least a day and a half of such worlds."""
    assert sum(DAYS.values()) >= 1.5


def test_a_seed_is_a_world() -> None:
    """The same seed gives the same world, to the microsecond, in another process with another hash seed, too."""
    told = [played(hash_seed) for hash_seed in ("1", "2")]
    assert told[0] == told[1]


def played(hash_seed: str) -> str:
    """Return the command's output for a world, without the CPU time."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.simulation", "4", "--days", "0.005"],
        cwd=Path(__file__).parents[2],
        env={"PYTHONHASHSEED": hash_seed, "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.rpartition("\n")[0].rpartition("\n")[0]
