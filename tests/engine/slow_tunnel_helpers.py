"""Helpers of `test_slow_tunnel` and others."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from tests.support.domain import text
from tests.support.relay import Relay, read_stamp, stamped
from tests.support.steady import Steady

if TYPE_CHECKING:
    from rclpy.publisher import Publisher
    from tests.support.domain import Listener


TUNNEL = 5_000
"""Bytes/s."""


def publishing(out: Publisher, rate: float, size: int) -> Steady:
    """Publish stamped messages of so many bytes."""
    return Steady(out, rate, lambda number: text(stamped(number, size)), catches_up=True)


def ages(there: Listener, relay: Relay | None = None) -> list[float]:
    """Return the age (s) of each message on arrival, in order, without the relay's pauses."""
    received = [*there.received]  # more may come at once
    made = [read_stamp(deserialize_message(payload, String).data)[1] for payload in there.payloads[: len(received)]]
    ways = zip(made, received, strict=True)
    paused = relay.paused if relay is not None else lambda *_: 0.0
    return [(came - stamp) / 1e9 - paused(stamp, came) for stamp, came in ways]


def capacity(relay: Relay, seconds: float) -> float:
    """Bytes that the tunnel could carry in the last so many seconds, without the relay's pauses."""
    end = time.time_ns()
    return TUNNEL * (seconds - relay.paused(end - int(seconds * 1e9), end))
