"""Takes the pictures of the console on the running demos: ``make screenshots``, or those that are named."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.model.robot_summary import RobotState
from rsb_console.app import ConsoleApp
from rsb_console.command.demo import seen, simulated, trouble
from rsb_console.fleet_app import FleetApp
from rsb_console.screens.view_screen import ViewScreen
from rsb_console.session.demo_session import running_demo
from rsb_console.widgets.fleet_table import FleetView

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.pilot import Pilot

    from rsb_console.fleet.fleet import FleetSource, Robot, RobotFleet

PICTURES = Path(__file__).parent / "pictures"
FLOWING = 6  # topics of the demo, its service, and its robot's parameters
HISTORY = 60  # s: long enough for a curve to be worth a picture
WIDE, NARROW, LOW = (120, 36), (80, 24), (120, 24)
ROBOTS = 8


async def take(pilot: Pilot[Any], name: str, *keys: str) -> None:
    """Press `keys`, and keep what the screen shows then."""
    await pilot.press(*keys)
    await pilot.pause(1.0)
    pilot.app.save_screenshot(f"{name}.svg", str(PICTURES))


async def until(condition: Callable[[], bool], pilot: Pilot[Any], seconds: float = 90.0) -> None:
    """Wait for it."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit("the demo does not do what the pictures want")
        await pilot.pause(0.5)


def states(app: ConsoleApp) -> list[str]:
    """How the topics are."""
    return [route.state.value for route in app.snapshot().routes]


async def of_a_robot() -> None:
    """Those of the demo."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=PICTURES)
        try:
            async with app.run_test(size=WIDE) as pilot:
                await until(lambda: states(app).count("ok") == FLOWING, pilot)
                await until(lambda: len(app.snapshot().routes[0].history) > HISTORY, pilot)
                demo.robot.mute("/scan")  # the one fault of the pictures, which the lines at the top explain
                await until(lambda: "stopped" in states(app), pilot)
                await pilot.pause(1.0)  # the table puts the fault on top, and the cursor stays on its topic
                await take(pilot, "main", "g")
                await take(pilot, "add-topic", "a")
                await take(pilot, "help", "escape", "question_mark")
                await pilot.press("escape", "slash", *"set_light", "enter", "C")
                await until(lambda: "data" in app.screen.form.values.get("request", ""), pilot)  # type: ignore[attr-defined]
                await pilot.press("f9", "y")
                await take(pilot, "call")
                await take(pilot, "service", "escape")
                await pilot.press("escape", "g", "t", "t")
                await take(pilot, "light")
                await pilot.press("t", "t")
                await pilot.resize_terminal(*NARROW)
                await take(pilot, "narrow")
                await take(pilot, "detail", "enter")
        finally:
            await asyncio.to_thread(app.stop)


async def of_pictures() -> None:
    """Those of the robot's camera and map."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=PICTURES)
        try:
            async with app.run_test(size=NARROW) as pilot:
                await until(lambda: states(app).count("ok") == FLOWING, pilot)
                await pilot.press("V")
                await pilot.pause(2.0)
                await pilot.press(*"camera", "enter")
                await until(lambda: drawn(app), pilot)
                await take(pilot, "look-camera", "greater_than_sign")
                await pilot.press("d", "A", "y")
                await until(lambda: any(each.arming and each.arming.armed for each in app.snapshot().routes), pilot)
                await pilot.press(*"iiuu")
                await pilot.press("u")
                pilot.app.save_screenshot("drive.svg", str(PICTURES))  # before the robot stands again
                await pilot.press("escape", "escape", "slash", *"map", "enter", "v")
                await until(lambda: drawn(app), pilot)
                await pilot.pause(3.0)
                await take(pilot, "look-map")
                await take(pilot, "goal", "g", *["right"] * 8, *["up"] * 3)
        finally:
            await asyncio.to_thread(app.stop)


def drawn(app: ConsoleApp) -> bool:
    """Whether a picture of a message is on the screen."""
    return isinstance(app.screen, ViewScreen) and app.screen.has_content


async def of_a_fleet() -> None:
    """The one of the demo of a fleet, when a robot is away, and another one has lost a topic."""
    over = threading.Event()
    with simulated(ROBOTS) as running, seen(running) as fleet:
        _of_no_machine(fleet.sources[0])
        app = FleetApp(fleet, FleetView(), theme="dark", config=PICTURES)
        async with app.run_test(size=LOW) as pilot:
            await until(lambda: all(robot.summary.battery for robot in robots(fleet)), pilot)
            troubling = threading.Thread(target=trouble, args=(running, over.is_set))
            troubling.start()
            try:
                await until(lambda: {RobotState.MISSING, RobotState.FAULT} <= states_of(fleet), pilot)
                await pilot.pause(1.0)
                await take(pilot, "fleet", "g", "j")  # on the robot with the fault
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


PARTS = {"robot": of_a_robot, "look": of_pictures, "fleet": of_a_fleet}

if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for part in sys.argv[1:] or PARTS:
        asyncio.run(PARTS[part]())
