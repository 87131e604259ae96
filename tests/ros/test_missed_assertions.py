"""DDS misses publishers that assert their liveliness while a subscription is made."""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from std_msgs.msg import String
from tests.support.domain import text
from tests.support.steady import Steady

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode

SUBSCRIPTIONS = 60
LEASE = 5.0


def _note(heard: threading.Event, _: object) -> None:
    heard.set()


@pytest.mark.parametrize("kind", ["automatic", "manual_by_topic"])
def test_undoubted_dead_publishers_are_not_asked_about(
    kind: Any, open_node: Callable[..., RosNode], rclpy_node: Node
) -> None:
    """Fast DDS misses the assertions of one in 15, on a busy machine; they must not seem to be judged."""
    qos = QoSProfile(
        depth=10,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy[kind.upper()],
        liveliness_lease_duration=Duration(seconds=LEASE),
    )
    publisher = rclpy_node.create_publisher(String, "/asserted", qos)
    asked = Qos(depth=1, durability="transient_local", liveliness=kind, liveliness_lease_duration=LEASE)
    spec = TopicSpec("/asserted", "std_msgs/msg/String", "", asked)
    ours = open_node()
    with Steady(publisher, 1000.0, lambda _: text("x")):
        for _ in range(SUBSCRIPTIONS):
            heard = threading.Event()
            subscription = ours.subscribe(spec, partial(_note, heard), "")
            assert heard.wait(60.0)
            alive, unjudged = subscription.liveliness
            assert alive + unjudged == 1
            subscription.close()
