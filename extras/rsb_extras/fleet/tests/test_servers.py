"""A server's clients as a fleet, through its control socket; and one of them by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import NOW
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.model.robot_summary import RobotState
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Event, Level, State
from rsb_extras.fleet.tests.servers_helpers import engine, fleet, robot2
from rsb_extras.nodes.node_data import Nodes

if TYPE_CHECKING:
    from tests.support.control import Machine
    from tests.support.fleet import ServerEngine

    from rsb_extras.fleet.server_source import RobotEngine, ServerFleet

__all__ = ["engine", "fleet", "robot2"]


def test_one_robot_for_each_client(fleet: ServerFleet, engine: ServerEngine) -> None:
    one, two, three = fleet.robots()
    assert [one.name, one.group, two.group, three.group] == ["robot1", "hall", "yard", ""]
    assert (one.state, one.flowing, one.routes) == (RobotState.OK, 2, 2)
    engine.link("robot2", state=State.DOWN, reason="cable pulled", since=NOW)
    eventually(lambda: fleet.robots()[1].state is RobotState.MISSING)
    assert fleet.robots()[1].why == "cable pulled"
    assert fleet.problem == ""


def test_a_server_that_ends_leaves_its_robots_missing(fleet: ServerFleet, machine: Machine) -> None:
    assert [each.state for each in fleet.robots()] == [RobotState.OK] * 3
    machine.served[0].close()
    eventually(lambda: fleet.problem)
    eventually(lambda: [each.state for each in fleet.robots()] == [RobotState.MISSING] * 3)


def test_an_opened_robot_is_all_there_is(robot2: RobotEngine, engine: ServerEngine) -> None:
    engine.happened += [
        Event(number, NOW, Level.INFO, "link.up", "linked", link)
        for number, link in enumerate(("robot1", "robot2", "", "robot3"), len(engine.happened) + 1)
    ]
    engine.now = replace(engine.now, time=NOW + 1)
    eventually(lambda: robot2.snapshot().time > NOW)
    now = robot2.snapshot()
    assert [link.name for link in now.links] == ["robot2"]
    assert [each.topic for each in now.routes] == ["/robot2/scan", "/robot2/camera"]
    eventually(lambda: len(robot2.events()) == 2)
    assert [event.link for event in robot2.events()] == ["robot2", ""]
    assert [event.link for event in robot2.wait_for_events(0, 1.0)] == ["robot2", ""]
    assert [event.link for event in robot2.remembered_events(1.0)][-2:] == ["robot2", ""]


def test_what_is_added_is_added_to_opened_robot(robot2: RobotEngine, engine: ServerEngine) -> None:
    topic = Topic("/map", "transmit")
    robot2.add_topic(topic).result(30)
    robot2.retry().result(30)
    robot2.pause("robot2 /scan", True).result(30)
    assert engine.commands == [("add", topic, "robot2"), ("retry", "robot2"), ("pause", "robot2 /scan", True)]


def test_this_side_of_opened_robot_is_the_server(
    robot2: RobotEngine, engine: ServerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str | None] = []
    do = engine.do

    def heard(command: Any, step: Any = None) -> Any:
        asked.append(command.link)
        return do(command, step)

    monkeypatch.setattr(engine, "do", heard)
    for link in (None, "", "robot2"):
        robot2.do(Nodes(link)).result(30)
    assert asked == [None, "robot2", "robot2"]


def test_what_concerns_all_robots_is_refused(robot2: RobotEngine, engine: ServerEngine) -> None:
    for command in (robot2.restart(), robot2.shut_down(), robot2.reload(), robot2.stop_bridge()):
        with pytest.raises(EngineError, match="all robots"):
            command.result(30)
    assert engine.commands == []
