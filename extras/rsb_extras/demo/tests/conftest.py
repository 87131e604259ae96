"""Surroundings of commands and consoles, as in their own tests."""

from __future__ import annotations

from tests.command.conftest import only_demo
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay, folder
from tests.ros.conftest import open_node

__all__ = ["_parsed_once", "_same_everywhere", "_toasts_stay", "folder", "only_demo", "open_node"]
