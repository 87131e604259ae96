"""The robots of several sources: their order, their absence, and the robot of a name."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.console.scripted import NOW
from tests.support.fleet import robot

from rsb_bridge.api import EngineError
from rsb_bridge.model.robot_summary import RobotState
from rsb_extras.fleet.fleet import LIMIT, Memory, Remembered, UnknownRobotError
from rsb_extras.fleet.tests.scripted_fleet import ScriptedSource, SetClock, fleet_of

if TYPE_CHECKING:
    from pathlib import Path


def names(robots: list[object]) -> list[str]:
    return [each.summary.name for each in robots]  # type: ignore[attr-defined]


def test_the_worst_come_first_and_then_by_number() -> None:
    source = ScriptedSource(
        robot("robot10"), robot("robot2"), robot("a", RobotState.WAITING), robot("z", RobotState.FAULT),
        robot("y", RobotState.MISSING), robot("x", RobotState.WARN),
    )  # fmt: skip
    assert names([*fleet_of(source).robots()]) == ["y", "z", "x", "a", "robot2", "robot10"]


def test_departed_robot_stays_until_dismissed() -> None:
    source = ScriptedSource(robot("robot1", group="hall"), robot("robot2"))
    fleet = fleet_of(source)
    fleet.robots()
    source.given = [robot("robot2")]
    gone, here = fleet.robots()
    assert (gone.gone, gone.summary.state, gone.summary.seen) == (True, RobotState.MISSING, NOW)
    assert (gone.summary.name, gone.summary.group, gone.summary.host) == ("robot1", "hall", "10.0.0.20:49152")
    assert not here.gone
    fleet.dismiss([gone, here])
    assert names([*fleet.robots()]) == ["robot2"]


def test_what_is_remembered_outlives_the_console(tmp_path: Path) -> None:
    path, clock = tmp_path / "state" / "fleet.json", SetClock()
    fleet = fleet_of(ScriptedSource(robot("robot1"), robot("robot2")), path=path, clock=clock)
    fleet.robots()
    fleet.stop()
    waiting = robot("robot2", RobotState.WAITING, seen=None, version="", links_up=0)
    later = fleet_of(ScriptedSource(waiting), path=path, clock=SetClock(NOW + 3600))
    first, second = later.robots()
    assert (first.summary.name, first.gone, first.summary.seen) == ("robot1", True, NOW)
    # its server has been restarted, and it has not come back since
    assert (second.summary.state, second.summary.seen, second.summary.version) == (RobotState.MISSING, NOW, "0.1.0")
    assert second.summary.since == NOW
    later.dismiss([first])
    assert len(json.loads(path.read_text())) == 1


def test_robot_never_there_is_not_missing() -> None:
    waiting = robot("robot1", RobotState.WAITING, seen=None)
    assert fleet_of(ScriptedSource(waiting)).robots()[0].summary == waiting


def test_memory_is_bounded_and_keeps_the_newest(tmp_path: Path) -> None:
    path = tmp_path / "fleet.json"
    memory = Memory(path)
    for number in range(LIMIT + 5):
        memory.saw(Remembered("control", f"robot{number}", float(number)))
    memory.save()
    kept = Memory(path)
    assert len(kept.of("control")) == LIMIT
    assert kept.get("control", "robot4") is None
    assert kept.get("control", "robot5") is not None


def test_consoles_share_a_memory(tmp_path: Path) -> None:
    first, second = (Memory(tmp_path / "fleet.json") for _ in range(2))
    for number in range(3):
        first.saw(Remembered("control", f"robot{number}", float(number)))
    first.save()
    second.save()
    second.forget("control", "robot0")
    second.forget("control", "robot2")
    second.saw(Remembered("control", "robot3", 3.0))
    second.save()
    first.saw(Remembered("control", "robot2", 4.0))  # it is there all the same
    first.save()
    assert [each.name for each in first.all()] == ["robot1", "robot3", "robot2"]
    assert Memory(tmp_path / "fleet.json").all() == first.all()


@pytest.mark.parametrize("content", ["", "{", '{"a": 1}', '[{"source": "control"}]', "\udcff", "[" * 5000])
def test_a_damaged_memory_is_empty(tmp_path: Path, content: str) -> None:
    path = tmp_path / "fleet.json"
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    assert Memory(path).of("control") == []


def test_what_memory_says_is_fit_for_screen(tmp_path: Path) -> None:
    path = tmp_path / "fleet.json"
    path.write_bytes(msgspec.json.encode([Remembered("control", "robot1", 1.0, host="\x1b[2J" + "x" * 999)]))
    (kept,) = Memory(path).of("control")
    assert "\x1b" not in kept.host
    assert len(kept.host) == 255


def test_a_memory_that_cannot_be_written_harms_nobody(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    fleet = fleet_of(ScriptedSource(robot("robot1")), path=tmp_path / "file" / "fleet.json")
    assert names([*fleet.robots()]) == ["robot1"]
    fleet.stop()


def test_rates_are_those_of_the_last_minute() -> None:
    source, clock = ScriptedSource(robot("robot1")), SetClock()
    fleet = fleet_of(source, clock=clock)
    for second in range(200):
        clock.now = NOW + second
        source.put("robot1", messages_from_robot=float(second), messages_to_robot=1.0)
        (one,) = fleet.robots()
    assert fleet.rates(one) == tuple(float(second + 1) for second in range(140, 200, 5))


def test_source_that_does_not_start_ends_others() -> None:
    first, second = ScriptedSource(), ScriptedSource(name="yard")
    second.fails = "nobody is there"
    with pytest.raises(EngineError, match="nobody"):
        fleet_of(first, second).start()
    assert (first.began, first.ended, second.ended) == (1, 1, 0)


def test_whom_a_name_means() -> None:
    one = ScriptedSource(robot("robot1", group="hall"), robot("robot10"), robot("robot2", group="hall"))
    two = ScriptedSource(robot("robot1"), name="yard")
    fleet = fleet_of(one, two)
    assert [each.key for each in fleet.chosen(["robot10", "robot2"])] == ["control/robot2", "control/robot10"]
    assert [each.key for each in fleet.chosen([], "hall")] == ["control/robot1", "control/robot2"]
    assert [each.key for each in fleet.chosen(["yard/robot1"], "hall")] == [
        "control/robot1", "yard/robot1", "control/robot2",
    ]  # fmt: skip
    assert len(fleet.chosen([], everyone=True)) == 4
    for wanted, group, words in (
        (["robot1"], "", "control/robot1, yard/robot1"),
        (["robto2"], "", "did you mean robot2"),
        (["zzz"], "", "there are"),
        ([], "attic", "groups: hall"),
    ):
        with pytest.raises(UnknownRobotError, match=words):
            fleet.chosen(wanted, group)


def test_a_server_is_no_robot() -> None:
    source = ScriptedSource(robot("control", role="server", group="hall"), robot("robot1", group="hall"))
    fleet = fleet_of(source)
    assert [each.key for each in fleet.chosen([], everyone=True)] == ["control/robot1"]
    assert [each.key for each in fleet.chosen([], "hall")] == ["control/robot1"]
    assert [each.key for each in fleet.chosen(["control"])] == ["control/control"]
    source.given = []
    assert len(fleet.chosen([], everyone=True, gone=True)) == 2, "both are forgotten"
    assert [each.is_server for each in fleet.robots()] == [True, False]


def test_departed_robot_is_meant_only_on_request() -> None:
    source = ScriptedSource(robot("robot1"), robot("robot2"))
    fleet = fleet_of(source)
    fleet.robots()
    source.given = [robot("robot2")]
    assert [each.key for each in fleet.chosen([], everyone=True)] == ["control/robot2"]
    assert [each.key for each in fleet.chosen(["robot1"], gone=True)] == ["control/robot1"]
    with pytest.raises(UnknownRobotError):
        fleet.chosen(["robot1"])
