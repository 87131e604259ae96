"""Fixtures of bridges and of a program with nodes."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from tests.engine.conftest import _answers_take_their_time, long_lease

from rsb_extras.mirrored_nodes.tests.far_program import FarProgram

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.domain import Domain

__all__ = ["_answers_take_their_time", "long_lease"]


@pytest.fixture
def far(robot: Domain) -> Iterator[FarProgram]:
    with closing(FarProgram(robot.id)) as made:
        yield made
