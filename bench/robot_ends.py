"""The ends of `bench.robot`: a robot's nodes, and the nodes that hear them.

- ``talk DOMAIN TOPIC:HZ:BYTES:RELIABILITY...``: ``match`` answers with the fewest subscribers of a topic; ``go
  SECONDS`` publishes, and answers with when it published each one.
- ``listen DOMAIN TOPIC:HZ:BYTES:RELIABILITY...``: ``report`` answers with when each message was made and heard.

Times are ns of the monotonic clock, which all network namespaces of a machine share.
"""

from __future__ import annotations

import heapq
import json
import sys
import threading
import time
from functools import partial

from bench.relay import node_in
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from rsb_bridge.ros.known_messages import made_at, stamped_string
from rsb_bridge.ros.measured_stream import drain

_DEPTH = {"reliable": 10, "best_effort": 5}


def _qos(reliability: str, depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy[reliability.upper()])


def _say(**answer: object) -> None:
    print(json.dumps(answer), flush=True)


def talk(domain: int, topics: list[list[str]]) -> None:
    node = node_in(domain)
    publishers = {
        name: (node.create_publisher(String, name, _qos(reliability, _DEPTH[reliability])), float(rate), int(size))
        for name, rate, size, reliability in topics
    }
    for line in sys.stdin:
        command, *words = line.split()
        if command == "match":
            _say(subscribers=min(publisher.get_subscription_count() for publisher, _, _ in publishers.values()))
            continue
        began = time.monotonic_ns()
        ends = began + int(float(words[0]) * 1e9)
        made: dict[str, list[int]] = {name: [] for name in publishers}
        # Topics of one rate do not publish together, as nodes of a robot do not.
        due = [(began + index * 1_700_000, name) for index, name in enumerate(publishers)]
        while due[0][0] < ends:
            at, name = heapq.heappop(due)
            time.sleep(max(0, at - time.monotonic_ns()) / 1e9)
            publisher, rate, size = publishers[name]
            message = stamped_string(size)
            made[name].append(made_at(message))
            publisher.handle.publish_raw(message)
            heapq.heappush(due, (at + int(1e9 / rate), name))
        _say(**made)


def listen(domain: int, topics: list[list[str]]) -> None:
    node = node_in(domain)
    heard: dict[str, list[tuple[int, int]]] = {name: [] for name, *_ in topics}

    def take(arrivals: list[tuple[int, int]], payload: bytes) -> None:
        arrivals.append((made_at(payload), time.monotonic_ns()))

    for name, _, _, reliability in topics:
        subscription = node.create_subscription(String, name, lambda _: None, _qos(reliability, 100), raw=True)
        taking = partial(drain, node.context, [subscription.handle], partial(take, heard[name]))
        threading.Thread(target=taking, daemon=True).start()
    _say(ready=True)
    for _ in sys.stdin:
        _say(**heard)


if __name__ == "__main__":
    part = talk if sys.argv[1] == "talk" else listen
    part(int(sys.argv[2]), [topic.split(":") for topic in sys.argv[3:]])
