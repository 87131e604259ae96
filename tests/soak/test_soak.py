"""The real part of a soak, for some seconds: so that what runs for hours elsewhere does not rot."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.soak import worlds
from tests.soak.faults import Fault
from tests.soak.ledgers import Book
from tests.soak.measures import Life, Sample
from tests.soak.processes import spawn
from tests.soak.report import broken, leaks, of_processes
from tests.soak.run import play
from tests.soak.stage import Stage
from tests.support import constants, replaced
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.domain import Domain

_FAULTS = (Fault("kill -9", 1, 0.1), Fault("cut", 1, 1.0))
_RECOVERY = 60.0
"""s: how fast a machine is that runs other tests as well is not what is tested here."""


def test_a_world_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is reported with the command that plays it again, and the next one is played."""
    replaced.SOAK_SPAWN.set(monkeypatch, lambda _: spawn(("-c", "print('two are one'); raise SystemExit(1)")))
    soak = worlds.Worlds(Random(1))
    soak.start()
    eventually(lambda: len(soak.failures) > 1)
    soak.stop()
    assert soak.failures[0].startswith("two are one")
    assert "it ended with 1: python -m tests.simulation " in soak.failures[0]
    assert soak.played == 0


def test_figures() -> None:
    """A process that grows is found; one that only warms up is not."""
    life = Life("pc", 1)
    for second in range(1200):
        life.samples.append(Sample(second, 70_000 + min(second, 150) * 50 + second * 10, 20, 15))
    for count in (20, 24, 21, 23, 22, 26, 28, 27, 29):
        life.calm.append(Sample(0, 0, count, 15))
    assert life.slope == pytest.approx(600)
    assert leaks(life)
    assert life.growth("descriptors") == 3
    assert life.growth("threads") == 0


def test_a_ledger_that_does_not_balance() -> None:
    """It is named, as is a negative part; parts are summed over a route and its successor."""
    row = {"link": "robot1", "topic": "/odom", "outgoing": True, "offered": 5, "delivered": 3, "throttled": 0}
    row |= {"expired": 0, "unknown": 0, "waiting": 0, "in_flight": 2, "dropped": {}, "lost_in_dds": 0}
    book = Book("robot1")
    book.take([row])
    book.take([row | {"offered": 2, "delivered": 2, "in_flight": 0}])
    assert book.totals()["delivered"] == 5
    assert not book.wrong
    book.take([row | {"delivered": 4}, row | {"in_flight": -1, "delivered": 6}])
    assert "5 offered, 6 accounted for" in book.wrong[0]
    assert "negative: in_flight" in book.wrong[1]


def test_one_kill_and_one_cut(tmp_path: Path, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.SOAK_STOPS_WITHIN.set(monkeypatch, _RECOVERY)
    # Over shared memory, Fast DDS may leave a process deaf that stands still for a second, and then it ends.
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    stage = Stage(tmp_path, (pc.id, robot.id))
    told: list[str] = []
    try:
        outcome = play(stage, _FAULTS, Random(1), calm=0.3, audited=1.0, tell=told.append)
    finally:
        stage.close()
    assert broken(outcome, _RECOVERY) == []
    assert [each.fault for each in outcome.recoveries] == list(_FAULTS), told
    assert outcome.ledger["delivered"] > 0
    assert "kill -9" in of_processes(outcome)
