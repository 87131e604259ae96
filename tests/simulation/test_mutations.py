"""The simulation finds mistakes that are put back on purpose, each within its budget of simulated time."""

from __future__ import annotations

import pytest
from tests.simulation.mutations import MUTATIONS, Mutation
from tests.simulation.world import Violation, World

_SEEDS = range(1, 7)


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_it_is_found(mutation: Mutation) -> None:
    """One of the first worlds in which it is made ends with a violation that names it."""
    for seed in _SEEDS:
        world = World(seed, mutation.climate)
        doings = [mutation.doing(world)] if mutation.doing else []
        try:
            with mutation.made():
                world.play(mutation.hours * 3600, *doings)
        except Violation as violation:
            if mutation.finds in str(violation):
                return
            raise
    pytest.fail(f"{len(_SEEDS)} worlds have lived for {mutation.hours:g} h, and nothing was wrong")
