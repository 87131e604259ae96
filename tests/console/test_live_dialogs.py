"""The dialogs on a real engine, against a real other side in another process."""

import os
from pathlib import Path

import pytest
from tests.console.driving import gone, shown, until
from tests.console.live import Pair, console, flows, talker, watch
from tests.support import constants
from textual.pilot import Pilot

from rsb_bridge.model.session import Topic

pytest.importorskip("rclpy", reason="needs ROS 2")
CHATTER = f"/dialogs_{os.getpid()}/chatter"


def test_restart_shows_steps_and_everything_flows_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.RESTART_WITHIN.set(monkeypatch, 60.0)
    pair = Pair(tmp_path, Topic(CHATTER, "transmit"))
    app = console(pair.client_path)

    async def steps(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: flows(app.snapshot(), CHATTER), "20 Hz")
        await pilot.press("R", "y")
        await shown(pilot, "✓ restarted")
        await shown(pilot, "on both sides")
        await shown(pilot, "1 of 1 topics and services accepted")
        await pilot.press("enter")
        await gone(pilot, "✓ restarted")
        await until(pilot, lambda: flows(app.snapshot(), CHATTER), "20 Hz")

    with pair.server(), talker(CHATTER):
        watch(app, steps)


def test_a_restart_that_finds_nobody_says_so(tmp_path: Path) -> None:
    pair = Pair(tmp_path)
    app = console(pair.client_path)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "✗ DOWN")
        await pilot.press("R", "y")
        await shown(pilot, "✗ connecting to")
        await gone(pilot, "✓ restarted")

    watch(app, steps)
