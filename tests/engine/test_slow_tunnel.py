"""A tunnel that carries less than is published, behind buffers that take whatever comes: messages stay fresh."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from tests.support.bridge import balance, carries, linked, outgoing, settled
from tests.support.domain import BEST_EFFORT, text
from tests.support.slow_relay import SlowRelay, read_stamp, stamped
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine

TUNNEL = 5_000
"""Bytes/s."""


class Publishing:
    """Publishes stamped messages at a steady rate, on a thread of its own.

    Attributes:
        count: of the messages so far.
    """

    def __init__(self, out: Publisher, rate: float, size: int) -> None:
        self.count = 0
        self._out = out
        self._rate = rate
        self._size = size
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        began = time.monotonic()
        while not self._over.wait(max(0.0, began + self.count / self._rate - time.monotonic())):
            self._out.publish(text(stamped(self.count, self._size)))
            self.count += 1

    def __enter__(self) -> Publishing:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


def ages(there: Listener) -> list[float]:
    """How old (s) each message was when it came out, the first one first."""
    made = [read_stamp(deserialize_message(payload, String).data)[1] for payload in there.payloads]
    return [(came - stamp) / 1e9 for came, stamp in zip(there.received, made, strict=True)]


@contextmanager
def through_tunnel(
    bridge: Bridge, *topics: Topic, rate: float = TUNNEL, fifo: bool = False
) -> Iterator[tuple[Engine, Engine, SlowRelay]]:
    """A server and a client behind a tunnel, which is slow once they are linked."""
    server = bridge.server()
    with SlowRelay(bridge.port, 1e6, fifo=fifo) as relay:
        client = bridge.client(*topics, server_port=relay.port)
        eventually(lambda: linked(client) and linked(server), what="linked")
        yield server, client, relay
        relay.bytes_per_second = 1e7
        bridge.close()


def publish_for(seconds: float, out: Publisher, rate: float, size: int) -> int:
    """Publish for so long; how many messages it was."""
    with Publishing(out, rate, size) as publishing:
        time.sleep(seconds)
    return publishing.count


@pytest.mark.parametrize("qos", ["auto", {"depth": 10}, "sensor_data"])
def test_live_topic_stays_fresh(qos: Any, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """14 kB/s through 5 kB/s: what arrives is a few seconds old at most, and every message is accounted for."""
    out, there = robot.publisher("/tcp"), pc.listener("/tcp", qos=BEST_EFFORT)
    with through_tunnel(bridge, Topic("/tcp", "transmit", qos=qos)) as (server, client, relay):
        carries([out], server, ["/tcp"])
        relay.bytes_per_second = TUNNEL
        count = publish_for(12.0, out, 14.0, 1000)
        crossed = len(there.payloads)
        found = ages(there)
        print("ages", [f"{age:.1f}" for age in found[:: max(1, len(found) // 40)]], "crossed", crossed, "of", count)
        assert max(found) < 3.5
        assert crossed * 1000 > 0.75 * TUNNEL * 12.0
        ledger = outgoing(client, "/tcp").ledger()
        assert balance(ledger) == ledger.offered
        assert ledger.in_flight < 30
        relay.bytes_per_second = 1e7
        ledger = settled(client, "/tcp", count)
        assert ledger.delivered == len(there.payloads)
        assert ledger.dropped == {"queue full": count - ledger.delivered}
