"""An engine that operators attach to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.operators import Reachable

if TYPE_CHECKING:
    from tests.support.control import Machine


@pytest.fixture
def reachable(machine: Machine) -> Reachable:
    return Reachable(machine)
