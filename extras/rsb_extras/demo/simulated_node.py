"""A node of the demo, which counts what it publishes and what it receives."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from rsb_bridge.ros.self_test import ARGUMENTS

if TYPE_CHECKING:
    from collections.abc import Callable

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
CALL_EVERY = 2.0  # s
_EARLY = 0.001
"""s: work that is due at about the same time is done at once, as each waking costs."""


class SimulatedNode:
    """A node that publishes and subscribes, and counts both.

    Attributes:
        muted: topics that are not published any more, though their publishers stay.
    """

    def __init__(self, domain_id: int, name: str, *, parameters: bool = False) -> None:
        self.published: dict[str, int] = {}
        self.muted: set[str] = set()
        self.received: dict[str, int] = {}
        self._context = Context()
        self._context.init(ARGUMENTS, domain_id=domain_id)
        self._node = Node(name, context=self._context, enable_rosout=False, start_parameter_services=parameters)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._began = time.monotonic()
        self._work: list[tuple[float, float, Callable[[], None]]] = []

    def spin_once(self, timeout: float) -> None:
        """Do what is due, and handle one message, or wait for up to `timeout` s."""
        now = time.monotonic()
        for at, (due, period, work) in enumerate(self._work):
            if due <= now + _EARLY:
                # What a busy machine has missed is not made up for.
                self._work[at] = (due + period * max(1, math.ceil((now - due) / period)), period, work)
                work()
        following = min((due for due, _, _ in self._work), default=now + timeout) - time.monotonic()
        self._executor.spin_once(max(0.0, min(timeout, following)))

    def every(self, period: float, work: Callable[[], None]) -> None:
        """Do something every `period` s. rclpy looks at each timer before each message, which a dozen make dear."""
        self._work.append((self._began + period, period, work))

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.shutdown()

    def _publishes(self, kind: type, topic: str, qos: Any, rate: float, make: Callable[[float], Any]) -> None:
        publisher = self._node.create_publisher(kind, topic, qos)
        self.published[topic] = 0

        def publish() -> None:
            if topic in self.muted:
                return
            publisher.publish(make(time.monotonic() - self._began))
            self.published[topic] += 1

        if rate:
            self.every(1 / rate, publish)
        else:
            publish()

    def _shows(self, kind: type, topic: str, qos: Any, rate: float, make: Callable[[], Any]) -> None:
        """Publish while anybody subscribes; what nobody looks at costs nothing. `make` may return None for nothing."""
        publisher = self._node.create_publisher(kind, topic, qos)

        def publish() -> None:
            if publisher.get_subscription_count() and topic not in self.muted and (message := make()) is not None:
                publisher.publish(message)
                self.published[topic] = self.published.get(topic, 0) + 1

        self.every(1 / rate, publish)

    def _counts(self, kind: type, topic: str, qos: Any, take: Callable[[Any], None] | None = None) -> None:
        self.received[topic] = 0

        def count(message: Any) -> None:
            self.received[topic] += 1
            if take is not None:
                take(message)

        self._node.create_subscription(kind, topic, count, qos)

    def _calls(self, kind: Any, service: str, make: Callable[[float], Any]) -> None:
        client = self._node.create_client(kind, service)
        pending: list[Any] = []

        def call() -> None:
            while pending:  # an answer that has not come by now does not matter any more
                client.remove_pending_request(pending.pop())
            if client.service_is_ready():
                pending.append(client.call_async(make(time.monotonic() - self._began)))

        self.every(CALL_EVERY, call)

    def _stamp(self) -> Any:
        return self._node.get_clock().now().to_msg()
