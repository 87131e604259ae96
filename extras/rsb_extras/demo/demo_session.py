"""The demo session: a simulated robot in one domain, its desk in another, and a bridge between, on this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import os
import random
import socket
import subprocess
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.feature_api import EngineError, EventCode, RosError, Session, Topic
from rsb_bridge.model.limits import discovery_domain
from rsb_bridge.ros.distribution import check_middleware
from rsb_console.child import ChildProcess

if TYPE_CHECKING:
    from collections.abc import Iterator

_HOST = "127.0.0.1"
_FIRST_DOMAIN, _DOMAIN_PAIRS = 82, 10
"""Up to 101, the last one whose ports Linux gives to no other program; the project's tests have those below."""
_PORTS = range(20_000, 27_900)
"""Ports below the demo's own, and outside the kernel's range for clients, as a client could otherwise take the server's
port."""
_started = itertools.count()
_READY_WITHIN = 15.0  # s; after that the console shows that the bridge waits for the robot
# The robot also has /battery_state, for the operator to add, and more to look at.
_TOPICS = (
    Topic(topic="/scan", direction="receive", protocol="udp", expected_rate=10.0),
    Topic(topic="/odom", direction="receive", protocol="udp", expected_rate=50.0),
    Topic(topic="/map", direction="receive", protocol="tcp", compression="zstd"),
    Topic(topic="/plan", direction="receive", protocol="tcp", expected_rate=1.0),
    Topic(topic="/tf", direction="receive", protocol="udp", expected_rate=25.0),
    Topic(topic="/tf_static", direction="receive", protocol="tcp"),
    Topic(topic="/goal_pose", direction="transmit", protocol="tcp", expected_rate=1.0),
    Topic(topic="/cmd_vel", direction="transmit", type="geometry_msgs/msg/Twist", protocol="tcp", arm=True),
    Topic(topic="/set_light", direction="transmit", kind="service", timeout=5.0),
    Topic(topic="/simulated_robot", direction="transmit", kind="parameters", timeout=5.0),
)


@dataclass(slots=True)
class SimulatedPart:
    """The robot or the desk, a separate process that ends when its standard input is closed.

    It runs in a process group of its own, so that a Ctrl-C in the terminal does not reach it.

    Attributes:
        published: messages that it has published, by topic.
        received: messages that it has received, by topic.
    """

    process: subprocess.Popen[str]
    published: dict[str, int] = field(default_factory=dict)
    received: dict[str, int] = field(default_factory=dict)
    _reader: threading.Thread = field(init=False, repr=False)

    @classmethod
    def start(cls, part: str, domain: int, folder: Path, *topics: str) -> SimulatedPart:
        with (folder / f"{part}.log").open("w") as log:  # Fast DDS writes to standard error
            process = ChildProcess(
                "rsb_extras.demo.simulated_part",
                part,
                str(domain),
                *topics,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                process_group=0,
            )
        self = cls(process)
        self._reader = threading.Thread(target=self._read, name=f"demo-{part}", daemon=True)
        self._reader.start()
        return self

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                counts = json.loads(line)
                self.published, self.received = counts["published"], counts["received"]

    def mute(self, topic: str) -> None:
        """Have it stop publishing a topic, though its publisher stays: the fault that a newcomer is shown."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{topic}\n")
        self.process.stdin.flush()

    def stop(self) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join(5)  # its last line has the last counts


@dataclass(slots=True)
class Demo:
    """A running demo, except for the desk's side of the bridge, which the caller runs.

    Attributes:
        path: the session file of the desk's side; its key file is in the same folder.
        session: the session in that file.
    """

    path: Path
    session: Session
    robot: SimulatedPart
    desk: SimulatedPart


@contextlib.contextmanager
def running_demo() -> Iterator[Demo]:
    """Start the robot, its side of the bridge, and the desk; stop them at the end.

    Raises:
        EngineError: ROS is missing, or the robot's side of the bridge could not start.
    """
    need_ros()
    # Other ROS programs must neither hear the demo nor disturb it.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # A demo that takes over from another begins before the other has ended.
    robot_domain = own_domain(next(_started))
    desk_domain = robot_domain + 1
    with tempfile.TemporaryDirectory(prefix="rsb-demo-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        write_key(folder / "demo.key")
        common = {"name": "demo", "server_ip": _HOST, "server_port": free_port(), "key_file": "demo.key"}
        save(Session(role="server", domain_id=robot_domain, **common), folder / "robot.yaml")  # type: ignore[arg-type]
        session = Session(role="client", domain_id=desk_domain, topics=_TOPICS, **common)  # type: ignore[arg-type]
        save(session, folder / "demo.yaml")
        robot = SimulatedPart.start("robot", robot_domain, folder)
        stack.callback(robot.stop)
        desk = SimulatedPart.start("desk", desk_domain, folder)
        stack.callback(desk.stop)
        stack.enter_context(_bridge_process(folder / "robot.yaml"))
        yield Demo(folder / "demo.yaml", session, robot, desk)


@contextlib.contextmanager
def _bridge_process(path: Path) -> Iterator[None]:
    """Run the robot's side of the bridge as on a robot, and wait until it listens, for `_READY_WITHIN` at the most."""
    options = ["--no-ui", "--log-format", "json", "--control", str(path.with_suffix(".sock"))]
    log_path = path.parent / "robot.log"
    with log_path.open("w") as log:
        process = ChildProcess(
            "rsb_console", "run", *options, str(path), stdin=subprocess.DEVNULL, stdout=log, stderr=log, process_group=0
        )
    try:
        deadline = time.monotonic() + _READY_WITHIN
        while f'"{EventCode.ENGINE_LISTENING}"' not in log_path.read_text() and time.monotonic() < deadline:
            if process.poll() is not None:
                raise EngineError(f"the robot's side of the bridge did not start: {log_path.read_text().strip()}")
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        try:
            # A bridge ends within 5 s (docs/headless.md).
            process.wait(6)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def own_domain(before: int = 0) -> int:
    """Return the first of two ROS domains for a demo of this process.

    Args:
        before: number of demos that this process has started before.
    """
    # Domains follow the process, so that two demos on a machine seldom have the same.
    return _FIRST_DOMAIN + 2 * ((os.getpid() + before) % _DOMAIN_PAIRS)


def need_ros() -> None:
    """Raise an error if the demo's ROS packages are missing.

    Raises:
        EngineError: they are; it says what to do.
    """
    missing = [
        name
        for name in ("rclpy", "sensor_msgs", "nav_msgs", "diagnostic_msgs", "std_srvs")
        if importlib.util.find_spec(name) is None
    ]
    if missing:
        raise EngineError(
            f"the demo needs {', '.join(missing)}: source your ROS 2's setup file (source /opt/ros/jazzy/setup.bash), "
            "or on x86-64 Linux `pip install 'rsb-console[ros]'`"
        )
    try:
        check_middleware(os.environ)
    except RosError as error:
        raise EngineError(str(error)) from None


def free_port() -> int:
    """Return a port that neither TCP nor UDP uses, and that no ROS domain needs for discovery.

    Raises:
        EngineError: all are in use.
    """
    for port in random.sample(_PORTS, len(_PORTS)):
        if discovery_domain(port) is not None:
            continue
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp, contextlib.suppress(OSError):
            tcp.bind((_HOST, port))
            udp.bind((_HOST, port))
            return port
    raise EngineError("no port is free")
