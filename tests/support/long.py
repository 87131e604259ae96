"""Tests that `make test` leaves out, and `make test-all` does not (tests/README.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _pytest.mark import ParameterSet


def long(*values: Any) -> list[ParameterSet]:
    """Values of a parameter with which a test takes long, and finds what it finds with others, too."""
    return [pytest.param(value, marks=pytest.mark.long) for value in values]


def long_cases(*cases: tuple[Any, ...]) -> list[ParameterSet]:
    return [pytest.param(*case, marks=pytest.mark.long) for case in cases]
