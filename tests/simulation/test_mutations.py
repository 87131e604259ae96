"""The simulation finds mistakes that are put back on purpose, each within its budget of simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.simulation.mutations import MUTATIONS, Mutation
from tests.simulation.world import Violation, World

if TYPE_CHECKING:
    from tests.simulation.conftest import Play


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_it_is_found(mutation: Mutation, play: Play) -> None:
    """The world in which it is made ends with a violation that names it."""
    world = World(mutation.seed, mutation.conditions)
    doings = [mutation.doing(world)] if mutation.doing else []
    with mutation.made(), pytest.raises(Violation, match=mutation.finds):
        play(world, mutation.hours * 3600, *doings)
