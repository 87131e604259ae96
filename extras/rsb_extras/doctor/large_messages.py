"""Publishes large best-effort messages from one process of this machine to another, and counts what arrives.

A process of its own, so that a crash ends no other: without arguments it publishes, and starts the one that listens.
"""

from __future__ import annotations

import json
import os
import select
import struct
import subprocess
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import SAFE_DOMAIN, RawMessage, RosError, TopicSpec
from rsb_bridge.model.qos import PROFILES
from rsb_bridge.ros.node import RosNode

if TYPE_CHECKING:
    from collections.abc import Mapping

COMMAND = (sys.executable, "-P", "-m", "rsb_extras.doctor.large_messages")
SIZE = 3_000_000  # bytes: an image of 1000 × 1000 pixels
COUNT = 5
_APART = 0.2  # s: slow enough for an idle machine to take each before the next
_MATCHED_WITHIN = 20.0  # s. A round figure: processes on this machine find each other within 1 s
_ARRIVES_WITHIN = 2.0  # s after the last one. A round figure
_LOOKS_EVERY = 0.05  # s
_TYPE = "std_msgs/msg/UInt8MultiArray"
_DOMAIN = int(SAFE_DOMAIN.high)
_WITHOUT = frozenset({"ROS_DISCOVERY_SERVER", "ROS_SECURITY_ENABLE", "ROS_STATIC_PEERS"})


def surroundings(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which nothing leaves this machine, and DDS's transports are the user's."""
    kept = {name: value for name, value in environ.items() if name not in _WITHOUT}
    return kept | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def _spec(node: RosNode, topic: str) -> TopicSpec:
    type_hash = node.installed_hash(_TYPE)
    if type_hash is None:
        raise RosError(f"{_TYPE} is not installed")
    return TopicSpec(topic, _TYPE, type_hash, PROFILES["sensor_data"])


def listen(topic: str) -> int:
    """Return how many have arrived once all have, or standard input is closed."""
    node, arrived = RosNode(_DOMAIN, "doctor"), list[RawMessage]()
    node.start()
    node.subscribe(_spec(node, topic), arrived.extend, "doctor")
    while len(arrived) < COUNT and not select.select([sys.stdin], [], [], _LOOKS_EVERY)[0]:
        pass
    node.stop()
    return len(arrived)


def publish() -> dict[str, int]:
    """Return how many were sent, and how many have arrived in another process."""
    topic = f"/rsb_doctor_{os.getpid()}"
    message = b"\0\1\0\0" + struct.pack("<III", 0, 0, SIZE) + bytes(SIZE)
    node, sent = RosNode(_DOMAIN, "doctor"), 0
    node.start()
    publisher = node.advertise(_spec(node, topic), "doctor")
    with subprocess.Popen([*COMMAND, topic], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as listener:  # noqa: S603 -- own program
        deadline = time.monotonic() + _MATCHED_WITHIN
        while not publisher.subscriber_count and time.monotonic() < deadline and listener.poll() is None:
            time.sleep(_LOOKS_EVERY)
        for _ in range(COUNT if publisher.subscriber_count else 0):
            time.sleep(_APART)
            publisher.publish(message)
            sent += 1
        with suppress(subprocess.TimeoutExpired):
            listener.wait(_ARRIVES_WITHIN)
        output, _ = listener.communicate()
    node.stop()
    # The last line only: Fast DDS writes its faults to standard output, too.
    return {"sent": sent, "arrived": int((output.splitlines() or [b"0"])[-1])}


def main() -> None:
    """Print the result as JSON."""
    try:
        result = listen(sys.argv[1]) if len(sys.argv) > 1 else publish()
    except RosError as error:
        sys.exit(str(error))
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
