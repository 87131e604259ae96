"""Surroundings of consoles, commands and engines, as in their own tests."""

from __future__ import annotations

import pytest
from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay
from tests.engine.arming_helpers import both_armed
from tests.engine.conftest import _answers_take_their_time, consoles, loop, make_context
from tests.support import constants
from tests.support.long_lease import lengthen_lease

from rsb_extras.driving.tests import driving_places

__all__ = [
    "_answers_take_their_time",
    "_parsed_once",
    "_same_everywhere",
    "_toasts_stay",
    "both_armed",
    "consoles",
    "here",
    "loop",
    "make_context",
    "ran",
]


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first message by hand waits for nodes and routes as long as a busy machine takes, not 3 s."""
    driving_places.MATCHED_WITHIN.set(monkeypatch, 100.0)
    constants.LINK_ARMING_ANSWERED_WITHIN.set(monkeypatch, 25.0)


@pytest.fixture
def long_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    """Topics stay armed, and tickets valid, while a busy machine stands still for more than a second."""
    lengthen_lease(monkeypatch)
    driving_places.TICKET_LIFE.set(monkeypatch, 60.0)
