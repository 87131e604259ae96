"""A robot with another ROS 2 distribution than the control PC's: its bridge and its nodes run with `OTHER_PYTHON`.

``make test-kilted`` runs this with Kilted here and Jazzy there.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from tests.calls.ledgers import called
from tests.engine.actions_helpers import FIBONACCI
from tests.support import replaced
from tests.support.bridge import carries, linked
from tests.support.calls import CallNode
from tests.support.fibonacci import FibonacciClient, FibonacciProcess
from tests.support.filled import filled
from tests.support.program import Programs
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.ros.native.typesupport import installed_class

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

OTHER = os.environ.get("OTHER_PYTHON", "")
ROOT = Path(__file__).parents[2]
TOPICS = Topic("/odom_in", "receive"), Topic("/odom_out", "transmit")
_CAMERA = """
import contextlib, sys, rclpy
from rclpy.executors import ExternalShutdownException
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("camera")
node.declare_parameter("rate", 5)
with contextlib.suppress(ExternalShutdownException):
    rclpy.spin(node)
"""

pytestmark = pytest.mark.skipif(not OTHER, reason="OTHER_PYTHON is not set: make test-kilted")


def _start(module: str, *arguments: str, **pipes: Any) -> subprocess.Popen[str]:
    return subprocess.Popen([OTHER, "-m", module, *arguments], text=True, cwd=ROOT, **pipes)


def _version(python: str) -> str:
    command = [python, "-c", "from rsb_bridge.ros.distribution import distribution; print(distribution())"]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=180).stdout.strip()


@pytest.fixture(autouse=True)
def _own_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each process finds the libraries of its own distribution."""
    for name in "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE":  # which the wheels set once
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def robots_bridge(bridge: Bridge, _own_libraries: None) -> Iterator[Programs]:
    """Runs the robot's bridge."""
    with closing(Programs(bridge.folder, _start)) as made:
        yield made


@pytest.fixture
def start() -> Iterator[Callable[..., None]]:
    """Starts programs of the robot."""
    running: list[subprocess.Popen[bytes]] = []

    def begin(*arguments: str) -> None:
        running.append(subprocess.Popen([OTHER, *arguments], cwd=ROOT))

    yield begin
    for each in running:
        each.terminate()
        try:
            each.wait(60)
        except subprocess.TimeoutExpired:
            each.kill()


@pytest.fixture
def robot_calls(robot: Domain, _own_libraries: None) -> Iterator[CallNode]:
    """A node of the robot that serves and calls."""

    def begin(*command: str, **pipes: Any) -> subprocess.Popen[str]:
        return subprocess.Popen([OTHER, *command[1:]], text=True, cwd=ROOT, **pipes)

    with closing(CallNode(robot.id, begin)) as made:
        yield made


@pytest.fixture
def pc_calls(pc: Domain) -> Iterator[CallNode]:
    with closing(CallNode(pc.id)) as made:
        yield made


def _link(bridge: Bridge, robots: Programs, *topics: Topic) -> Engine:
    server = bridge.server()
    robots.start(bridge.client_session(*topics))
    eventually(lambda: linked(server), what="linked")
    return server


def test_the_distributions_differ() -> None:
    here, there = (_version(python) for python in (sys.executable, OTHER))
    assert here != there
    assert {here, there} == {"jazzy", "kilted"}


@pytest.mark.parametrize("installed", [True, False])
def test_messages_cross_and_come_back(
    installed: bool,
    bridge: Bridge,
    robots_bridge: Programs,
    start: Callable[..., None],
    robot: Domain,
    pc: Domain,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The type is installed on both sides, or hidden from the bridge of this one."""
    if not installed:
        replaced.INSTALLED_CLASS.set(monkeypatch, lambda name: None if "Odom" in name else installed_class(name))
    start("tests/ros/stock_relay.py", str(robot.id))
    publisher, listener = pc.publisher("/odom_in", Odometry), pc.listener("/odom_out", Odometry)
    server = _link(bridge, robots_bridge, *TOPICS)
    carries([], server, ["/odom_out"])
    message = filled(Odometry)

    def crosses() -> bool:
        publisher.publish(message)
        return bool(listener.payloads)

    eventually(crosses)
    assert all(deserialize_message(payload, Odometry) == message for payload in listener.payloads)


def test_calls_are_answered_both_ways(
    bridge: Bridge, robots_bridge: Programs, robot_calls: CallNode, pc_calls: CallNode
) -> None:
    robot_calls.serve("/robots")
    pc_calls.serve("/pcs")
    _link(bridge, robots_bridge, called("/pcs"), Topic("/robots", "receive", kind="service"))
    for caller, service in ((pc_calls, "/robots"), (robot_calls, "/pcs")):
        caller.waits_for(service)
        outcome = caller.call(service, 50, at_once=5, size=500, response=50_000)
        assert outcome.right, outcome


def test_an_action_of_the_robot_runs(bridge: Bridge, robots_bridge: Programs, robot: Domain, pc: Domain) -> None:
    with FibonacciProcess(robot.id, _start):
        client = FibonacciClient(pc.id)
        _link(bridge, robots_bridge, FIBONACCI)
        goal = client.send(5)
        assert goal.handle().accepted
        goal.ask()
        status, sequence = goal.result()
        assert (status, sequence[:7]) == ("succeeded", [0, 1, 1, 2, 3, 5, 8])
        client.close()


def test_parameters_of_the_robot_are_set(
    bridge: Bridge, robots_bridge: Programs, start: Callable[..., None], robot: Domain, pc: Domain
) -> None:
    from tests.calls.parameters_helpers import client_of, parameters

    start("-c", _CAMERA, str(robot.id))
    program = Spun(pc.id, "program")
    try:
        _link(bridge, robots_bridge, parameters("/camera"))
        far = client_of(program, "/camera")
        (done,) = program.result(far.set_parameters([Parameter("rate", value=7)])).results
        assert done.successful
        assert program.result(far.get_parameters(["rate"])).values[0].integer_value == 7
    finally:
        program.close()
