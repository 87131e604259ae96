"""ROS nodes in a process of their own, which run until SIGTERM. usage: python -m tests.console.nodes DOMAIN SPECS

SIGUSR1 has them publish no more, as nodes that hang: their publishers stay.
SPECS is a JSON list of `Spec`. A DDS participant has one type on a topic, so each message type has one of its own.
"""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

import msgspec


class Spec(msgspec.Struct, omit_defaults=True):
    """One node.

    Attributes:
        topic: that it publishes or hears.
        rate: Hz, or 0 to subscribe.
        best_effort: its QoS; else reliable.
        size: bytes of a message, about.
        alone: it needs a process of its own; the test sees to that.
    """

    node: str
    topic: str
    rate: float = 0.0
    type: str = "String"
    best_effort: bool = False
    size: int = 100
    alone: bool = False


def encoded(specs: list[Spec]) -> str:
    """Return it as an argument of the command."""
    return msgspec.json.encode(specs).decode()


def _main(domain: int, specs: list[Spec]) -> None:
    import std_msgs.msg
    from rclpy.context import Context
    from rclpy.node import Node
    from tests.support.domain import BEST_EFFORT, RELIABLE

    contexts: dict[str, Any] = {}
    due: dict[int, float] = {}
    publish: dict[int, Any] = {}
    nodes = []
    for number, spec in enumerate(specs):
        kind = getattr(std_msgs.msg, spec.type)
        if spec.type not in contexts:
            contexts[spec.type] = Context()
            contexts[spec.type].init([], domain_id=domain)
        node = Node(
            spec.node,
            context=contexts[spec.type],
            enable_rosout=False,
            use_global_arguments=False,
            start_parameter_services=False,
        )
        nodes.append(node)
        qos = BEST_EFFORT if spec.best_effort else RELIABLE
        if spec.rate:
            message = kind(data="x" * spec.size) if spec.type == "String" else kind()
            publisher = node.create_publisher(kind, spec.topic, qos)
            publish[number] = lambda publisher=publisher, message=message: publisher.publish(message)
            due[number] = time.monotonic()
        else:
            node.create_subscription(kind, spec.topic, lambda _: None, qos)
    stopping = hangs = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    def hang(*_: object) -> None:
        nonlocal hangs
        hangs = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGUSR1, hang)
    while not stopping:
        now = time.monotonic()
        for number, moment in due.items():
            if moment <= now and not hangs:
                publish[number]()
                due[number] = max(moment + 1 / specs[number].rate, now)
        due_next = now + 0.1 if hangs else min(due.values(), default=now + 0.1)
        time.sleep(min(0.1, max(0.0, due_next - time.monotonic())))
    for node in nodes:
        node.destroy_node()
    for context in contexts.values():
        context.shutdown()


if __name__ == "__main__":
    _main(int(sys.argv[1]), msgspec.json.decode(sys.argv[2], type=list[Spec]))
