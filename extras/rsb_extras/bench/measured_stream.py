"""The ends of a measured stream of std_msgs/String.

They are started by ``python -m rsb_extras.bench.measured_stream PART DOMAIN TOPIC[:DEPTH]...``.

It is commanded by lines, and answers with lines of JSON; it ends with its standard input.

- ``talk``: ``send RATE COUNT SIZE [AT]`` publishes COUNT messages of SIZE bytes at RATE Hz on the topic of that number,
  and answers with the rate reached.
- ``listen``: ``reset`` forgets; ``count`` answers with the count, ``report`` with the count and the latencies (ns).
- ``many DOMAIN PREFIX COUNT [SUFFIX]`` publishes on COUNT topics, each at 1 Hz.

Talker and listener drain and publish raw, so that they cost little compared with the measured programs. Each message
has a stamp.
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
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from rsb_bridge.cdr.known_types import made_at, stamped_string
from rsb_bridge.ros.native.rclpy_extension import wait_set
from rsb_extras.bench.bench_ends import percentiles

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

DEPTH = 2000  # messages, as in all figures of bench/README.md
_SAMPLES = 100_000  # latencies of a run that are kept. A round figure: memory stays bounded
_OF_MANY = 200  # bytes


def main() -> None:
    """Run one part."""
    part, domain, *topics = sys.argv[1:]
    context = Context()
    rclpy.init(context=context, domain_id=int(domain), signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"bench_{part}", context=context, enable_rosout=False, start_parameter_services=False)
    if part == "talk":
        talk(node, topics)
    elif part == "many":
        prefix, count, *suffix = topics
        _publish_many(node, [f"{prefix}{number:03d}{''.join(suffix)}" for number in range(int(count))])
    else:
        _listen(context, node, topics)


def _answer(**fields: object) -> None:
    sys.stdout.write(f"{json.dumps(fields)}\n")
    sys.stdout.flush()


def _parsed(topic: str) -> tuple[str, QoSProfile]:
    name, _, depth = topic.partition(":")
    return name, QoSProfile(depth=int(depth or DEPTH))


def talk(node: Node, topics: Sequence[str]) -> None:
    publishers = [node.create_publisher(String, *_parsed(topic)) for topic in topics]
    for line in sys.stdin:
        command, *numbers = line.split()
        if command == "match":
            _answer(subscribers=min(each.get_subscription_count() for each in publishers))
            continue
        rate = float(numbers[0])
        count, size = map(int, numbers[1:3])
        # Without rclpy's wrapper: what that would cost pays for the stamps.
        publish = publishers[int(numbers[3]) if len(numbers) > 3 else 0].handle.publish_raw
        began, sent = time.perf_counter(), 0
        while sent < count:
            due = min(count, int((time.perf_counter() - began) * rate) + 1)
            for _ in range(due - sent):
                publish(stamped_string(size))
            sent = max(sent, due)
            # Bursts of half a millisecond: a talker that looked at the clock all the time would take a core.
            time.sleep(0.0005)
        # A single message takes no time; a rate has intervals.
        _answer(rate=min(rate, count / max(time.perf_counter() - began, 1e-9)))


def _publish_many(node: Node, topics: Sequence[str]) -> None:
    publishers = [node.create_publisher(String, topic, 10) for topic in topics]
    ends = threading.Event()

    def until_told() -> None:
        sys.stdin.read()
        ends.set()

    threading.Thread(target=until_told, daemon=True).start()
    while not ends.is_set():
        for publisher in publishers:
            publisher.publish(stamped_string(_OF_MANY))
            # Spread over the second: hundreds of messages at once would be another load.
            if ends.wait(1 / len(publishers)):
                break


class MeasuredArrivals:
    """Counts messages that were made since the last reset: what an overload has left comes late, in a later run.

    Attributes:
        latencies: ns, of the first of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.latencies: list[int] = []
        self._since = 0

    def reset(self) -> None:
        self._since = time.monotonic_ns()
        self.count = 0
        self.latencies.clear()

    def add(self, payload: bytes) -> None:
        made = made_at(payload)
        if made < self._since:
            return
        self.count += 1
        if len(self.latencies) < _SAMPLES:
            self.latencies.append(time.monotonic_ns() - made)


def _listen(context: Context, node: Node, topics: Sequence[str]) -> None:
    arrivals = MeasuredArrivals()
    take = arrivals.add

    def commands() -> None:
        for line in sys.stdin:
            match line.strip():
                case "reset":
                    arrivals.reset()
                    _answer(ok=True)
                case "count":
                    _answer(count=arrivals.count)
                case _:
                    p50, p99, p999 = percentiles(arrivals.latencies)
                    _answer(count=arrivals.count, p50=p50, p99=p99, p999=p999)
        context.try_shutdown()

    subscriptions = [
        node.create_subscription(String, topic, take, qos, raw=True) for topic, qos in map(_parsed, topics)
    ]
    threading.Thread(target=commands, daemon=True).start()
    drain(context, [each.handle for each in subscriptions], take)


def drain(context: Context, handles: Sequence[Any], take: Callable[[bytes], object]) -> None:
    """Pass the subscriptions' messages, serialized, to `take` until the context is shut down."""
    with context.handle, contextlib.ExitStack() as held:
        for handle in handles:
            held.enter_context(handle)
        waits = wait_set(context, subscriptions=len(handles))
        while context.ok():
            waits.clear_entities()
            for handle in handles:
                waits.add_subscription(handle)
            waits.wait(100_000_000)
            for handle in handles:
                while (taken := handle.take_message(String, True)) is not None:
                    take(taken[0])


if __name__ == "__main__":
    main()
