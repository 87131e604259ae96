"""Commands with --fleet: over a real Zenoh router, what they do, what they print for programs, and how they exit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support.operators import BOB, granted
from tests.support.wording import says

from rsb_bridge.wire.preamble import RefusalText
from rsb_extras.operators.tests.fleet_over_zenoh_helpers import anna, bob, fleet

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.commands import Ran

    from rsb_extras.operators.tests.zenoh_fleet import Fleet

    Run = Callable[..., Ran]

__all__ = ["anna", "bob", "fleet"]


def test_command_is_for_engine_that_is_named(fleet: Fleet, anna: Run) -> None:
    fleet.add("robot1")
    fleet.add("robot2")
    assert anna("retry", "robot2").code == 0
    assert fleet.engines["robot2"].commands == [("retry", "")]
    assert fleet.engines["robot1"].commands == []
    status = anna("status", "robot1", "--json").json
    assert (status["name"], status["ok"]) == ("robot1", False)
    assert anna("pause", "/goal_pose", "--bridge", "robot1").code == 0
    assert fleet.engines["robot1"].commands == [("pause", "/goal_pose", True)]


def test_absent_and_unnamed_robots_have_own_codes(fleet: Fleet, anna: Run) -> None:
    fleet.add("robot1")
    assert anna("retry").code == 0, "there is but one"
    fleet.add("robot2")
    assert anna("retry").code == 2
    assert anna("retry", "robot3").code == 3
    assert anna("retry", "robot3", "--json").json["ok"] is False


def test_who_may_look_is_refused(fleet: Fleet, bob: Run) -> None:
    fleet.add("robot1")
    assert bob("topics", "robot1").code == 0
    assert bob("retry", "robot1").code == 1
    assert fleet.engines["robot1"].commands == []


def test_key_that_engine_does_not_take_is_said(fleet: Fleet, anna: Run) -> None:
    fleet.add("robot1")
    fleet.accesses["robot1"].grant(granted("anna", BOB))
    refused = anna("status", "robot1")
    assert refused.code == 3
    assert says(refused.err, RefusalText.KEYS_DIFFER, name="anna")


def test_every_command_tells_of_lost_router(fleet: Fleet, anna: Run) -> None:
    fleet.router.kill()
    for command in ("status robot1", "fleet --json", "fleet exec --all"):
        said = anna(command, *(("--", "topics") if "exec" in command else ()))
        assert said.code == 3
        assert fleet.router.endpoint in said.out + said.err


def test_a_file_with_mistakes_is_wrong_usage(fleet: Fleet, anna: Run, tmp_path: Path) -> None:
    (tmp_path / "anna.yaml").write_text("operator: anna\n")
    assert anna("status").code == 2
    assert anna("fleet --json").code == 2
    (tmp_path / "anna.yaml").unlink()
    assert anna("status").code == 2


def test_all_robots_are_reported(fleet: Fleet, anna: Run) -> None:
    fleet.add("robot1")
    fleet.add("robot2")
    fleet.accesses["robot2"].grant({})
    report = anna("fleet --json", "--seconds", "0.1")
    assert report.code == 1
    robots: dict[str, Any] = {robot["name"]: robot for robot in report.json["robots"]}
    assert robots["robot1"]["routes"] > 0
    assert robots["robot2"]["state"] == "fault"
    assert robots["robot2"]["seen"] is None
    assert {robot["server"] for robot in robots.values()} == {"lab"}


def test_robot_that_is_not_reached_is_not_done(fleet: Fleet, anna: Run) -> None:
    fleet.add("robot1")
    fleet.add("robot2")
    fleet.accesses["robot2"].grant({})
    edited = anna("fleet edit", "--all", "/goal_pose", "max_rate=5", "--yes", "--settle", "0.1", "--json")
    assert edited.code == 1
    assert edited.json["ok"] is False
    assert [name for name, *_ in fleet.engines["robot2"].commands] == []
