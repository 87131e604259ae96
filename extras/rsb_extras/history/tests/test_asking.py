"""The history of one robot of a server, of an engine elsewhere, and logs for other parts of the program."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.api import EngineError
from rsb_bridge.control.states import clean
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level
from rsb_extras.history import FEATURE
from rsb_extras.history.history_data import ReportHistory
from rsb_extras.history.history_files import EventFile
from rsb_extras.history.tests.scripted_answers import REMEMBERED
from rsb_extras.history.tests.world import World
from rsb_extras.operators.tests.fleet_over_zenoh_helpers import as_operator
from rsb_extras.operators.tests.zenoh_fleet import Fleet

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_extras.fleet.server_source import RobotEngine, ServerFleet


def test_opened_robot_gets_its_own_history(fleet: ServerFleet, robot2: RobotEngine) -> None:
    nothing = robot2.do(ReportHistory(3600.0)).result(30)
    assert (nothing.tracks, nothing.outages, nothing.actions) == ((), (), ())
    robot1 = fleet.open("robot1", read_only=True)
    try:
        own = robot1.do(ReportHistory(3600.0)).result(30)
    finally:
        robot1.stop()
    assert (own.tracks, own.outages, own.actions) == (REMEMBERED.tracks, REMEMBERED.outages, REMEMBERED.actions)
    with pytest.raises(EngineError):
        robot1.do(ReportHistory(3600.0)).result(30)  # it is detached


def test_recorder_reports_on_one_link() -> None:
    world = World("/scan")
    world.routes["/map"] = replace(world.routes["/scan"], topic="/map", link="robot2")
    for link in ("robot2", "", "robot1"):
        world.events.add(Level.INFO, EventCode.OPERATOR_PAUSED, f"of {link}", link=link, who="anna")
    world.go(5)
    report = world.recorder.history(60.0, "robot2").result(60)
    assert report.name == "robot2 at robot1"
    assert [track.topic for track in report.tracks] == ["/map"]
    assert [event.text for event in report.actions] == ["of robot2", "of "]


def test_report_over_zenoh_is_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with closing(Fleet(tmp_path)) as fleet:
        fleet.add("robot1")
        assert as_operator(fleet, capsys, "anna")("report", "robot1", "--json").code == 0
        assert [name for name, *_ in fleet.engines["robot1"].commands] == ["history"]


def test_honest_report_is_as_it_was() -> None:
    assert clean(REMEMBERED) == REMEMBERED


def test_kept_logs_are_those_of_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = tmp_path / "rsb-console"
    folder.mkdir()
    for name, text in (("robot1", "first"), ("robot1-2", "second"), ("robot2", "another's")):
        file = EventFile(folder / f"{name}.jsonl")
        file.write([Event(1, 1e9, Level.INFO, EventCode.LINK_UP, text)])
        file.close()
    assert [event.text for log in FEATURE.kept_logs("robot1") for event in log] == ["first", "second"]
