"""Fixtures of the tests of commands: the program's arguments in, its exit code and its output back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.commands import Ran
from tests.support.locks import alone

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.control import Machine


@pytest.fixture
def here(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have commands look for bridges in this test's folder of control sockets."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    constants.BRIDGES_ASKED_FOR.set(monkeypatch, 60.0)  # the bridges are threads of this process, and may stand still


@pytest.fixture
def ran(here: None, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Run a command at the bridges of `machine`."""
    return lambda *arguments: Ran(capsys, *arguments)


@pytest.fixture
def only_demo() -> Iterator[None]:
    """Two demos could choose the same domains."""
    with alone("demo"):
        yield
