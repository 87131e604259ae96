"""Fixtures of the tests of commands, for doctor's."""

from __future__ import annotations

from tests.command.conftest import here, ran
from tests.command.test_children import planted

__all__ = ["here", "planted", "ran"]
