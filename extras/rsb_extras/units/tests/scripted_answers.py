"""The units of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from typing import Any

from rsb_extras.units.unit_records import ACTIONS, UnitOutcome, UnitRecord, UnitState
from rsb_extras.units.unit_requests import ControlUnit, ListUnits, UnitGroup

LAST_LINE = "cannot open /dev/lidar: no such device; is the cable of the lidar in its socket at the left of the mast?"
GROUPS = (
    UnitGroup("", (UnitRecord("camera", ("restart",), True, UnitState.RUNNING, 1.2),)),
    UnitGroup(
        "robot1",
        (
            UnitRecord("gripper", ("restart",), False, UnitState.RUNNING, 3.0),
            UnitRecord("lidar", ("restart",), True, UnitState.FAILED, 3.0),
            UnitRecord("nav", ACTIONS, True, UnitState.STOPPED, 2.0),
        ),
    ),
)


def _controlled(command: ControlUnit) -> UnitOutcome:
    if command.unit == "lidar":
        return UnitOutcome(reason="restart ended with exit code 7", seconds=0.3, state=UnitState.FAILED,
                           output=("no device",), log=(LAST_LINE,))  # fmt: skip
    return UnitOutcome(seconds=4.2, state=UnitState.RUNNING)


ANSWERS: dict[Any, Any] = {ListUnits: lambda _: GROUPS, ControlUnit: _controlled}
