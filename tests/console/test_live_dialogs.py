"""The dialogs on a real engine, against a real other side in another process."""

import contextlib
import os
from pathlib import Path

import pytest
from tests.console.driving import gone, shown, until
from tests.console.live import Pair, console, flows, talker, watch
from tests.support import constants
from tests.support.locks import alone
from textual.pilot import Pilot

from rsb_bridge.model.session import Topic
from rsb_console.app import ConsoleApp
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.session.demo_session import running_demo

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


def test_demo_runs_from_welcome_and_leaves_nothing() -> None:
    app = ConsoleApp(None, None, theme="dark")
    folders: list[Path] = []

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "a simulated robot")
        await pilot.press("d")
        await until(pilot, lambda: flows(app.snapshot(), "/odom"), "the odometry")
        folders.append(app.base)
        assert app.base.is_dir()

    with alone("demo"):  # two of them could choose the same domains
        watch(app, steps)
    assert not folders[0].exists()


def test_demo_that_replaces_demo_ends_its_robot() -> None:
    """Otherwise, after `rsb-console demo` and F4, the robots of both would publish the same topics."""
    with alone("demo"), contextlib.ExitStack() as resources:
        first = resources.enter_context(running_demo())
        app = ConsoleApp(first.session, first.path, theme="dark", temporary=True, resources=resources)

        async def steps(pilot: Pilot[None]) -> None:
            await until(pilot, lambda: flows(app.snapshot(), "/odom"), "the odometry")
            await pilot.press("f4")
            await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
            await pilot.press("y")
            await until(pilot, lambda: app.base != first.path.parent, "another demo")
            await until(pilot, lambda: first.robot.process.poll() is not None, "the end of the first robot")
            assert first.desk.process.poll() is not None
            assert not first.path.exists()
            await until(pilot, lambda: flows(app.snapshot(), "/odom"), "the odometry of the second robot")
            assert app.engine is not None
            assert app.engine.session.domain_id != first.session.domain_id

        watch(app, steps)
    assert not app.base.exists()
