"""A ROS domain as a robot's own programs see it: a stock rclpy node, its publishers and subscriptions."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakSet

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # read by each context that joins a domain

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String
from tests.support.spun import Joined

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher

RELIABLE = QoSProfile(depth=5000)
BEST_EFFORT = QoSProfile(depth=5000, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Domain(Joined):
    joined: ClassVar[WeakSet[Domain]] = WeakSet()
    """All of this process."""

    def __init__(self, domain_id: int) -> None:
        self.joined.add(self)
        self.id = domain_id
        self.listeners: list[Listener] = []
        super().__init__(domain_id, "stock", start_parameter_services=False)
        (self._describes_types,) = self.node.services

    def publisher(self, topic: str, kind: Any = String, qos: QoSProfile = RELIABLE) -> Publisher:
        """A publisher; its `publish` takes messages and bytes."""
        return self.node.create_publisher(kind, topic, qos)

    def listener(self, topic: str, kind: Any = String, qos: QoSProfile = RELIABLE) -> Listener:
        """A subscription that keeps what it hears."""
        self.listeners.append(Listener(self.node, topic, kind, qos))
        return self.listeners[-1]

    def serve(self, service: str, kind: Any) -> None:
        """A server that nobody spins: others see it, and it answers nothing."""
        self.node.create_service(kind, service, lambda _, response: response)

    def clear(self) -> None:
        self.listeners.clear()
        for publisher in tuple(self.node.publishers):
            self.node.destroy_publisher(publisher)
        for subscription in tuple(self.node.subscriptions):
            self.node.destroy_subscription(subscription)
        for service in tuple(self.node.services):
            if service is not self._describes_types:
                self.node.destroy_service(service)
        for client in tuple(self.node.clients):
            self.node.destroy_client(client)

    def close(self) -> None:
        self.clear()
        super().close()


class Listener:
    """A subscription, taken from whenever somebody looks: no executor, so no thread takes the engine's time."""

    def __init__(self, node: Node, topic: str, kind: Any, qos: QoSProfile) -> None:
        self.topic = topic
        self._kind = kind
        self._payloads: list[bytes] = []
        self._received: list[int] = []
        self._published: list[int] = []
        self.subscription = node.create_subscription(kind, topic, lambda _: None, qos, raw=True)

    @property
    def matched(self) -> int:
        """How many publishers it hears."""
        count: int = self.subscription.handle.get_publisher_count()
        return count

    @property
    def payloads(self) -> list[bytes]:
        """Every serialized message heard so far, oldest first."""
        self._take()
        return self._payloads

    def texts(self, last: int) -> list[str]:
        """The newest std_msgs/String's words. Between processes DDS pads payloads to four bytes."""
        return [deserialize_message(payload, self._kind).data for payload in self.payloads[-last:]]

    @property
    def received(self) -> list[int]:
        """When DDS received each of them: ns since the epoch."""
        self._take()
        return self._received

    @property
    def published(self) -> list[int]:
        """When their publisher published each of them: ns since the epoch."""
        self._take()
        return self._published

    def forget(self) -> None:
        """Forget what has been taken."""
        self._payloads.clear()
        self._received.clear()
        self._published.clear()

    def _take(self) -> None:
        handle = self.subscription.handle
        while (taken := handle.take_message(self._kind, True)) is not None:
            payload, info = taken
            self._payloads.append(payload)
            self._received.append(info["received_timestamp"])
            self._published.append(info["source_timestamp"])


def text(words: str) -> bytes:
    """A serialized std_msgs/String."""
    payload: bytes = serialize_message(String(data=words))
    return payload
