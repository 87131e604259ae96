"""The demo of a fleet: on its screen in a real terminal, and headless with a line for each engine."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.console.scripted import ScriptedEngine
from tests.console.terminal import COMMAND, Terminal
from tests.console.tmux import Tmux
from tests.support.long import long_cases
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.robot_summary import RobotState, RobotSummary
from rsb_console.child import ChildProcess
from rsb_console.command.headless import Signals, bridge_until_told
from rsb_extras.demo.demo_command import HOW_TO_END
from rsb_extras.demo.demo_session import SimulatedPart, own_domain
from rsb_extras.fleet import fleet_demo as demo
from rsb_extras.fleet.fleet import Robot
from rsb_extras.fleet.tests import fleet_places

pytest.importorskip("rclpy", reason="needs ROS 2")
pytestmark = pytest.mark.usefixtures("only_demo")

WITHIN = 120.0
WITHOUT_ZENOH = """
import sys
sys.modules["zenoh"] = None
from rsb_console.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


@pytest.mark.parametrize(
    ("program", "engines"),
    [(("-m", "rsb_console"), ["control", "robot1", "robot2"]), (("-c", WITHOUT_ZENOH), ["robot1", "robot2"])],
    ids=["zenoh", "tcp"],
)
def test_each_engine_is_linked_and_has_a_line(program: tuple[str, ...], engines: list[str], temporary: Path) -> None:
    command = [sys.executable, *program, "demo", "--fleet", "--robots", "2", "--no-ui", "--seconds", "0.1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WITHIN, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()[-len(engines) :]
    assert [line.split()[:2] for line in lines] == [[name, "ok"] for name in engines], done.stdout
    assert "unheard" not in "".join(lines), done.stdout
    assert [*temporary.iterdir()] == []


def later(robot: SimulatedPart, messages: int) -> None:
    """Wait until a robot has published that many further messages of its battery, at 1 Hz."""
    before = robot.published["/battery_state"]
    eventually(lambda: robot.published["/battery_state"] >= before + messages, WITHIN)


def test_listener_hears_robots_and_muted_topic_stops(tmp_path: Path) -> None:
    domain = own_domain()
    robot = SimulatedPart.start("robot", domain, tmp_path)
    listener = SimulatedPart.start("listener", domain, tmp_path, "/battery_state", "/pose")
    try:
        eventually(lambda: listener.received.get("/battery_state"), WITHIN)
        assert listener.received["/pose"] == 0
        robot.mute("/scan")

        def stands_still() -> bool:
            scans = robot.published["/scan"]
            later(robot, 2)
            return robot.published["/scan"] == scans

        eventually(stands_still, WITHIN)  # reports from before may still come
    finally:
        robot.stop()
        listener.stop()


class Looks:
    """A fleet that is another one at each look; the last one stays."""

    def __init__(self, *looks: dict[str, RobotState | None]) -> None:
        self._looks = [*looks]

    def robots(self) -> list[Robot]:
        look = self._looks.pop(0) if len(self._looks) > 1 else self._looks[0]
        return [self._robot(name, state) for name, state in look.items()]

    def _robot(self, name: str, state: RobotState | None) -> Robot:
        seen = None if state is None else time.time() + 1.0
        return Robot(None, RobotSummary(name=name, state=state or RobotState.WAITING, seen=seen))  # type: ignore[arg-type]


@pytest.mark.parametrize(("as_they_are", "expected"), [(False, RobotState.OK), (True, RobotState.WAITING)])
def test_slow_engines_are_awaited(as_they_are: bool, expected: RobotState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until each has reported; and until it is ok, unless something is meant to be wrong."""
    fleet_places.DEMO_LOOK_EVERY.set(monkeypatch, 0.0)
    ok, fault, waiting = RobotState.OK, RobotState.FAULT, RobotState.WAITING
    looks: list[dict[str, RobotState | None]] = [{}, {"a": ok}, {"a": ok, "b": None}]
    looks += [{"a": ok, "b": waiting}, {"a": ok, "b": fault}, {"a": ok, "b": ok}]
    found = demo.heard(Looks(*looks), 2, lambda: as_they_are)  # type: ignore[arg-type]
    assert [(robot.summary.name, robot.summary.state) for robot in found] == [("a", ok), ("b", expected)]


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
def test_screen_opens_leads_to_robot_and_back(tmp_path: Path, temporary: Path) -> None:
    with Tmux(tmp_path, str(COMMAND), "demo", "--fleet", "--robots", "2") as tmux:
        tmux.wait_for("robot2", WITHIN)
        demo = int(tmux("display-message", "-p", "#{pane_pid}"))
        started = {demo} | descendants(demo)
        assert len(started) >= 4  # itself, the router, the control side, the robot
        tmux("send-keys", "/", "robot:robot2", "Enter")
        tmux.wait_for("1 of 3", WITHIN)
        tmux("send-keys", "Enter")
        tmux.wait_for("client robot2", WITHIN)
        tmux("send-keys", "q")
        tmux.wait_for("1 of 3", WITHIN)
        tmux("send-keys", "q")
        tmux.agree("Quit?")
        eventually(lambda: not running(started), WITHIN, "the end of all processes")
    assert [*temporary.iterdir()] == []


@pytest.mark.parametrize(("seen", "how"), [*long_cases(("starting", signal.SIGTERM)), ("robot1", signal.SIGHUP)])
def test_signal_leaves_nothing_behind(seen: str, how: signal.Signals, temporary: Path) -> None:
    with Terminal(str(COMMAND), "demo", "--fleet", "--robots", "1") as terminal:
        terminal.wait_for(seen, WITHIN)
        started = descendants(terminal.pid)
        if how is signal.SIGHUP:
            terminal.hang_up()
        else:
            terminal.kill(how)
        terminal.exit_code(WITHIN)
    eventually(lambda: not running(started), WITHIN, "the end of all processes")
    assert [*temporary.iterdir()] == []


@pytest.mark.parametrize(
    ("options", "seen"),
    [
        ((), "LINKED"),
        *long_cases((("--no-ui",), " ok |"), (("--fleet", "--robots", "1"), "robot1")),
        *long_cases((("--fleet", "--robots", "1", "--no-ui"), HOW_TO_END)),
    ],
    ids=["console", "headless", "fleet", "headless-fleet"],
)
def test_no_process_outlives_a_demo_that_is_killed(options: tuple[str, ...], seen: str) -> None:
    """A child of every kind has `ChildProcess`: `test_child_that_ignores_its_parents_end_is_killed`."""
    with Terminal(str(COMMAND), "demo", *options) as terminal:
        terminal.wait_for(seen, WITHIN)
        started = descendants(terminal.pid)
        assert len(started) >= 3  # the robot and its bridge, and the desk; or the router, the control side, the robot
        terminal.kill(signal.SIGKILL)
        eventually(lambda: not running(started), WITHIN, "the end of all processes")


def test_a_time_ends_it(capfd: pytest.CaptureFixture[str]) -> None:
    engine = ScriptedEngine()
    with Signals(ignore_hangup=False, has_terminal=True) as signals:
        assert bridge_until_told(engine, signals, log_format="json", seconds=0.05) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == EventCode.ENGINE_STOPPING


DEAF = """
import signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("deaf", flush=True)
time.sleep(600)
"""
PARENT = """
import subprocess, sys
from rsb_console.child import ChildProcess
child = ChildProcess("deaf", stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
sys.stdin.read()
"""


def test_child_that_ignores_its_parents_end_is_killed(tmp_path: Path) -> None:
    (tmp_path / "deaf.py").write_text(DEAF)
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environ
    ) as parent:
        assert parent.stdout
        child = int(parent.stdout.readline())
        assert running({child})
        parent.kill()
    eventually(lambda: not running({child}), WITHIN, "the end of the child")


def test_output_of_childs_libraries_stays_in_child(tmp_path: Path) -> None:
    (tmp_path / "prints.py").write_text("import os\nos.write(1, b'theirs')\nprint('ours')\n")
    child = ChildProcess(
        "prints", stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(tmp_path)}
    )
    assert child.communicate(timeout=WITHIN) == ("ours\n", "theirs")


def descendants(pid: int) -> set[int]:
    tasks, children = Path(f"/proc/{pid}/task"), set[int]()
    while tasks.exists():
        try:
            children = {int(child) for thread in tasks.iterdir() for child in (thread / "children").read_text().split()}
        except (FileNotFoundError, ProcessLookupError):
            continue  # a thread has ended meanwhile: its children are another one's now
        break
    return children.union(*map(descendants, children))


def running(processes: set[int]) -> set[int]:
    return {process for process in processes if Path(f"/proc/{process}").exists()}
