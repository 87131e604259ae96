"""A fault of Fast DDS 2.14.5: a new reader does not learn who is alive, if it is told while it is made.

``python -m bench.missed_assertion [--busy N] [DOMAIN]``. A stock publisher of rclpy with a lease publishes at 100 Hz.
Stock subscriptions to its latched topic are made one after the other, and each has a second, a hundred messages,
to call the publisher alive. The program prints how many do not, and exits with 1 if there is one. Such a subscription
counts one publisher too few for as long as it lives, -1 after the publisher's lease has ended.

The cause is in `BuiltinProtocols::addLocalReader` (the same in 3.6.2). It has the discovery match the reader with its
writers, and adds it to `WLP::readers_` after that. Meanwhile a message, or an assertion, makes the writer alive in
`LivelinessManager`, and `WLP::sub_liveliness_changed` does not find the reader whose count it should raise. That is
done only once, when the writer comes alive.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from tests.support.steady import Steady

_CHANGED = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_LIVELINESS_CHANGED
_TOPIC = "asserted"
_RATE, _COUNT = 100.0, 100
_WITHIN = 1.0
_BUSY = "while True: pass"


def _qos(number: int) -> QoSProfile:
    # Fast DDS tells only the first of a participant's readers with the same lease who is alive.
    lease = Duration(nanoseconds=5 * 10**9 + 1000 * number)
    return QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL, liveliness_lease_duration=lease)


def _node(name: str, domain: int) -> Node:
    context = Context()
    context.init([], domain_id=domain)
    return Node(name, context=context, enable_rosout=False, start_parameter_services=False)


def _misses(node: Node, number: int) -> bool:
    subscription = node.create_subscription(String, _TOPIC, lambda _: None, _qos(number))
    event = rclpy_implementation.EventHandle(subscription.handle, _CHANGED)
    until = time.monotonic() + _WITHIN
    while not (alive := event.take_event().alive_count) and time.monotonic() < until:
        time.sleep(0.002)
    if not alive and (matched := subscription.handle.get_publisher_count()):
        sys.stdout.write(f"subscription {number}: {matched} publisher matched, none alive\n")
    event.destroy_when_not_in_use()
    node.destroy_subscription(subscription)
    return not alive


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--busy", type=int, default=0, help="processes that never wait, beside these")
    parser.add_argument("domain", type=int, nargs="?", default=0)
    options = parser.parse_args()
    hogs = [subprocess.Popen((sys.executable, "-c", _BUSY)) for _ in range(options.busy)]
    try:
        publisher = _node("talker", options.domain).create_publisher(String, _TOPIC, _qos(0))
        listener = _node("listener", options.domain)
        with Steady(publisher, _RATE, lambda _: b"\0\1\0\0\1\0\0\0\0"):
            missed = sum(_misses(listener, number) for number in range(_COUNT))
    finally:
        for hog in hogs:
            hog.kill()
    sys.stdout.write(f"{missed} of {_COUNT} subscriptions call the publisher not alive\n")
    sys.stdout.flush()
    os._exit(bool(missed))


if __name__ == "__main__":
    main()
