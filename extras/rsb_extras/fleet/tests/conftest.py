"""Fixtures of the tests of commands and consoles, for those of the fleet."""

from __future__ import annotations

from tests.command.conftest import here, only_demo, ran
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay, folder

__all__ = ["_parsed_once", "_same_everywhere", "_toasts_stay", "folder", "here", "only_demo", "ran"]
