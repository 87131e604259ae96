"""Fixtures of the tests of commands and of operators, for those over networks."""

from __future__ import annotations

from tests.command.conftest import here, ran

__all__ = ["here", "ran"]
