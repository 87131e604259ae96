"""One topic's trouble is not another's: the real programs, a hundred topics, and some that cannot keep up."""

from __future__ import annotations

import itertools
import time
from typing import TYPE_CHECKING

import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from tests.support.domain import BEST_EFFORT, text
from tests.support.waiting import eventually, holds

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener
    from tests.support.program import Program, Programs
    from tests.support.relay import Relay

DEPTH = {"depth": 1000}
SENSOR = {"profile": "sensor_data", "depth": 1000}
BIG = "x" * 100_000
_numbers = itertools.count()
_HELD_UP = 1.0
"""s; what waits for a topic that is stuck comes later than this, however fast the machine is."""
_NOTICED = 3.0
"""s, at most, until a stream that is stuck counts no longer: 1.5 without a receipt, looked at once a second."""


def crosses(publisher: Publisher, listener: Listener, words: str = "hello") -> None:
    """Publish until it arrives."""

    def heard() -> bool:
        publisher.publish(text(words))
        time.sleep(0.02)
        return listener.texts(1) == [words]

    eventually(heard)


def delay(fast: Publisher, there: Listener, slow: Publisher | None = None) -> float:
    """The median latency, s, of 200 messages or more at 100 Hz, while `slow` publishes 10 MB/s.

    They are best effort: a reliable one that DDS loses on this machine waits up to 3 s for DDS to send it again.
    """
    began, sent = time.monotonic(), dict[str, int]()

    def delays() -> list[float]:  # of these only: earlier messages may still arrive
        came = zip(there.payloads, there.received, strict=False)  # one more may have come for the second
        said = ((deserialize_message(payload, String).data, got) for payload, got in came)
        return [(got - sent[words]) / 1e9 for words, got in said if words in sent]

    while len(sent) < 200 or len(delays()) < 100:  # a machine that starves the bridge may lose most for a while
        assert time.monotonic() < began + 60, f"of {len(sent)} messages {len(delays())} came"
        words = f"{next(_numbers)}"
        sent[words] = time.time_ns()
        fast.publish(text(words))
        if slow is not None:
            slow.publish(text(BIG))
        time.sleep(max(0.0, began + len(sent) / 100 - time.monotonic()))
    found = sorted(delays())
    return found[len(found) // 2]


def still(listener: Listener) -> int:
    """Wait until what is on its way has come, for a second without a message; return how many have come."""
    came, since = -1, time.monotonic()

    def is_still() -> bool:
        nonlocal came, since
        if len(listener.payloads) != came:
            came, since = len(listener.payloads), time.monotonic()
        return time.monotonic() - since > 1.0

    eventually(is_still)
    return came


@pytest.fixture
def both(bridge: Bridge, relay: Relay, programs: Programs) -> tuple[Program, Program]:
    """A server and a client with a fast topic and a slow one."""
    topics = Topic("/fast", "transmit", qos=SENSOR), Topic("/slow", "transmit", qos=DEPTH)
    return programs.start(bridge.server_session()), programs.start(bridge.client_session(*topics))


@pytest.mark.usefixtures("both")
def test_a_topic_whose_stream_is_stuck(relay: Relay, robot: Domain, pc: Domain) -> None:
    """Nothing gets through on its connection any more, while its messages go on coming."""
    fast, slow = robot.publisher("/fast", qos=BEST_EFFORT), robot.publisher("/slow")
    there, slow_there = pc.listener("/fast", qos=BEST_EFFORT), pc.listener("/slow", qos=QoSProfile(depth=5))
    crosses(fast, there)
    crosses(slow, slow_there, BIG)
    usual = delay(fast, there)
    stuck = max(relay.connections, key=lambda connection: connection.sent_bytes)
    stuck.stall()
    assert delay(fast, there, slow) < usual + _NOTICED
    heard = still(slow_there)
    assert delay(fast, there, slow) < usual + _HELD_UP
    holds(lambda: len(slow_there.payloads) == heard, 0.2)
    stuck.stall(False)
    eventually(lambda: len(slow_there.payloads) > heard)


def test_a_hundred_topics_at_20_hz(bridge: Bridge, programs: Programs, robot: Domain, pc: Domain) -> None:
    """Half of them over TCP, half over UDP: all of it arrives, in order, at the rate at which it was published."""
    names = [f"/topic{number}" for number in range(100)]
    publishers, listeners = [robot.publisher(name) for name in names], [pc.listener(name) for name in names]
    topics = [Topic(name, "transmit", qos=DEPTH, protocol=("tcp", "udp")[n % 2]) for n, name in enumerate(names)]
    programs.start(bridge.server_session())
    programs.start(bridge.client_session(*topics))
    for publisher, listener in zip(publishers, listeners, strict=True):
        crosses(publisher, listener)
    for numbers in (range(30), range(30, 60)):  # the first half arrives before the second is published
        began = time.monotonic()
        for number in numbers:
            for publisher in publishers:
                publisher.publish(text(f"{number}"))
            time.sleep(max(0.0, began + (number - numbers[0] + 1) / 20 - time.monotonic()))
        for listener in listeners:
            eventually(lambda listener=listener, last=f"{numbers[-1]}": listener.texts(1) == [last])
    for listener in listeners:
        assert listener.texts(60) == [f"{number}" for number in range(60)]
