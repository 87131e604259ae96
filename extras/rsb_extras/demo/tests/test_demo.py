"""The demo, as a command and in the console."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import is_shown, on_main, shown, until
from tests.console.live import flows, watch
from tests.support import surroundings
from tests.support.captured import own_lines
from tests.support.commands import rsb_console
from tests.support.locks import alone
from tests.support.wording import says

from rsb_console.app import ConsoleApp
from rsb_console.command.argument_values import ValueProblem
from rsb_console.command.local_commands import LocalText
from rsb_console.screens.dialog import ConfirmScreen
from rsb_extras.demo.demo_session import running_demo

if TYPE_CHECKING:
    from textual.pilot import Pilot

pytest.importorskip("rclpy", reason="needs ROS 2")
COMMAND = str(Path(sys.executable).with_name("rsb-console"))


def test_it_ends_after_some_time_only() -> None:
    run = rsb_console("demo", "--seconds", "0")
    assert run.returncode == 2
    assert ValueProblem.NOT_ABOVE_0(text="0", noun="number of seconds") in run.stderr


def test_its_console_is_refused_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open() as nothing:
        surroundings.set_stdin(monkeypatch, nothing)
        run = rsb_console("demo")
    assert run.returncode == 2
    assert says(run.stderr, LocalText.NO_TERMINAL)
    assert "--no-ui" in run.stderr


@pytest.mark.usefixtures("only_demo")
def test_demo_bridges_and_leaves_one_topic_to_add() -> None:
    """A Ctrl-C goes to the terminal's whole process group: the simulated robot writes no traceback for it."""
    environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with subprocess.Popen(
        [COMMAND, "demo", "--no-ui", "--seconds", "600"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    ) as run:
        assert run.stdout
        seen = ""
        while ": 1 disarmed, 9 ok |" not in seen:  # each topic flows, or is answered; /cmd_vel waits for an operator
            line = run.stdout.readline()
            assert line
            seen += line
        os.killpg(run.pid, signal.SIGINT)
        output, errors = run.communicate(timeout=120)
    assert (run.returncode, own_lines(errors)) == (0, [])
    assert "refused" not in seen
    assert "/goal_pose" in output
    assert "NOTHING CAME" not in output
    assert "/battery_state" not in seen + output


@pytest.mark.parametrize("temporary", [False, True])
@on_main(given=("temporary",))
async def test_a_running_demo_is_not_replaced_by_itself(app: ConsoleApp, pilot: Pilot[None], temporary: bool) -> None:
    await pilot.press("f4")
    await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
    assert isinstance(app.screen, ConfirmScreen)
    assert is_shown(app, "instead") is not temporary
    assert is_shown(app, "Start again" if temporary else "Run")
    await pilot.press("n")
    assert app.engine is not None


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
