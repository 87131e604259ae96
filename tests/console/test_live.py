"""The console on a real engine, against a real other side in another process."""

import os
from pathlib import Path

import pytest
from tests.console.driving import gone, shown, until
from tests.console.live import Pair, console, talker, watch
from textual.pilot import Pilot

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_console.app import ConsoleApp

pytest.importorskip("rclpy", reason="needs ROS 2")
CHATTER = f"/console_{os.getpid()}/chatter"


def state(app: ConsoleApp) -> State | None:
    return None if app.main.topics.selected is None else app.main.topics.selected.state


async def flowing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Wait until the selected topic carries what its talker says, which nobody listens to on the other side."""
    await until(
        pilot, lambda: state(app) is State.UNHEARD and (route := app.main.topics.route) and route.rate > 0, "messages"
    )


def test_a_topics_life(tmp_path: Path) -> None:
    """Flows, goes stale with its publisher, flows again, is paused, resumed, removed."""
    pair = Pair(tmp_path, Topic(CHATTER, "transmit", stale_after=1.0))
    app = console(pair.client_path)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "● LINKED")
        with talker(CHATTER):
            await flowing(app, pilot)
            await shown(pilot, "◇ 1 unheard")
            await shown(pilot, "server: nobody subscribes to")
        await until(pilot, lambda: state(app) is State.STALE, "stale")
        await shown(pilot, "▲ STALE")
        with talker(CHATTER):
            await flowing(app, pilot)
            await pilot.press("p")
            await until(pilot, lambda: state(app) is State.PAUSED, "paused")
            await pilot.press("p")
            await flowing(app, pilot)
            await pilot.press("d")
            await shown(pilot, f"Remove {CHATTER}?")
            await pilot.press("enter")  # the focus is on No
            await gone(pilot, "Remove /")
            await flowing(app, pilot)  # a busy machine lets it go stale for a moment
            await pilot.press("d", "y")
            await shown(pilot, "0 topics")

    with pair.server():
        watch(app, steps)
