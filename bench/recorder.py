"""Records String topics of a domain, as `ros2 bag record` would: ``python -m bench.recorder DOMAIN FILE TOPIC...``.

It hears them by subscriptions of its own, with what their first publisher offers, and knows of no bridge. It writes an
MCAP file, and ends it once standard input has ended.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from bench.relay import node_in
from mcap.writer import Writer
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from rsb_extras.bench.measured_stream import drain

if TYPE_CHECKING:
    from collections.abc import Sequence

_DEPTH = 1000  # a round figure: 5 s of the fastest topic of `bench.outages`
_LOOKS_EVERY = 0.05  # s


def main(domain: int, path: str, topics: Sequence[str]) -> None:
    node, ended = node_in(domain, "recorder"), threading.Event()

    def until_told() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=until_told, daemon=True).start()
    with Path(path).open("wb") as file:
        recording = _Recording(file)
        missing, takers = set(topics), list[threading.Thread]()

        def record(topic: str, offered: QoSProfile) -> None:
            qos = QoSProfile(depth=_DEPTH, reliability=offered.reliability, durability=offered.durability)
            subscription = node.create_subscription(String, topic, lambda _: None, qos, raw=True)
            drain(node.context, [subscription.handle], recording.taker(topic, offered))

        while not ended.wait(_LOOKS_EVERY):
            for topic in sorted(missing):
                if publishers := node.get_publishers_info_by_topic(topic):
                    missing.remove(topic)
                    takers.append(threading.Thread(target=record, args=(topic, publishers[0].qos_profile)))
                    takers[-1].start()
        node.context.try_shutdown()
        for each in takers:
            each.join()
        recording.finish()  # type: ignore[no-untyped-call]


class _Recording:
    """An MCAP file that threads write to."""

    def __init__(self, file: Any) -> None:
        self._lock = threading.Lock()
        self._writer: Any = Writer(file)
        self._writer.start(profile="ros2", library="bench.recorder")
        self._schema = self._writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        self.finish = self._writer.finish

    def taker(self, topic: str, offered: QoSProfile) -> Any:
        """Add a topic, and return what writes its messages."""
        policies = {key: getattr(offered, key).name.lower() for key in ("history", "reliability", "durability")}
        metadata = {"offered_qos_profiles": yaml.safe_dump([{**policies, "depth": offered.depth}])}
        with self._lock:
            channel = self._writer.register_channel(topic, "cdr", self._schema, metadata)

        def take(content: bytes) -> None:
            now = time.time_ns()
            with self._lock:
                self._writer.add_message(channel, now, content, now)

        return take


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3:])
