"""The command ``units``: its list, its question, and how an action ends."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tests.support.bridge import linked
from tests.support.waiting import eventually

from rsb_bridge.feature import MAY
from rsb_console.command.shell import FAILURE, OK, USAGE
from rsb_extras.units.tests.scripted_answers import LAST_LINE
from rsb_extras.units.tests.supervised import Supervised, has, may
from rsb_extras.units.unit_names import unit_names
from rsb_extras.units.unit_requests import ControlUnit, UnitGroup

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine

Run = Callable[..., "Ran"]


def told(machine: Machine) -> list[Any]:
    """Return the actions that an engine was told to carry out."""
    return [command for engine in machine.engines for command in engine.commands if command[0] == "control unit"]


def test_units_of_both_sides_are_listed(machine: Machine, ran: Run) -> None:
    machine.serve()
    listed = ran("units")
    assert listed.code == OK
    assert listed.out.splitlines() == [
        "UNIT     SIDE        STATE    AGE   ACTIONS",
        "camera   this side   running  1.2s  restart",
        "gripper  the server  running  3.0s  no right",
        "lidar    the server  failed   3.0s  restart",
        "nav      the server  stopped  2.0s  start stop restart",
    ]
    found = ran("units", "--json").json
    assert found["ok"]
    assert [(unit["link"], unit["name"], unit["state"]) for unit in found["units"]] == [
        ("", "camera", "running"), ("robot1", "gripper", "running"), ("robot1", "lidar", "failed"),
        ("robot1", "nav", "stopped"),
    ]  # fmt: skip


def test_an_action_asks_first(machine: Machine, ran: Run) -> None:
    machine.serve()
    refused = ran("units", "restart", "nav")
    assert (refused.code, told(machine)) == (USAGE, [])
    assert "no operator can answer: give --yes" in refused.err
    done = ran("units", "restart", "nav", "--yes")
    assert (done.code, done.out) == (OK, "unit nav of the server: it came back in 4.2 s\n")
    assert told(machine) == [("control unit", "nav", "restart", "robot1")]


def test_a_failed_action_shows_the_logs_end(machine: Machine, ran: Run) -> None:
    machine.serve()
    failed = ran("units", "restart", "lidar", "--yes")
    assert (failed.code, failed.out) == (FAILURE, f"no device\n{LAST_LINE}\n")
    assert "unit lidar of the server: restart ended with exit code 7" in failed.err
    found = ran("units", "restart", "lidar", "--yes", "--json")
    assert found.code == FAILURE
    assert (found.json["ok"], found.json["log"]) == (False, [LAST_LINE])


def test_wrong_usage_names_the_remedy(machine: Machine, ran: Run) -> None:
    machine.serve()
    assert "name the unit" in ran("units", "restart").err
    unknown = ran("units", "restart", "base", "--yes")
    assert (unknown.code, told(machine)) == (USAGE, [])
    assert "there is no unit base; there are: camera, gripper, lidar, nav" in unknown.err
    assert "there are: camera" in ran("units", "restart", "nav", "--here", "--yes").err


def test_a_name_on_both_sides_has_to_be_chosen(machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from rsb_extras.units.tests.scripted_answers import ANSWERS, GROUPS
    from rsb_extras.units.unit_requests import ListUnits

    monkeypatch.setitem(ANSWERS, ListUnits, lambda _: (*GROUPS, UnitGroup("robot2", GROUPS[1].units)))
    monkeypatch.setattr("tests.console.scripted.answers", lambda: ANSWERS)
    machine.serve()
    several = ran("units", "restart", "nav", "--yes")
    assert (several.code, told(machine)) == (USAGE, [])
    assert "2 sides have a unit nav; choose one: --link robot1; --link robot2" in several.err


def test_a_real_unit_comes_back(bridge: Bridge, machine: Machine, ran: Run, tmp_path: Path) -> None:
    nav = Supervised(tmp_path / "nav")
    robot = machine.have(bridge.client(features=has(("nav", nav), **{MAY: may("nav")})))
    pc = bridge.server()
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    assert ran("units", "restart", "nav", "--yes").out.startswith("unit nav of this side: it came back in ")
    nav.breaks()
    failed = ran("units", "restart", "nav", "--yes")
    assert (failed.code, failed.out) == (FAILURE, "no device\nstarted\ncannot open /dev/lidar\n")
    assert nav.ran == ["restart", "restart"]
    assert ControlUnit("nav", "restart").expires
    nav.close()


def test_names_are_completed(machine: Machine, here: None) -> None:
    machine.serve()
    assert unit_names(Namespace()) == ["camera", "gripper", "lidar", "nav"]
