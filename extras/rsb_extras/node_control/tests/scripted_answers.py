"""The managed nodes of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from typing import Any

from rsb_extras.node_control.change_records import (
    ChangeOutcome,
    ChangeStep,
    Container,
    ListedGroup,
    Managed,
    ManagedNode,
    NodeChange,
)
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged, ManagedSide
from rsb_extras.node_control.parameter_records import NodeParameter, ParameterNode, ParameterRange, ParameterValue
from rsb_extras.node_control.parameter_requests import ListParameterNodes, ParameterSide, ReadParameters

FAILED = ChangeOutcome(
    reason="/controller refused to configure, and is unconfigured now: see its log", seconds=1.5,
    steps=(
        ChangeStep("/nav/planner_server", "configure", "inactive", "", 1.2),
        ChangeStep("/controller", "configure", "unconfigured", "/controller refused to configure", 0.3),
    ),
)  # fmt: skip
DONE = ChangeOutcome(seconds=2.0, steps=(ChangeStep("/nav/planner_server", "activate", "active", "", 2.0),))
SIDES = (
    ManagedSide("", Managed((ManagedNode("/camera", "active", ("deactivate", "shutdown"), True),))),
    ManagedSide(
        "robot1",
        Managed(
            (
                ManagedNode("/controller", "unconfigured", ("configure", "shutdown")),
                ManagedNode("/lidar_driver", "active", ("deactivate", "shutdown"), True),
                ManagedNode("/nav/planner_server", "inactive", ("activate", "cleanup", "shutdown"), True),
                ManagedNode("/silent"),
            ),
            (ListedGroup("nav", ("/nav/planner_server", "/controller"), True),),
            (NodeChange("nav", "up", FAILED),),
            (
                Container("/nav2_container", ("/nav/planner_server", "/nav/smoother_server"), allowed=True),
                Container("/sensors", ("/sensors/filter",)),
            ),
        ),
    ),
)


NOT_SET = ChangeOutcome(
    reason="/controller does not set retries: not while it drives", seconds=0.2,
    steps=(ChangeStep("/controller", "set", "", "/controller does not set retries: not while it drives", 0.2),),
)  # fmt: skip


def _changed(command: ChangeNodes) -> ChangeOutcome:
    if command.action == "set" and command.values[0].name == "retries":
        return NOT_SET
    return FAILED if (command.target, command.action) == ("nav", "down") else DONE


def _value(kind: Any, plain: Any) -> ParameterValue:
    return ParameterValue.of(kind, plain)


PARAMETERS = (
    NodeParameter("description", ParameterValue("string"), 80_000),
    NodeParameter("frame", _value("string", "map")),
    NodeParameter(
        "max_speed", _value("double", 0.5), description="m/s, in the plane", ranges=(ParameterRange(0.0, 2.0, 0.1),)
    ),
    NodeParameter("planner.plugins", _value("string_array", ["grid", "smac"])),
    NodeParameter("retries", _value("integer", 4), ranges=(ParameterRange(0, 10, 2),)),
    NodeParameter("serial", _value("string", "A-17"), read_only=True),
    NodeParameter("use_sim_time", _value("bool", False)),
)
PARAMETER_SIDES = (
    ParameterSide("", (ParameterNode("/camera", allowed=True),)),
    ParameterSide(
        "robot1",
        (
            ParameterNode("/controller"), ParameterNode("/lidar_driver", allowed=True),
            ParameterNode("/nav/planner_server", allowed=True),
        ),
    ),
)  # fmt: skip


def _read(command: ReadParameters) -> tuple[NodeParameter, ...]:
    found: tuple[NodeParameter, ...] = (
        PARAMETERS[1:] if command.node in ("/lidar_driver", "/controller_server") else PARAMETERS
    )
    # The first is too large for a link.
    if command.node == "/controller_server":
        found += (NodeParameter("controller_frequency", _value("double", 10.0)),)
    return tuple(each for each in found if not command.names or each.name in command.names)


ANSWERS: dict[Any, Any] = {
    ListManaged: lambda command: SIDES[:1] if command.here else SIDES, ChangeNodes: _changed,
    ListParameterNodes: lambda _: PARAMETER_SIDES, ReadParameters: _read,
}  # fmt: skip
