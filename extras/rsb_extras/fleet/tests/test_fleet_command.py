"""The commands of a fleet: what they print, what they do on each robot, and how they exit."""

from __future__ import annotations

import os
import re
import signal
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.console.scripted import NOW, ScriptedEngine, call_route
from tests.support import surroundings
from tests.support.fleet import ServerEngine

from rsb_bridge.model.robot_summary import RobotState
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State
from rsb_extras.fleet.fleet import Memory, Remembered, memory_path
from rsb_extras.fleet.tests.fleet_command_helpers import fleet

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_extras.fleet.tests.fleet_command_helpers import Fleet

__all__ = ["fleet"]


QUICK = ("--seconds", "0.1")
SETTLE = ("--settle", "0.2")


@pytest.fixture
def engine(machine: Machine) -> ServerEngine:
    return machine.have(ServerEngine("robot1", "robot2", "robot3"))


def answers(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    surroundings.set_stdin(monkeypatch, text, is_terminal=True)
    surroundings.print_to_terminal(monkeypatch)


def test_all_is_well(engine: ServerEngine, fleet: Fleet) -> None:
    ran = fleet("--json", *QUICK)
    assert ran.code == 0
    assert ran.json["ok"] is True
    assert ran.json["summary"]["robots"] == 3
    assert ran.json["summary"]["states"] == {state: 3 * (state is RobotState.OK) for state in RobotState}
    first = ran.json["robots"][0]
    assert (first["name"], first["group"], first["server"], first["gone"]) == ("robot1", "hall", "control", False)
    assert (first["flowing"], first["routes"], first["links_up"], first["links"]) == (2, 2, 1, 1)
    assert (first["messages_from_robot"], first["battery"]) == (20.0, None)
    assert first["since"] == NOW - 300.0


def test_a_robot_that_has_gone_is_dismissed(engine: ServerEngine, fleet: Fleet) -> None:
    memory = Memory(memory_path())
    memory.saw(Remembered("control", "robot9", NOW - 3600))
    memory.save()
    ran = fleet("--json", *QUICK)
    assert (ran.code, ran.json["robots"][0]["name"], ran.json["robots"][0]["gone"]) == (1, "robot9", True)
    assert fleet("dismiss", "robot1").code == 2  # it is there
    assert fleet("dismiss").code == 2
    ran = fleet("exec", "--all", "--", "topics")
    assert "robot9" in ran.err
    assert "robot9" not in ran.out
    assert fleet("dismiss", "robot9", "--json").json == {"ok": True, "dismissed": ["robot9"]}
    assert fleet("--json", *QUICK).code == 0


def test_no_server(machine: Machine, fleet: Fleet) -> None:
    machine.serve(ScriptedEngine())  # a client
    for arguments, code in ((("--json",), 3), (("--json", "--bridge", "robot1"), 2), (("--json", "--bridge", "no"), 3)):
        ran = fleet(*arguments)
        assert (ran.code, ran.json["ok"]) == (code, False)


def test_the_screen_needs_a_terminal(engine: ServerEngine, fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open() as nothing:
        surroundings.set_stdin(monkeypatch, nothing)
        ran = fleet()
    assert (ran.code, "fleet --json" in ran.err) == (2, True)


def test_the_fields_that_are_documented_are_printed(engine: ServerEngine, fleet: Fleet) -> None:
    section = (Path(__file__).parents[4] / "docs" / "headless.md").read_text().partition("| field of a robot |")[2]
    rows = [line.split("|")[1] for line in section.partition("\n\n")[0].splitlines()[2:]]
    printed = fleet("--json", *QUICK).json["robots"][0]
    assert {field for row in rows for field in re.findall(r"`(\w+)`", row)} == printed.keys()


def test_a_command_for_each(engine: ServerEngine, fleet: Fleet) -> None:
    ran = fleet("exec", "robot1", "robot3", "--", "pause", "/camera")
    assert ran.code == 0
    assert [line.partition(" of ")[0] for line in ran.out.splitlines()] == [
        "robot1: paused: /camera",
        "robot3: paused: /camera",
    ]
    assert engine.commands == [("pause", "robot1 /camera", True), ("pause", "robot3 /camera", True)]


def test_options_may_stand_before_the_command(engine: ServerEngine, fleet: Fleet) -> None:
    assert fleet("--json", "--bridge", "control", "exec", "robot1", "--", "status").json["ok"] is True
    assert fleet("exec", "robot1", "--json", "--bridge", "control", "--", "status").json["ok"] is True
    for arguments in (("--bridge", "no", "exec", "robot1"), ("exec", "robot1", "--bridge", "no")):
        assert fleet(*arguments, "--", "status").code == 3
    assert fleet("exec", "robot1", "--", "status").code == 0


def test_for_a_group_as_json(engine: ServerEngine, fleet: Fleet) -> None:
    ran = fleet("exec", "--group", "hall", "--json", "--", "topics")
    (one,) = ran.json["robots"]
    assert (ran.code, ran.json["ok"], one["robot"], one["code"]) == (0, True, "robot1", 0)
    assert {topic["topic"] for topic in one["output"][0]["topics"]} == {"/robot1/scan", "/robot1/camera"}


def test_what_fails_for_one_is_named(engine: ServerEngine, fleet: Fleet) -> None:
    now = engine.now
    engine.now = replace(now, routes=tuple(each for each in now.routes if each.key != "robot2 /camera"))
    ran = fleet("exec", "--all", "--", "pause", "/camera")
    assert ran.code == 1
    one, two, three = ran.out.splitlines()
    assert one.startswith("robot1: paused")
    assert three.startswith("robot3: paused")
    assert two.startswith("robot2: /camera is not bridged")
    ran = fleet("exec", "--all", "--json", "--", "pause", "/camera")
    assert [each["code"] for each in ran.json["robots"]] == [0, 2, 0]


def test_a_status_is_of_one_robot(engine: ServerEngine, fleet: Fleet) -> None:
    engine.link("robot1", state=State.DOWN, reason="no answer")
    ran = fleet("exec", "--all", "--json", "--", "status")
    assert [each["code"] for each in ran.json["robots"]] == [1, 0, 0]
    assert [*ran.json["robots"][1]["output"][0]["links"]] == ["robot2"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("robot1",),
        ("robot1", "--"),
        ("robot1", "--", "stop"),
        ("robot1", "--", "restart"),
        ("robot1", "--", "run", "x.yaml"),
        ("--", "status"),
        ("robto1", "--", "status"),
        ("--group", "attic", "--", "status"),
        ("robot1", "--", "echo", "/scan"),
        ("robot1", "--", "echo", "/scan", "--once"),
        ("robot1", "--", "hz", "/scan"),
        ("robot1", "--", "bw", "/scan"),
        ("robot1", "--", "events", "--follow"),
        ("robot1", "--", "wait", "--for", "linked"),
        ("robot1", "--", "status", "--bridge", "other"),
        ("robot1", "--", "status", "--fleet", "other.yaml"),
        ("robot1", "--", "pause", "/scan", "--link", "robot2"),
    ],
)
def test_what_is_no_command_for_a_robot(engine: ServerEngine, fleet: Fleet, arguments: tuple[str, ...]) -> None:
    assert fleet("exec", *arguments).code == 2
    assert engine.commands == []


def test_each_robot_gets_what_standard_input_has(
    engine: ServerEngine, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only the first one, while the others get the defaults of every field."""
    routes = tuple(call_route("service", "/dock", key=f"dock {name}", link=name) for name in ("robot1", "robot2"))
    engine.now = replace(engine.now, routes=(*engine.now.routes, *routes))
    engine.called.set_result("success: true\n")
    surroundings.set_stdin(monkeypatch, "data: true")
    assert fleet("exec", "robot1", "robot2", "--", "call", "/dock", "-").code == 0
    assert [each[2] for each in engine.commands if each[0] == "call"] == ["data: true"] * 2


def test_what_would_change(engine: ServerEngine, fleet: Fleet) -> None:
    ran = fleet("edit", "robot1", "robot2", "/camera", "max_rate=5", "--dry-run")
    assert (ran.code, ran.out.splitlines()) == (0, [f"{name}: max_rate none → 5" for name in ("robot1", "robot2")])
    ran = fleet("edit", "--all", "/camra", "max_rate=5", "--dry-run", "--json")
    assert (ran.code, len(ran.json["plan"])) == (1, 3)
    assert engine.commands == []


def test_a_change_after_a_yes(engine: ServerEngine, fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = ("edit", "--group", "yard", "/camera", "max_rate=5", *SETTLE)
    answers(monkeypatch, "\n")
    assert fleet(*wanted).code == 1
    assert engine.commands == []
    answers(monkeypatch, "y\n")
    assert fleet(*wanted).code == 0
    assert [(each[0], each[1]) for each in engine.commands] == [("edit", "robot2 /camera")]
    assert fleet(*wanted).code == 0  # nothing is to change any more
    assert len(engine.commands) == 1


def test_nobody_is_asked_and_no_change_is_refused(
    engine: ServerEngine, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    surroundings.set_stdin(monkeypatch, "")
    assert fleet("edit", "robot1", "/camera", "max_rate=5").code == 2
    assert fleet("edit", "robot1", "/camera", "max_rate=5", "--json").code == 2
    for words in (("/camera",), ("max_rate=5",), ("/a", "/b", "max_rate=5")):
        assert fleet("edit", "robot1", *words).code == 2
    assert engine.commands == []


def max_rate(edit: tuple[object, ...]) -> float | None:
    topic = edit[2]
    assert isinstance(topic, Topic)
    return topic.max_rate


def broken_at(name: str) -> ServerEngine:
    """A server on which the camera of one robot breaks when it is edited."""

    def edited(route: RouteSnapshot) -> RouteSnapshot:
        breaks = route.link == name and route.spec.max_rate == 5.0
        return (
            replace(route, state=State.DOWN, reason="refused") if breaks else replace(route, state=State.OK, reason="")
        )

    return ServerEngine("robot1", "robot2", "robot3", edited=edited)


def test_it_stops_and_says_the_way_back(machine: Machine, fleet: Fleet) -> None:
    engine = machine.have(broken_at("robot2"))
    ran = fleet("edit", "--all", "/camera", "max_rate=5", "--yes", *SETTLE)
    assert ran.code == 1
    assert [each[1] for each in engine.commands] == ["robot1 /camera", "robot2 /camera"]
    assert "stopped at robot2" in ran.err
    assert "fleet edit robot2 robot1 /camera max_rate=\n" in ran.err


def test_rollout_stops_after_robot_where_interrupted(machine: Machine, fleet: Fleet) -> None:
    def edited(route: RouteSnapshot) -> RouteSnapshot:
        signal.raise_signal(signal.SIGINT)
        return replace(route, state=State.OK, reason="")

    before = signal.getsignal(signal.SIGINT)
    machine.serve(ServerEngine("robot1", "robot2", edited=edited))
    ran = fleet("edit", "--all", "/camera", "max_rate=5", "--yes", "--json", *SETTLE)
    assert (ran.code, ran.json["done"], ran.json["left"]) == (1, ["robot1"], ["robot2"])
    assert signal.getsignal(signal.SIGINT) is before


def test_it_goes_back_by_itself(machine: Machine, fleet: Fleet) -> None:
    engine = machine.have(broken_at("robot2"))
    ran = fleet("edit", "--all", "/camera", "max_rate=5", "--yes", "--undo", "--json", *SETTLE)
    assert ran.code == 1
    assert (ran.json["done"], ran.json["failed"]["robot"], ran.json["left"]) == (["robot1"], "robot2", ["robot3"])
    assert (ran.json["undone"], ran.json["not_undone"]) == (True, [])
    assert [(each[1], max_rate(each)) for each in engine.commands] == [
        ("robot1 /camera", 5.0), ("robot2 /camera", 5.0), ("robot2 /camera", None), ("robot1 /camera", None),
    ]  # fmt: skip


def test_it_offers_to_go_back(machine: Machine, fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = machine.have(broken_at("robot1"))
    answers(monkeypatch, "y\ny\n")
    assert fleet("edit", "--all", "/camera", "max_rate=5", *SETTLE).code == 1
    assert [max_rate(each) for each in engine.commands] == [5.0, None]
