"""Surroundings of bridges over Zenoh: those of all engines, and a router."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from tests.command.client_helpers import path
from tests.command.conftest import here, ran
from tests.engine.conftest import _answers_take_their_time, consoles, long_lease
from tests.link.strangers_helpers import arrived
from tests.network.conftest import _hosts_can_be_made
from tests.transport.conftest import loop, pytest_pyfunc_call

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.zenoh.tests.zenoh_router import Router

__all__ = [
    "_answers_take_their_time",
    "_hosts_can_be_made",
    "arrived",
    "consoles",
    "here",
    "long_lease",
    "loop",
    "path",
    "pytest_pyfunc_call",
    "ran",
]


@pytest.fixture
def router() -> Iterator[Router]:
    """A Zenoh router."""
    from rsb_extras.zenoh.tests.zenoh_router import Router

    with closing(Router()) as made:
        yield made
