"""The managed nodes of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from typing import Any

from rsb_extras.node_control.change_records import (
    ChangeOutcome,
    ChangeStep,
    ListedGroup,
    Managed,
    ManagedNode,
    NodeChange,
)
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged, ManagedSide

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
        ),
    ),
)


def _changed(command: ChangeNodes) -> ChangeOutcome:
    return FAILED if (command.target, command.action) == ("nav", "down") else DONE


ANSWERS: dict[Any, Any] = {ListManaged: lambda command: SIDES[:1] if command.here else SIDES, ChangeNodes: _changed}
