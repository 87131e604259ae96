"""Attacks on a topic with `max_age`, and the age of the oldest message that reaches the robot."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tests.system.torture.ends import WITNESS
from tests.system.torture.judge import Window, judge
from tests.system.torture.stage import RATE, TOPIC, Stage
from tests.system.torture.threads import stopped

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from tests.system.torture.judge import Findings
    from tests.system.torture.stage import Nodes, Side, Transport

    Work: TypeAlias = Callable[["Nodes", Stage], None]

MAX_AGE = 0.5
KNOWN = "max_age" in Topic.__struct_fields__

_KEY: dict[str, Any] = {"max_age": MAX_AGE} if KNOWN else {}
_STARTS_WITHIN = 60.0
_ALWAYS = (Window(0.0),)


def _hold(_: Nodes, stage: Stage) -> None:
    """The network holds everything for 3 s."""
    stage.relay.hold()
    time.sleep(3.0)
    stage.relay.release()


def _hold_data(_: Nodes, stage: Stage) -> None:
    """The network holds the messages for 3 s, and nothing else."""
    stage.relay.hold(("data", "datagrams"))
    time.sleep(3.0)
    stage.relay.release()


def _hold_briefly(_: Nodes, stage: Stage) -> None:
    """The network holds everything for 0.4 s after the control PC's bridge stood still for 0.4 s, again and again."""
    for _round in range(4):
        with stage.pc.frozen():
            time.sleep(0.4)
        stage.relay.hold()
        time.sleep(0.4)
        stage.relay.release()
        time.sleep(0.5)


def _freeze_pc(_: Nodes, stage: Stage) -> None:
    """Messages wait in DDS, where the control PC's bridge does not take them."""
    with stage.pc.frozen():
        time.sleep(2.0)


def _freeze_robot(_: Nodes, stage: Stage) -> None:
    """Messages wait at the robot's bridge."""
    with stage.robot.frozen():
        time.sleep(2.0)


def _stop_ros_of_pc(_: Nodes, stage: Stage) -> None:
    """The control PC's bridge takes nothing from ROS for 2 s, and all else of it goes on."""
    with stopped(stage.pc.command.pid, "ros"):
        time.sleep(2.0)


def _pause(_: Nodes, stage: Stage) -> None:
    """An operator pauses the topic for 2 s."""
    assert stage.pc.run("pause", TOPIC).wait() == 0
    time.sleep(2.0)
    assert stage.pc.run("resume", TOPIC).wait() == 0


def _pause_held(_: Nodes, stage: Stage) -> None:
    """An operator pauses and resumes the topic while the network holds the messages."""
    stage.relay.hold(("data", "datagrams"))
    time.sleep(1.0)
    assert stage.pc.run("pause", TOPIC).wait() == 0
    assert stage.pc.run("resume", TOPIC).wait() == 0
    stage.relay.release()


def _reconnect(_: Nodes, stage: Stage) -> None:
    """The robot's bridge is killed, and started again."""
    stage.robot.kill()
    time.sleep(1.0)
    stage.robot.start()


def _reconnect_pc(_: Nodes, stage: Stage) -> None:
    """The control PC's bridge is killed, and started again."""
    stage.pc.kill()
    time.sleep(1.0)
    stage.pc.start()


def _latched(nodes: Nodes, stage: Stage) -> None:
    """A latched message of 2 s ago is all that there is when the robot's bridge comes back."""
    nodes.talker.talk([TOPIC], 0.001, latched=True)
    time.sleep(1.0)
    for start_again in (_reconnect, _reconnect_pc):
        start_again(nodes, stage)
        time.sleep(5.0)


def _latched_pause(nodes: Nodes, stage: Stage) -> None:
    """A latched message of 2 s ago is all that there is when the topic is resumed."""
    nodes.talker.talk([TOPIC], 0.001, latched=True)
    time.sleep(1.0)
    _pause(nodes, stage)


WORKS: dict[str, Work] = {
    "none": lambda _, __: time.sleep(1.0),
    "hold": _hold,
    "hold-data-only": _hold_data,
    "add-up": _hold_briefly,
    "freeze-pc": _freeze_pc,
    "freeze-robot": _freeze_robot,
    "ros-thread-pc": _stop_ros_of_pc,
    "pause": _pause,
    "pause-held": _pause_held,
    "reconnect": _reconnect,
    "reconnect-pc": _reconnect_pc,
    "latched": _latched,
    "latched-pause": _latched_pause,
}


def _steps(side: Side, seconds: float) -> Work:
    def work(nodes: Nodes, stage: Stage) -> None:
        nodes.clocks[side].set(nodes.clocks[side].seconds + seconds)
        _hold(nodes, stage)
        time.sleep(1.0)
        _hold_data(nodes, stage)

    return work


STEPS: dict[str, Work] = {
    "step-pc-ahead": _steps("pc", 10.0),
    "step-pc-back": _steps("pc", -10.0),
    "step-robot-ahead": _steps("robot", 10.0),
    "step-robot-back": _steps("robot", -10.0),
}
"""A wall clock is stepped, and then the network holds for 3 s. Only with `Nodes.clocks`."""


@dataclass(frozen=True)
class Place:
    """The sessions that have the `max_age`.

    Attributes:
        robot: the topic's entry in the robot's session, or None.
        pc: the topic's entry in the control PC's session, or None.
    """

    robot: dict[str, Any] | None = None
    pc: dict[str, Any] | None = None


_NAME = {"topic": TOPIC, "direction": "receive"}
PLACES = {
    "robot": Place(_NAME | _KEY),
    "pc": Place(_NAME, _NAME | _KEY),
    "robot-pattern": Place({"topic": "/cm*", "direction": "receive"} | _KEY),
    "pc-pattern": Place(_NAME, {"topic": "/cm*", "direction": "receive"} | _KEY),
    "both": Place(_NAME | _KEY, _NAME | dict.fromkeys(_KEY, 20.0)),
}


def run(nodes: Nodes, work: str, transport: Transport = "tcp", place: str = "robot") -> Findings:
    """Do something to a topic with `max_age`, and judge what reached the robot.

    Args:
        work: of `WORKS` or `STEPS`.
        place: of `PLACES`.
    """
    said = PLACES[place]
    entries: dict[Side, dict[str, Any]] = {}
    if said.robot is not None:
        entries["robot"] = {"topics": [said.robot | {"protocol": transport}]}
    if said.pc is not None:
        topics = [said.pc | {"protocol": transport}]
        entries["pc"] = {"clients": [{"name": "robot1", "key_file": "key.txt", "topics": topics}]}
    for clock in nodes.clocks.values():
        clock.set(0.0)
    with Stage(nodes, transport, entries=entries) as stage:
        nodes.ear.listen([TOPIC])
        nodes.talker.talk([TOPIC], RATE)
        _await_flow(nodes, stage)
        time.sleep(1.0)
        (WORKS | STEPS)[work](nodes, stage)
        notes = []
        if not work.startswith("latched"):
            try:
                _await_flow(nodes, stage)
            except AssertionError as error:
                notes.append(str(error))
        stage.settle()
        found = judge(nodes.ear.arrivals(), _ALWAYS, MAX_AGE, true_clock=not nodes.clocks)
        found.notes += notes
        return found


def _await_flow(nodes: Nodes, stage: Stage) -> None:
    begin = time.monotonic()
    while sum(each.published > begin for each in nodes.ear.arrivals() if each.topic != WITNESS) < RATE / 4:
        assert time.monotonic() - begin < _STARTS_WITHIN, f"does not flow: {stage.describe()}"
        time.sleep(0.05)
