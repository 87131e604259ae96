"""The fleet's screen on a scripted source whose figures move: ``python -m bench.fleet_alone ROBOTS``."""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.robot_summary import LostMessages, RobotState, RobotSummary
from rsb_extras.fleet.fleet import Memory, RobotFleet
from rsb_extras.fleet.fleet_app import FleetApp
from rsb_extras.fleet.fleet_table import FleetView

if TYPE_CHECKING:
    from rsb_bridge.control.remote_engine import RemoteEngine

COUNT = int(sys.argv[1])
CHANGING = 0.5  # share of the robots in a refresh
FAULTS = (RobotState.MISSING, RobotState.FAULT, RobotState.WARN)


class MovingSource:
    """Rates change all the time, and a state every few seconds."""

    name, kind, problem, way, gone, empty = "control", "server", "", "", "gone", "none"

    def __init__(self) -> None:
        began = time.time()
        self._robots = [
            RobotSummary(
                name=f"robot{number}", group=("hall", "yard")[number % 2], state=RobotState.OK, since=began - number,
                seen=began, host=f"10.0.1.{number}:7060", version="0.1.0", links_up=1, links=1, flowing=12, routes=12,
                messages_from_robot=120.0, bytes_from_robot=3e5, bytes_to_robot=4e3, loss=LostMessages(0.0, 60.0),
            )
            for number in range(COUNT)
        ]  # fmt: skip

    def start(self) -> None:
        pass

    def wait(self) -> None:
        pass

    def stop(self) -> None:
        pass

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        raise NotImplementedError

    def robots(self) -> list[RobotSummary]:
        """Return the robots of the next moment."""
        now = time.time()
        for at, robot in enumerate(self._robots):
            if random.random() < CHANGING:
                state, since = robot.state, robot.since
                if random.random() < 0.002:
                    state = random.choice(FAULTS) if state is RobotState.OK else RobotState.OK
                    since = now
                self._robots[at] = msgspec.structs.replace(
                    robot, state=state, since=since, why="" if state is RobotState.OK else "/scan STALE: nothing",
                    seen=now, messages_from_robot=random.gauss(120, 2), bytes_from_robot=random.gauss(3e5, 2e3),
                )  # fmt: skip
        return list(self._robots)


FleetApp(
    RobotFleet([MovingSource()], Memory(None), Clock()), FleetView(), theme="dark", config=Path("/nonexistent")
).run()
