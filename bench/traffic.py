"""One end of a measured stream of std_msgs/String: ``python -m bench.traffic PART DOMAIN TOPIC``, commanded by lines.

``talk``: ``send RATE COUNT SIZE`` publishes COUNT messages of SIZE bytes at RATE Hz and answers with the rate reached.
``listen``: ``reset`` forgets; ``report`` answers with the count and the latencies' percentiles. Both drain and publish
raw, so that they cost as little as they can beside what is measured. ``spin`` listens on rclpy's own executor.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

if TYPE_CHECKING:
    from collections.abc import Callable

QOS = QoSProfile(depth=2000)
_STAMP = 20  # digits
_SAMPLES = 100_000


def message(size: int) -> bytes:
    """A String of `size` bytes, serialized, with the time now (monotonic ns) as its first digits."""
    text = f"{time.monotonic_ns():0{_STAMP}d}".encode().ljust(size, b"x") + b"\0"
    return b"\x00\x01\x00\x00" + len(text).to_bytes(4, "little") + text


def main() -> None:
    part, domain, topic = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"bench_{part}", context=context, enable_rosout=False, start_parameter_services=False)
    if part == "talk":
        _talk(node, topic)
    else:
        _listen(context, node, topic, stock=part == "spin")


def _answer(**fields: object) -> None:
    print(json.dumps(fields), flush=True)


def _talk(node: Node, topic: str) -> None:
    publisher = node.create_publisher(String, topic, QOS)
    for line in sys.stdin:
        command, *numbers = line.split()
        if command == "match":
            _answer(subscribers=publisher.get_subscription_count())
            continue
        rate, count, size = map(int, numbers)
        publish, template = publisher.publish, message(size)
        began, sent = time.perf_counter(), 0
        while sent < count:
            due = min(count, int((time.perf_counter() - began) * rate) + 1)
            # A stamp of its own each where it costs nothing; at high rates only the count matters.
            for _ in range(due - sent):
                publish(message(size) if rate <= 5000 else template)
            sent = max(sent, due)
            time.sleep(0.0005)
        _answer(rate=count / (time.perf_counter() - began))


def _listen(context: Context, node: Node, topic: str, *, stock: bool) -> None:
    latencies: list[int] = []
    count = 0

    def take(payload: bytes) -> None:
        nonlocal count
        count += 1
        if len(latencies) < _SAMPLES:
            latencies.append(time.monotonic_ns() - int(payload[8 : 8 + _STAMP]))

    def commands() -> None:
        nonlocal count
        for line in sys.stdin:
            if line.strip() == "reset":
                count = 0
                latencies.clear()
                _answer(ok=True)
            else:
                ordered = sorted(latencies) or [0]
                _answer(count=count, p50=ordered[len(ordered) // 2], p99=ordered[len(ordered) * 99 // 100])
        context.try_shutdown()

    subscription = node.create_subscription(String, topic, take, QOS, raw=True)
    threading.Thread(target=commands, daemon=True).start()
    if stock:
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()
    else:
        drain(context, subscription.handle, take)


def drain(context: Context, handle: Any, take: Callable[[bytes], object]) -> None:
    """Give what a subscription takes to `take`, serialized, until the context is shut down."""
    with context.handle, handle:
        waits = _rclpy.WaitSet(1, 0, 0, 0, 0, 0, context.handle)
        while context.ok():
            waits.clear_entities()
            waits.add_subscription(handle)
            waits.wait(100_000_000)
            while (taken := handle.take_message(String, True)) is not None:
                take(taken[0])


if __name__ == "__main__":
    main()
