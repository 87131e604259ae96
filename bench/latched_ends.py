"""The ends of `bench.latched`, stock rclpy nodes: ``talk TOPIC DEPTH PUBLISHERS KNOWN`` and ``listen TOPIC DEPTH``."""

from __future__ import annotations

import json
import re
import sys
import threading
import time
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

NEAR, FAR = 94, 95
_ROSOUT = "/rosout"
_DEPTH = 500
_QUIET = 4.0
"""s without a message after which a late joiner has all. From 475 publishers on a busy machine it took 12 s."""
_ROSOUT_QOS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10))
_TEXT = re.compile(r"bench (\d+) (\d+) (\d+)")


def _node(name: str, domain: int, *, rosout: bool = False) -> Node:
    context = Context()
    context.init([], domain_id=domain)
    return Node(name, context=context, enable_rosout=rosout, use_global_arguments=False, start_parameter_services=False)


def _latched(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _say(**answer: Any) -> None:
    print(json.dumps(answer), flush=True)


def _is_known(node: Node, topic: str) -> bool:
    """Whether it knows the bridge and the near listener as subscribers."""
    return len({each.node_name for each in node.get_subscriptions_info_by_topic(topic)}) >= 2


def talk(topic: str, depth: int, publishers: int, known: int) -> None:
    """Publish ``RATE COUNT`` messages, in turn by each publisher; with `known`, once all know who subscribes."""
    _say(ready=True)
    for line in sys.stdin:
        rate, count = line.split()
        first = 0
        outs: list[Any] = []
        nodes: list[Node] = []
        for number in range(publishers):
            logs = topic == _ROSOUT and publishers == 1  # rclpy has one node's logger publish
            node = _node(f"talker{number}", NEAR, rosout=logs)
            nodes.append(node)
            kind, qos = (Log, _ROSOUT_QOS) if topic == _ROSOUT else (String, _latched(depth))
            outs.append(node.get_logger() if logs else node.create_publisher(kind, topic, qos))
        while known and not all(_is_known(node, topic) for node in nodes):
            time.sleep(0.05)
        due = time.monotonic()
        for number in range(int(count)):
            time.sleep(max(0.0, due - time.monotonic()))
            due += 1 / float(rate)
            now = time.monotonic_ns()
            first = first or now
            words = f"bench {number % publishers} {number // publishers} {now}"
            out = outs[number % publishers]
            if topic == _ROSOUT:
                out.info(words) if publishers == 1 else out.publish(Log(msg=words))
            else:
                out.publish(String(data=words))
        _say(first=first)


class _Heard:
    """Takes all messages of a topic, as quickly as it can."""

    def __init__(self, node: Node, topic: str, qos: QoSProfile) -> None:
        self._kind: Any = Log if topic == _ROSOUT else String
        self.subscription = node.create_subscription(self._kind, topic, lambda _: None, qos, raw=True)
        self.messages: list[tuple[int, int, int, int]] = []
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        handle = self.subscription.handle
        raw = []
        while True:
            while (taken := handle.take_message(self._kind, True)) is not None:
                raw.append((taken[0], time.monotonic_ns()))
            # Messages are read once nothing is left to take, since reading takes longer than taking.
            for payload, at in raw:
                message = deserialize_message(payload, self._kind)
                if match := _TEXT.search(message.msg if self._kind is Log else message.data):
                    publisher, number, sent = map(int, match.groups())
                    self.messages.append((publisher, number, sent, at))
            raw.clear()
            time.sleep(0.0005)


def listen(topic: str, depth: int) -> None:
    """Listen behind the bridge; an idle node publishes on the topic before it, so that the bridge has it open."""
    idle, far = _node("idle", NEAR, rosout=topic == _ROSOUT), _node("listener", FAR)
    if topic != _ROSOUT:
        idle.create_publisher(String, topic, _latched(depth))
    heard = _Heard(far, topic, _latched(_DEPTH))
    without = _Heard(_node("without", NEAR), topic, _latched(_DEPTH))
    late_nodes = [_node("late", domain) for domain in (NEAR, FAR)]
    _say(ready=True)
    for line in sys.stdin:
        if line.strip() == "matched":
            _say(matched=heard.subscription.handle.get_publisher_count())
            continue
        messages = list(heard.messages)
        # No run has so many messages (5 kHz for 3 s), so that the late joiner's own depth hides none.
        late = [_Heard(node, topic, _latched(30000)) for node in late_nodes]
        heard_late = -1
        while (now_late := sum(len(side.messages) for side in late)) != heard_late:
            heard_late = now_late
            time.sleep(_QUIET)
        near, there = ({each[:2] for each in side.messages} for side in late)
        delays = sorted((at - sent) / 1e6 for _, _, sent, at in messages) or [float("nan")]
        newest: dict[int, int] = {}
        disorder = 0
        for publisher, number, _, _ in messages:
            disorder += number <= newest.get(publisher, -1)
            newest[publisher] = number
        _say(
            heard=len(messages),
            disorder=disorder,
            first=messages[0][3] if messages else 0,
            first_near=without.messages[0][3] if without.messages else 0,
            p50=delays[len(delays) // 2],
            max=delays[-1],
            near=len(near),
            missing=len(near - there),
            more=len(there - near),
        )


if __name__ == "__main__":
    if sys.argv[1] == "talk":
        talk(sys.argv[2], *map(int, sys.argv[3:]))
    else:
        listen(sys.argv[2], int(sys.argv[3]))
