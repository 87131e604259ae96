"""Surroundings of the console, as in its own tests."""

from __future__ import annotations

from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay

__all__ = ["_parsed_once", "_same_everywhere", "_toasts_stay"]
