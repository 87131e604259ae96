"""Our node notices that the ROS graph changes, so that nobody has to ask again and again."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from std_msgs.msg import String
from tests.support.inside import break_waiting
from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RosProblem, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode


class Watcher:
    """Counts changes.

    Attributes:
        failures: what the node said of its own end.
    """

    def __init__(self, node: RosNode) -> None:
        self.changes = 0
        self.failures: list[str] = []
        node.watch(self._changed, self.failures.append)

    def _changed(self) -> None:
        self.changes += 1

    def settle(self) -> int:
        """Wait until nothing has changed for a while; how many changes there were so far."""
        seen, since = self.changes, time.monotonic()
        deadline = since + 60
        while time.monotonic() - since < 1.0:
            assert time.monotonic() < deadline
            time.sleep(0.01)
            if self.changes != seen:
                seen, since = self.changes, time.monotonic()
        return seen


@pytest.mark.parametrize("kind", ["publisher", "subscription"])
def test_endpoint_that_comes_or_goes_is_change(kind: str, open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    node = open_node()
    watcher = Watcher(node)
    before = watcher.settle()
    if kind == "publisher":
        end: Any = rclpy_node.create_publisher(String, "/news", 1)
    else:
        end = rclpy_node.create_subscription(String, "/news", lambda _: None, 1)
    eventually(lambda: watcher.changes > before)
    ends = node.publishers if kind == "publisher" else node.subscriptions
    eventually(lambda: [each.node for each in ends("/news")] == ["/stock"])
    before = watcher.settle()
    (rclpy_node.destroy_publisher if kind == "publisher" else rclpy_node.destroy_subscription)(end)
    eventually(lambda: watcher.changes > before)
    eventually(lambda: not ends("/news"))


def test_last_change_comes_after_what_it_is_about(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    """A poll a second after the last change shows all of it, and the matched endpoints."""
    node = open_node()
    watcher = Watcher(node)
    publisher = node.advertise(TopicSpec("/news", "std_msgs/msg/String", "", Qos()), "link")
    looked = watcher.settle()
    rclpy_node.create_subscription(String, "/news", lambda _: None, 1)

    def all_seen() -> bool:
        nonlocal looked
        if watcher.changes == looked:
            return False
        looked = watcher.settle()
        return publisher.subscriber_count == 1 and [each.node for each in node.subscriptions("/news")] == ["/stock"]

    eventually(all_seen)  # a busy machine may take more than a second from one change to the next


def test_messages_are_no_changes(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    node = open_node()
    watcher = Watcher(node)
    received: list[object] = []
    node.subscribe(TopicSpec("/news", "std_msgs/msg/String", "", Qos(depth=100)), received.extend, "link")
    out = rclpy_node.create_publisher(String, "/news", 100)
    eventually(lambda: out.get_subscription_count() == 1)
    eventually(lambda: [each.node for each in node.publishers("/news")] == ["/stock"])
    before = watcher.settle()
    for number in range(50):  # one by one: were they changes, there would be 50
        out.publish(String(data="x"))
        eventually(lambda number=number: len(received) > number)
    assert watcher.changes - before < 25  # a late one of the graph's own may be among them


def test_a_thread_that_ends_by_itself_says_so(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = open_node()
    watcher = Watcher(node)
    break_waiting(node, monkeypatch)
    eventually(lambda: watcher.failures == [RosProblem.THREAD_FAILED(error="the wait set is broken")])
