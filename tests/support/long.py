"""Tests that `make test` leaves out, and `make test-all` does not (tests/README.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _pytest.mark import ParameterSet


def long(*values: Any) -> list[ParameterSet]:
    """Values of a parameter with which a test takes long, and finds what it finds with others, too.

    Args:
        values: each a value, or a plain tuple of the values of several parameters.
    """
    return [pytest.param(*(each if type(each) is tuple else (each,)), marks=pytest.mark.long) for each in values]
