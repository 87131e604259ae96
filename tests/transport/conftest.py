"""Tests that are coroutines, on a real loop or on virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.support.coroutines import pytest_pyfunc_call
from tests.support.virtual_time import VirtualLoop, virtual_loop

__all__ = ["loop", "pytest_pyfunc_call"]


@pytest.fixture
def loop() -> Iterator[VirtualLoop]:
    """A loop on which an exception that nobody caught fails the test."""
    with virtual_loop() as made:
        yield made
        assert made.errors == []
