"""Surroundings of consoles, as in their own tests."""

from __future__ import annotations

from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay, folder

__all__ = ["_parsed_once", "_same_everywhere", "_toasts_stay", "folder"]
