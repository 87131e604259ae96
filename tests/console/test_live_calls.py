"""The console on a real engine: services and parameters of a node on the other side."""

import os
from pathlib import Path

import pytest
from tests.console.driving import choose, fill, shown, until
from tests.console.live import THERE, Pair, console, running, watch
from textual.pilot import Pilot

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot
from rsb_console.app import ConsoleApp
from rsb_console.screens.call_screen import CallText

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("std_srvs", reason="needs ROS 2's services")
NODE = f"console_{os.getpid()}"
MODE = f"/{NODE}/set_mode"


def found(app: ConsoleApp, name: str) -> RouteSnapshot | None:
    return next((route for route in app.snapshot().routes if route.topic == name), None)


def is_offered(app: ConsoleApp, name: str) -> bool:
    route = found(app, name)
    return route is not None and next(stage for stage in route.stages if stage.name == "offered").done is True


async def usable(app: ConsoleApp, pilot: Pilot[None], name: str) -> None:
    """Wait until it can be called, and put the cursor there."""
    await until(pilot, lambda: is_offered(app, name), f"{name} is offered")
    await pilot.press("escape", "slash", *f"topic:{name}$", "enter")
    await until(pilot, lambda: (row := app.main.topics.selected) is not None and row.topic == name, "the cursor on it")


def test_service_and_parameter_of_far_node(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Topic(MODE, "transmit", kind="service"), Topic(f"/{NODE}", "transmit", kind="parameters"))
    app = console(pair.client_path)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "● LINKED")
        await shown(pilot, "1 service, parameters of 1 node")
        await usable(app, pilot, MODE)
        await pilot.press("C")
        await shown(pilot, "data: false")
        await fill(pilot, request="data: true")
        await pilot.press("f9")
        await shown(pilot, f"It is sent once, to /{NODE} behind 127.0.0.1")
        await pilot.press("y")
        await shown(pilot, "message: moved on")
        await pilot.press("escape")
        await shown(pilot, "answered            1  100.0 %")
        await usable(app, pilot, f"/{NODE}")
        await pilot.press("C")
        await shown(pilot, "set one parameter")
        for value, words in (("0.9", CallText.VALUE_SET), ("1.5", "refuses it: too fast"), ("fast", "Wrong")):
            await fill(pilot, name="speed", value=value)
            await pilot.press("f9")
            await shown(pilot, f"Set speed of /{NODE}?")
            await pilot.press("y")
            await shown(pilot, words)
        await choose(pilot, "lane", "get_parameters")
        await shown(pilot, "names: []")
        await fill(pilot, request="names: [speed, speed]")
        await pilot.press("f9", "y")
        await shown(pilot, "double_value: 0.9")

    with pair.server(), running("tests.console.answerer", str(THERE), NODE, MODE):
        watch(app, steps)
