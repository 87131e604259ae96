"""Surroundings of engines, commands and consoles, as in their own tests, and a folder for what bridges keep."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay
from tests.engine.conftest import _answers_take_their_time, consoles, long_lease

__all__ = [
    "_answers_take_their_time",
    "_parsed_once",
    "_same_everywhere",
    "_toasts_stay",
    "consoles",
    "here",
    "long_lease",
    "ran",
]


@pytest.fixture(autouse=True)
def fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of what this test gets."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "rsb-console" / "recordings" / "fetched"


@pytest.fixture
def bags(tmp_path: Path) -> Path:
    """The folder of the robot's recordings."""
    folder = tmp_path / "bags"
    folder.mkdir()
    return folder
