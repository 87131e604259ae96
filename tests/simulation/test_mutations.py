"""The simulation finds mistakes that are put back on purpose, each within its budget of simulated time."""

from __future__ import annotations

import pytest
from tests.simulation.mutations import MUTATIONS, Mutation
from tests.simulation.world import Violation, World


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_it_is_found(mutation: Mutation) -> None:
    world = World(mutation.seed, mutation.conditions)
    doings = [mutation.doing(world)] if mutation.doing else []
    with mutation.made(), pytest.raises(Violation, match=mutation.finds):
        world.play(mutation.hours * 3600, *doings)
