"""Fixtures of bridges and commands."""

from __future__ import annotations

from tests.command.conftest import here, ran
from tests.engine.conftest import _answers_take_their_time, consoles, long_lease

__all__ = ["_answers_take_their_time", "consoles", "here", "long_lease", "ran"]
