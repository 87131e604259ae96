"""Fixtures of commands, consoles and fleets."""

from __future__ import annotations

from typing import Any

import pytest
from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere
from tests.console.scripted import answers

from rsb_extras.fleet.tests.servers_helpers import engine, fleet, robot2
from rsb_extras.history.history_data import ReportHistory
from rsb_extras.history.tests.scripted_answers import answer

__all__ = ["_parsed_once", "_same_everywhere", "engine", "fleet", "here", "ran", "robot2"]


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    known: Any = answers()
    monkeypatch.setitem(known, ReportHistory, answer)  # what tests put there goes with this
