"""Helpers of `test_fleet_over_zenoh` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.commands import Ran
from tests.support.operators import ANNA, BOB

from rsb_extras.operators.tests.zenoh_fleet import Fleet

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Run = Callable[..., Ran]


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


@pytest.fixture
def anna(fleet: Fleet, capsys: pytest.CaptureFixture[str]) -> Run:
    return as_operator(fleet, capsys, "anna")


@pytest.fixture
def bob(fleet: Fleet, capsys: pytest.CaptureFixture[str]) -> Run:
    return as_operator(fleet, capsys, "bob")


def as_operator(fleet: Fleet, capsys: pytest.CaptureFixture[str], name: str) -> Run:
    path = fleet.write_file(name, {"anna": ANNA, "bob": BOB}[name])

    def run(command: str, *words: str) -> Ran:
        before: tuple[str, ...] = words
        rest: tuple[str, ...] = ()
        if "--" in words:
            at = words.index("--")
            before, rest = words[:at], words[at:]
        return Ran(capsys, *command.split(), *before, "--fleet", str(path), *rest)

    return run
