"""Nodes that a bridge mirrors, with its endpoints on them, as stock nodes and other bridges see them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from std_srvs.srv import Trigger
from tests.support.waiting import eventually

from rsb_bridge.cdr.known_types import STRING, STRING_HASH
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import EndPlace, RosError, RosProblem, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode

LIDAR = "/front/lidar"
TRIGGER = "std_srvs/srv/Trigger"


def spec(topic: str) -> TopicSpec:
    return TopicSpec(topic, STRING, STRING_HASH, Qos())


def names_seen_by(node: Node) -> list[str]:
    return [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]


def test_stock_node_finds_endpoints_on_the_mirrored_node(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    node = open_node()
    node.mirrors.add(LIDAR)
    for end in (EndPlace("publisher", "/scan", "robot1"), EndPlace("subscription", "/speed", "robot1")):
        node.mirrors.place(end, LIDAR)
    node.mirrors.place(EndPlace("service", "/front/reset", "robot1"), LIDAR)
    publisher = node.advertise(spec("/scan"), "robot1")
    subscription = node.subscribe(spec("/speed"), print, "robot1")
    service_hash = node.installed_service_hash(TRIGGER)
    assert service_hash is not None
    server = node.serve("/front/reset", TRIGGER, service_hash, print, origin="robot1")

    def ends() -> list[list[tuple[str, list[str]]]]:
        if LIDAR not in names_seen_by(rclpy_node):
            return []
        return [
            rclpy_node.get_publisher_names_and_types_by_node("lidar", "/front"),
            rclpy_node.get_subscriber_names_and_types_by_node("lidar", "/front"),
            rclpy_node.get_service_names_and_types_by_node("lidar", "/front"),
        ]

    eventually(lambda: ends() == [[("/scan", [STRING])], [("/speed", [STRING])], [("/front/reset", [TRIGGER])]])
    assert names_seen_by(rclpy_node).count(LIDAR) == 1
    client = rclpy_node.create_client(Trigger, "/front/reset")
    assert client.wait_for_service(20.0)
    for closed in (publisher, subscription, server):
        closed.close()
    node.mirrors.remove(LIDAR)
    node.mirrors.remove(LIDAR)
    eventually(lambda: LIDAR not in names_seen_by(rclpy_node), what="its end")


def test_service_of_another_link_leaves_a_place_alone(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    """Two robots have a service of one name: each stands on the node of its own robot, and goes alone."""
    node = open_node()
    service_hash = node.installed_service_hash(TRIGGER)
    assert service_hash is not None
    for robot in ("robot1", "robot2"):
        node.mirrors.add(f"/{robot}")
        node.mirrors.place(EndPlace("service", "/reset", robot), f"/{robot}")
    node.mirrors.place(EndPlace("service", "/reset", "robot2"), "")
    server = node.serve("/reset", TRIGGER, service_hash, print, origin="robot1")

    def serves(name: str) -> list[tuple[str, list[str]]] | None:
        found = f"/{name}" in names_seen_by(rclpy_node)
        return rclpy_node.get_service_names_and_types_by_node(name, "/") if found else None

    eventually(lambda: (serves("robot1"), serves("robot2")) == ([("/reset", [TRIGGER])], []), what="one place")
    server.close()


def test_bridges_know_mirrored_nodes_and_their_endpoints(open_node: Callable[..., RosNode]) -> None:
    one, other = open_node(), open_node(name="robot2")
    one.advertise(spec(ANNOUNCEMENT_TOPIC), ANNOUNCEMENT_TOPIC)  # as an engine's first
    one.mirrors.add(LIDAR)
    one.mirrors.place(EndPlace("publisher", "/scan", "robot1"), LIDAR)
    one.advertise(spec("/scan"), "robot1")
    eventually(lambda: other.mirrors.by_others() == {LIDAR: f"/{one.node_name}"}, what="it is known as mirrored")
    eventually(lambda: [each.node for each in other.publishers("/scan")] == [f"/{one.node_name}"])
    assert f"/{one.node_name}" in other.node_names()
    assert LIDAR not in [*other.node_names(), *one.node_names()]
    assert one.mirrors.by_others() == {}
    assert one.publishers("/scan") == []
    assert "/scan" not in one.topics()


def test_endpoint_without_its_node_is_the_bridges_own(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    node = open_node()
    end = EndPlace("publisher", "/scan", "robot1")
    node.mirrors.place(end, LIDAR)
    assert node.mirrors.node_of(end) == LIDAR
    node.advertise(spec("/scan"), "robot1")
    eventually(
        lambda: [each.node_name for each in rclpy_node.get_publishers_info_by_topic("/scan")] == [node.node_name]
    )
    node.mirrors.place(end, "")
    assert not node.mirrors.node_of(end)


def test_names_that_ros_refuses_are_not_mirrored(open_node: Callable[..., RosNode]) -> None:
    node = open_node()
    for name in ("/a-b", "/1st", "/", "/a//b"):
        with pytest.raises(RosError, match="cannot be mirrored"):
            node.mirrors.add(name)
    node.stop()
    with pytest.raises(RosError, match=RosProblem.NOT_RUNNING()):
        node.mirrors.add(LIDAR)
