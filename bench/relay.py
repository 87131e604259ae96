"""The least that can stand between a topic's publisher and its subscriber in another domain, for comparison.

One process that takes raw and publishes raw: no link, no socket, no cipher, no limits. It costs what the C++
domain_bridge costs. ``python -m bench.relay NEAR FAR TOPIC``
"""

from __future__ import annotations

import sys
import threading

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from rsb_extras.bench.measured_stream import DEPTH, drain


def main() -> None:
    near_domain, far_domain, topic = sys.argv[1:]
    near, far = node_in(int(near_domain)), node_in(int(far_domain))
    qos = QoSProfile(depth=DEPTH)
    publisher = far.create_publisher(String, topic, qos)
    subscription = near.create_subscription(String, topic, lambda _: None, qos, raw=True)

    def until_told() -> None:
        sys.stdin.read()
        near.context.try_shutdown()

    threading.Thread(target=until_told, daemon=True).start()
    drain(near.context, [subscription.handle], publisher.handle.publish_raw)


def node_in(domain: int, name: str = "bench_relay", *, start_parameter_services: bool = False) -> Node:
    """Return a node in a context of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    return Node(name, context=context, enable_rosout=False, start_parameter_services=start_parameter_services)


if __name__ == "__main__":
    main()
