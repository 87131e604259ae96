"""The nodes of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from rsb_extras.nodes.node_data import (
    FoundBy,
    LogLine,
    NameAndType,
    NodeDetails,
    Nodes,
    NodesSeen,
    NodeState,
    OneNode,
    ProcessState,
)

NOW = 5000
LIDAR = NodeState(
    "/front/lidar_driver", "raspi", count=0, publishes=1, ends=1, ended=NOW - 40,
    line=LogLine(40, NOW - 41, "motor stalled"),
)  # fmt: skip
CAMERAS = tuple(
    NodeState(f"/cameras/camera_{number}", "raspi", 812, FoundBy.GUID, publishes=2, serves=3) for number in range(9)
)
PLANNER = NodeState("/nav/planner_server", "host 78fd", lifecycle="inactive", serves=9)
SHELL = NodeState("/_ros2cli_77", "raspi")
KNOWN = (LIDAR, *CAMERAS, PLANNER, SHELL)
PROCESS = ProcessState(812, "component_conta", 42, 310, 61, NOW - 7200)


def answer(command: Nodes) -> NodesSeen:
    whole = (command.book, command.since) != (7, 20)
    return NodesSeen(7, 20, True, NOW, KNOWN, (PROCESS,)) if whole else NodesSeen(7, 20, False, NOW)


def answer_one(command: OneNode) -> NodeDetails:
    found = next((each for each in KNOWN if each.name == command.node), LIDAR if command.topic else None)
    if found is None:
        return NodeDetails(NOW)
    names = (NameAndType("/scan", "sensor_msgs/msg/LaserScan"),) if found is LIDAR else ()
    lines = (LogLine(30, NOW - 60, "motor is hot"), found.line) if found.line is not None else ()
    return NodeDetails(NOW, found, PROCESS if found.pid else None, publishes=names, lines=lines)


ANSWERS = {Nodes: answer, OneNode: answer_one}
