"""Takes the picture of the fleet's screen on the demo's fleet (``docs/screenshots.py``)."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING

import msgspec
from docs.screenshots import LOW, Album, until

from rsb_bridge.feature_api import RobotState
from rsb_extras.fleet.fleet_app import FleetApp
from rsb_extras.fleet.fleet_demo import seen, simulated, trouble
from rsb_extras.fleet.fleet_table import FleetView

if TYPE_CHECKING:
    from rsb_extras.fleet.fleet import FleetSource, Robot, RobotFleet

ROBOTS = 8


async def of_a_fleet(album: Album) -> None:
    """The one of the demo of a fleet, when a robot is away, and another one has lost a topic."""
    over = threading.Event()
    with simulated(ROBOTS) as running, seen(running) as fleet:
        _of_no_machine(fleet.sources[0])
        app = FleetApp(fleet, FleetView(), theme="dark", config=album.config)
        async with app.run_test(size=LOW) as pilot:
            await until(lambda: all(robot.summary.battery for robot in robots(fleet)), pilot)
            troubling = threading.Thread(target=trouble, args=(running, over.is_set))
            troubling.start()
            try:
                await until(lambda: {RobotState.MISSING, RobotState.FAULT} <= states_of(fleet), pilot)
                await pilot.pause(1.0)
                # On the robot with the fault.
                await album.take(pilot, "fleet", "g", "j", when=lambda words: "STALE" in words)
            finally:
                over.set()
                await asyncio.to_thread(troubling.join)


def _of_no_machine(source: FleetSource) -> None:
    """Have each robot be a machine of its own, instead of all of them this one."""
    known = source.robots
    source.robots = lambda: [msgspec.structs.replace(each, host=each.name) for each in known()]  # type: ignore[method-assign]


def robots(fleet: RobotFleet) -> list[Robot]:
    """Those with a battery."""
    return [robot for robot in fleet.robots() if robot.summary.name != "control"]


def states_of(fleet: RobotFleet) -> set[RobotState]:
    """How the robots are."""
    return {robot.summary.state for robot in robots(fleet)}


PARTS = {"fleet": of_a_fleet}
