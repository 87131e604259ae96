"""The demo: a simulated robot in one domain, its desk in another, and an encrypted bridge between, on this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.engine import Engine
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.middleware import check_middleware
from rsb_console.headless import Signals, bridge_until_told
from rsb_console.shell import FAILURE, INTERRUPTED, OK, complain, keep_output_clean, say

if TYPE_CHECKING:
    from collections.abc import Iterator

_HOST = "127.0.0.1"
_FIRST_DOMAIN, _DOMAIN_PAIRS = 64, 19
_READY_WITHIN = 5.0  # s; later than that the console shows how the bridge waits for the robot
# The robot's /battery_state is left for its operator to add.
_TOPICS = (
    Topic(topic="/scan", direction="receive", protocol="udp", expected_rate=10.0),
    Topic(topic="/odom", direction="receive", protocol="udp", expected_rate=50.0),
    Topic(topic="/map", direction="receive", protocol="tcp", compression="zstd"),
    Topic(topic="/goal_pose", direction="transmit", protocol="tcp", expected_rate=1.0),
)


@dataclass(slots=True)
class _Part:
    """One simulated half, a process of its own: it ends when its standard input does, not with a Ctrl-C."""

    process: subprocess.Popen[str]
    published: dict[str, int] = field(default_factory=dict)
    received: dict[str, int] = field(default_factory=dict)

    @classmethod
    def start(cls, part: str, domain: int, folder: Path) -> _Part:
        command = [sys.executable, "-m", "rsb_bridge.ros.simulation", part, str(domain)]
        with (folder / f"{part}.log").open("w") as log:  # Fast DDS would write over the console's picture
            process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, process_group=0
            )
        self = cls(process)
        threading.Thread(target=self._read, name=f"demo-{part}", daemon=True).start()
        return self

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                counts = json.loads(line)
                self.published, self.received = counts["published"], counts["received"]

    def stop(self) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@dataclass(slots=True)
class Demo:
    """A running demo, but for the desk's side of the bridge.

    Attributes:
        path: the session file for the desk's side; its key lies beside it.
        session: what is in it.
        robot: the simulated robot.
        desk: the simulated desk.
    """

    path: Path
    session: Session
    robot: _Part
    desk: _Part


@contextlib.contextmanager
def running_demo() -> Iterator[Demo]:
    """Start the robot, its side of the bridge, and the desk; stop them at the end.

    Raises:
        EngineError: ROS is missing, or the robot's side of the bridge could not start.
    """
    _need_ros()
    # Whatever else runs here must neither hear nor disturb this.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    robot_domain = _FIRST_DOMAIN + 2 * (os.getpid() % _DOMAIN_PAIRS)
    desk_domain = robot_domain + 1
    with tempfile.TemporaryDirectory(prefix="rsb-demo-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        write_key(folder / "demo.key")
        common = {"name": "demo", "server_ip": _HOST, "server_port": _free_port(), "key_file": "demo.key"}
        save(Session(role="server", domain_id=robot_domain, **common), folder / "robot.yaml")  # type: ignore[arg-type]
        session = Session(role="client", domain_id=desk_domain, topics=_TOPICS, **common)  # type: ignore[arg-type]
        save(session, folder / "demo.yaml")
        robot = _Part.start("robot", robot_domain, folder)
        stack.callback(robot.stop)
        desk = _Part.start("desk", desk_domain, folder)
        stack.callback(desk.stop)
        stack.enter_context(_bridge_process(folder / "robot.yaml"))
        yield Demo(folder / "demo.yaml", session, robot, desk)


def run_demo(*, ui: bool, seconds: float | None) -> int:
    """Run the demo in the console, or without one: then print both ends' counts.

    Args:
        ui: with the console.
        seconds: how long; None: until told to stop.

    Returns:
        The exit code: 0 only if every topic crossed (without the console).
    """
    try:
        with Signals(ignore_hangup=False) as signals, running_demo() as demo:
            if signals.caught:
                return INTERRUPTED
            if ui:
                from rsb_console.app import run_console  # noqa: PLC0415 — needs Textual

                return run_console(
                    demo.path, readonly=False, ascii_only=False, theme=None, on_hangup="stop", temporary=True
                )
            keep_output_clean()
            say(f"a simulated robot, a desk in another ROS domain, and an encrypted bridge between: {demo.path.parent}")
            sys.stdout.flush()
            engine = Engine(demo.session, base=demo.path.parent)
            engine.start()
            code = bridge_until_told(engine, signals, seconds=seconds)
            demo.desk.stop()
            demo.robot.stop()
    except EngineError as error:
        complain(str(error))
        return FAILURE
    return code or _verdict(demo)


def _verdict(demo: Demo) -> int:
    """Print what each end counted, and whether every topic crossed."""
    say(f"{'topic':<12} {'published':>10} {'received':>10}")
    failed = []
    for sender, receiver in ((demo.robot, demo.desk), (demo.desk, demo.robot)):
        for topic, published in sender.published.items():
            if all(topic != bridged.topic for bridged in demo.session.topics):
                continue
            received = receiver.received.get(topic, 0)
            say(f"{topic:<12} {published:>10} {received:>10}  {'ok' if received else 'NOTHING CAME'}")
            if not received:
                failed.append(topic)
    if failed or not demo.robot.published or not demo.desk.published:
        complain(f"the demo failed: {', '.join(failed) or 'a simulated half did not run'}")
        return FAILURE
    return OK


@contextlib.contextmanager
def _bridge_process(path: Path) -> Iterator[None]:
    """The robot's side of the bridge, as it would run on a robot; it listens, unless it is slow to start."""
    command = [sys.executable, "-m", "rsb_console", "run", "--no-ui", str(path)]
    log_path = path.parent / "robot.log"
    with log_path.open("w") as log:
        process = subprocess.Popen(  # noqa: S603
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, process_group=0
        )
    try:
        deadline = time.monotonic() + _READY_WITHIN
        while " listening on " not in log_path.read_text() and time.monotonic() < deadline:
            if process.poll() is not None:
                raise EngineError(f"the robot's side of the bridge did not start: {log_path.read_text().strip()}")
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        try:
            process.wait(6)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _need_ros() -> None:
    """The simulation wants rclpy and common_interfaces."""
    missing = [name for name in ("rclpy", "sensor_msgs", "nav_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        raise EngineError(
            f"the demo needs {', '.join(missing)}: source your ROS 2 (source /opt/ros/jazzy/setup.bash), or on x86-64 "
            "Linux `pip install 'rsb-console[ros]'`"
        )
    try:
        check_middleware(os.environ)
    except RosError as error:
        raise EngineError(str(error)) from None


def _free_port() -> int:
    """A port that is free for TCP and UDP."""
    while True:
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            tcp.bind((_HOST, 0))
            port = int(tcp.getsockname()[1])
            with contextlib.suppress(OSError):
                udp.bind((_HOST, port))
                return port
