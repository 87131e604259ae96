"""The ends of a measured stream of std_msgs/String.

They are started by ``python -m rsb_extras.bench.measured_stream PART DOMAIN TOPIC[:DEPTH]...``. Each part reads
commands line by line, answers with lines of JSON, and ends with its standard input.

- ``talk``: ``match`` answers with the fewest subscribers of a topic. ``send RATE COUNT SIZE [AT [FILE]]`` publishes
  COUNT messages of SIZE bytes at RATE Hz on the topic of that number, and answers with the rate reached. FILE is a new
  one for the messages (`kept_messages`).
- ``listen``: ``reset [SIZE]`` forgets, and with a SIZE keeps the messages from then on; ``count`` answers with the
  count, ``report [FILE]`` with the count and the latencies (ns), and whether FILE has the messages that it counts.
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
from array import array
from pathlib import Path
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
from rsb_extras.bench.kept_messages import KeptMessages, write_made

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
        command, *numbers = line.split(maxsplit=5)  # the path may have spaces
        if command == "match":
            _answer(subscribers=min(each.get_subscription_count() for each in publishers))
            continue
        rate = float(numbers[0])
        count, size = map(int, numbers[1:3])
        # Without rclpy's wrapper: what that would cost pays for the stamps.
        publish = publishers[int(numbers[3]) if len(numbers) > 3 else 0].handle.publish_raw
        # In every run, so that one that is recorded costs no more.
        stamps = array("Q")
        began, sent = time.perf_counter(), 0
        while sent < count:
            due = min(count, int((time.perf_counter() - began) * rate) + 1)
            for _ in range(due - sent):
                made = time.monotonic_ns()
                publish(stamped_string(size, made))
                stamps.append(made)
            sent = max(sent, due)
            # Bursts of half a millisecond: a talker that looked at the clock all the time would take a core.
            time.sleep(0.0005)
        # A single message takes no time; a rate has intervals.
        reached = min(rate, count / max(time.perf_counter() - began, 1e-9))
        if len(numbers) > 4:
            write_made(Path(numbers[4].rstrip("\n")), size, stamps)
        _answer(rate=reached)


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
        kept: what a recording is made from, all that is counted and perhaps a message more; None without a recording.
    """

    def __init__(self) -> None:
        self.count = 0
        self.latencies: list[int] = []
        self.kept: KeptMessages | None = None
        self._since = 0

    def reset(self, kept: KeptMessages | None = None) -> None:
        self._since = time.monotonic_ns()
        self.count = 0
        self.latencies.clear()
        self.kept = kept

    def add(self, payload: bytes) -> None:
        made = made_at(payload)
        if made < self._since:
            return
        now = time.monotonic_ns()
        if self.kept is not None:
            self.kept.add(made, now, payload)
        self.count += 1
        if len(self.latencies) < _SAMPLES:
            self.latencies.append(now - made)


def _listen(context: Context, node: Node, topics: Sequence[str]) -> None:
    arrivals = MeasuredArrivals()
    take = arrivals.add

    def commands() -> None:
        try:
            for line in sys.stdin:
                match line.strip().partition(" "):
                    case "reset", _, size:
                        arrivals.reset(KeptMessages(int(size)) if size else None)
                        _answer(ok=True)
                    case "count", _, _:
                        _answer(count=arrivals.count)
                    case _, _, path:
                        # Read once: messages that come later are in neither the answer nor the file.
                        count, kept = arrivals.count, arrivals.kept
                        p50, p99, p999 = percentiles(arrivals.latencies)
                        written = kept is not None and kept.write(Path(path), count)
                        _answer(count=count, p50=p50, p99=p99, p999=p999, kept=written)
        finally:  # also if the disk is full: who waits for an answer learns that this process has ended
            context.try_shutdown()

    subscriptions = [
        node.create_subscription(String, topic, take, qos, raw=True) for topic, qos in map(_parsed, topics)
    ]
    threading.Thread(target=commands, daemon=True).start()
    drain(context, [each.handle for each in subscriptions], take)


def drain(context: Context, handles: Sequence[Any], take: Callable[[bytes], object]) -> None:
    """Pass the subscriptions' messages, serialized, to `take` until the context is shut down."""
    by_address = {handle.pointer: handle for handle in handles}
    with context.handle, contextlib.ExitStack() as held:
        for handle in handles:
            held.enter_context(handle)
        waits = wait_set(context, subscriptions=len(handles))
        while context.ok():
            waits.clear_entities()
            for handle in handles:
                waits.add_subscription(handle)
            waits.wait(100_000_000)
            for address in waits.get_ready_entities("subscription"):
                handle = by_address[address]
                while (taken := handle.take_message(String, True)) is not None:
                    if not taken[0]:
                        # In place of a message that another DDS withdrew, Fast DDS gives one without a byte, and again
                        # until the next one comes (docs/support.md).
                        time.sleep(0.001)
                        break
                    take(taken[0])


if __name__ == "__main__":
    main()
