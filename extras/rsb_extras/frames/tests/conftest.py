"""Fixtures of bridges, commands and consoles."""

from __future__ import annotations

from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere
from tests.engine.conftest import _answers_take_their_time, consoles, long_lease

__all__ = ["_answers_take_their_time", "_parsed_once", "_same_everywhere", "consoles", "here", "long_lease", "ran"]
