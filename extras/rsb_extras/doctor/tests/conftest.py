"""Fixtures of the tests of commands, for doctor's."""

from __future__ import annotations

from tests.command.children_helpers import planted
from tests.command.conftest import here, ran

__all__ = ["here", "planted", "ran"]
