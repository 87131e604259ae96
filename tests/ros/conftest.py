"""Real ROS nodes: ours, and stock rclpy's, on domains of this run alone."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.captured import own_lines

from rsb_bridge.ros.self_test import findings

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # read by each context that joins a domain

from tests.support.locks import domains_of
from tests.support.participants import KnownNode
from tests.support.spun import Joined, Spun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode


@pytest.fixture
def open_node() -> Iterator[Callable[..., RosNode]]:
    """Start our nodes; they are stopped at the end."""
    nodes: list[RosNode] = []

    def start(domain_id: int = 0, name: str = "robot1") -> RosNode:
        # Not earlier: pytest imports some of these for the process that only hands tests out, which would hold domains.
        domain_id = domain_id or domains_of("nodes")
        node = KnownNode(domain_id, name)
        node.start()
        nodes.append(node)
        return node

    yield start
    for node in nodes:
        node.stop()


@pytest.fixture
def printed(capfd: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """Return the output since the last time, without that of Fast DDS about killed processes."""
    return lambda: own_lines("".join(capfd.readouterr()))


@pytest.fixture(params=["raw", "typed"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Select how calls of installed types are carried: as here, or as with another middleware, which has no wheel."""
    name: str = request.param
    if name == "typed":
        found = findings()._replace(no_calls="this is another middleware")
        replaced.FINDINGS.set(monkeypatch, lambda: found)
    return name


@pytest.fixture(params=["events", "sharing", "wait set"])
def told(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Select how DDS tells of arrivals: by descriptors, by one that endpoints share, or by a wait set."""
    name: str = request.param
    if name == "sharing":
        replaced.DESCRIPTORS_FOR_ARRIVALS.set(monkeypatch, lambda _: 0)
    elif name == "wait set":
        found = findings()._replace(no_arrivals="this is another middleware")
        replaced.PARTICIPANT_FINDINGS.set(monkeypatch, lambda: found)
    return name


@pytest.fixture
def rclpy_node() -> Iterator[Node]:
    with contextlib.closing(Joined(domains_of("nodes"), "stock")) as stock:
        yield stock.node


@pytest.fixture
def stock() -> Iterator[Node]:
    with contextlib.closing(Spun(domains_of("nodes"), "stock", start_parameter_services=False)) as stock:
        yield stock.node
