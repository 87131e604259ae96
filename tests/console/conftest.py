"""Fixtures of the console's tests."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from textual.cache import LRUCache
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet
from textual.notifications import Notification

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_TOASTS_STAY = 60.0
"""s."""
now = time.time  # which tests replace


@pytest.fixture(autouse=True, scope="session")
def _parsed_once() -> Iterator[None]:
    """Have each style sheet parsed once, instead of once for each app: that took a sixth of the time."""
    parsed: dict[tuple[tuple[str, str], ...], dict[Any, Any]] = {}
    made, set_variables = Stylesheet.__init__, Stylesheet.set_variables

    def share(sheet: Stylesheet) -> None:
        rules: Any = parsed.setdefault(tuple(sheet._variables.items()), {})
        sheet._parse_cache = rules

    def init(self: Stylesheet, *, variables: dict[str, str] | None = None) -> None:
        made(self, variables=variables)
        share(self)

    def change(self: Stylesheet, variables: dict[str, str]) -> None:
        self._parse_cache = LRUCache(1)  # it is cleared, and other apps go on with the one that they share
        set_variables(self, variables)
        share(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stylesheet, "__init__", init)
        patch.setattr(Stylesheet, "set_variables", change)
        patch.setattr(RuleSet, "__hash__", object.__hash__)  # the same, but not in Python: there are 100,000 in a test
        yield


@pytest.fixture(autouse=True)
def _same_everywhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Pictures must not depend on the machine's zone, terminal or connection; the user's own lists stay theirs."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for name in ("SSH_CONNECTION", "NO_COLOR", "TMUX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLORTERM", "truecolor")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()


@pytest.fixture(autouse=True)
def _toasts_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """A notification lasts 3 to 5 s, which a process that stands still for so long would miss."""
    monkeypatch.setattr(Notification, "time_left", property(lambda each: each.raised_at + _TOASTS_STAY - now()))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder."""
    path = tmp_path / "work"
    path.mkdir()
    monkeypatch.chdir(path)
    return path
