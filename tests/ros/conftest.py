"""Real ROS nodes: ours, and stock rclpy's, on domains of this run alone."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced

from rsb_bridge.ros.self_test import findings

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # read by each context that joins a domain

from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from tests.ros.domains import DOMAIN
from tests.support import waiting
from tests.support.participants import KnownNode, join

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.ros.node import RosNode


@pytest.fixture
def eventually() -> Callable[[Callable[[], Any]], Any]:
    """Wait for a condition, with a deadline, and return what it returned."""

    return waiting.eventually


@pytest.fixture
def open_node() -> Iterator[Callable[..., RosNode]]:
    """Start our nodes; they are stopped at the end."""
    nodes: list[RosNode] = []

    def start(domain_id: int = DOMAIN, name: str = "robot1") -> RosNode:
        node = KnownNode(domain_id, name)
        node.start()
        nodes.append(node)
        return node

    yield start
    for node in nodes:
        node.stop()


@pytest.fixture
def printed(capfd: pytest.CaptureFixture[str]) -> Callable[[], str]:
    """Return the output since the last time, without Fast DDS's lines about ports of killed processes."""

    def read() -> str:
        lines = "".join(capfd.readouterr()).splitlines(keepends=True)
        return "".join(line for line in lines if "RTPS_TRANSPORT_SHM" not in line)

    return read


@pytest.fixture(params=["raw", "typed"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Select how calls of installed types are carried: as here, or as with another middleware, which has no wheel."""
    name: str = request.param
    if name == "typed":
        found = findings()._replace(no_calls="this is another middleware")
        replaced.FINDINGS.set(monkeypatch, lambda: found)
    return name


@pytest.fixture
def rclpy_node() -> Iterator[Node]:
    """A stock rclpy node, as a robot's own programs are."""
    with _stock(start_parameter_services=True) as node:
        yield node


@pytest.fixture
def stock() -> Iterator[Node]:
    """A stock rclpy node that is spun."""
    with _stock(start_parameter_services=False) as node:
        executor = MultiThreadedExecutor(4, context=node.context)
        executor.add_node(node)
        spinning = threading.Thread(target=executor.spin)
        spinning.start()
        yield node
        executor.shutdown()
        spinning.join(60)


@contextlib.contextmanager
def _stock(*, start_parameter_services: bool) -> Iterator[Node]:
    node: Node

    def enter() -> Node:
        nonlocal node
        context = Context()
        context.init([], domain_id=DOMAIN)
        node = Node(
            "stock",
            context=context,
            enable_rosout=False,
            use_global_arguments=False,
            start_parameter_services=start_parameter_services,
        )
        return node

    def leave() -> None:
        node.destroy_node()
        node.context.shutdown()
        node.context.destroy()

    join(DOMAIN, enter, leave)
    yield node
    leave()
