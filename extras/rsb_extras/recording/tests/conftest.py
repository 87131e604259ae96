"""Surroundings of engines, commands and consoles, as in their own tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay
from tests.engine.conftest import _answers_take_their_time, consoles, long_lease, loop, make_context

__all__ = [
    "_answers_take_their_time",
    "_parsed_once",
    "_same_everywhere",
    "_toasts_stay",
    "consoles",
    "here",
    "long_lease",
    "loop",
    "make_context",
    "ran",
]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the recordings that this test makes."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "rsb-console" / "recordings"
