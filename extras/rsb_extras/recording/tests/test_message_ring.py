"""The bounds of what is kept in memory, at any rate."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.recording.message_ring import MESSAGE_COST, MessageRing, RingMessage, of_last

if TYPE_CHECKING:
    from collections.abc import Sequence

LATCHED = Qos(durability="transient_local")
CHAT = TopicSpec("/chat", "std_msgs/msg/String", "RIHS01_", Qos())
MAP = TopicSpec("/map", "nav_msgs/msg/OccupancyGrid", "RIHS01_", LATCHED)
FRAMES = TopicSpec("/tf_static", "tf2_msgs/msg/TFMessage", "RIHS01_", LATCHED)


def message(at: float, content: bytes | int = 100, topic: TopicSpec = CHAT) -> RingMessage:
    """A message that came `at` (s), with a content or of a size."""
    return RingMessage(at, topic, bytes(content) if isinstance(content, int) else content, int(at * 1e9), 0, 0)


def times(messages: Sequence[RingMessage]) -> list[float]:
    return [each.at for each in messages]


def held(ring: MessageRing, now: float) -> int:
    return sum(each.cost for part in ring.copy(now) for each in part)


def test_what_is_too_old_goes() -> None:
    ring = MessageRing(10.0, 1 << 20)
    for at in range(30):
        ring.add(message(at))
    assert times(ring.copy(29.0)[1]) == [*range(19, 30)]
    assert times(ring.copy(35.0)[1]) == [*range(25, 30)]
    assert ring.copy(100.0) == ([], [])
    assert ring.held == 0


@pytest.mark.parametrize("size", [0, 1, 100, 5000, 40_000])
def test_bytes_are_bounded_at_any_size(size: int) -> None:
    ring = MessageRing(1e9, 50_000)
    for at in range(3000):
        ring.add(message(at, size, (CHAT, MAP, FRAMES)[at % 3]))
        assert ring.held <= 50_000
    assert ring.held == held(ring, 3000.0)
    assert times(ring.copy(3000.0)[1])[-1] == 2999


def test_memory_is_what_is_counted() -> None:
    limit = 4 << 20
    ring = MessageRing(1e9, limit)
    ring.add(message(0.0))
    tracemalloc.start()
    for number in range(40_000):
        at = number + 0.5
        ring.add(RingMessage(at, CHAT, b"%08d" % number * 2, number << 40, (number << 40) + 1, number + 1000))
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(ring) < 40_000
    assert 0.7 * limit < taken < limit


def test_message_larger_than_all_is_left_out() -> None:
    ring = MessageRing(10.0, 1000)
    ring.add(message(1.0))
    ring.add(message(2.0, 1000))
    assert (ring.left_out, times(ring.copy(2.0)[1])) == (1, [1.0])


def test_newest_of_latched_topic_stays() -> None:
    ring = MessageRing(10.0, 1 << 20)
    for at in range(3):
        ring.add(message(at, 100_000, MAP))
    ring.add(message(3.0))
    latched, messages = ring.copy(1000.0)
    assert (times(latched), messages) == ([2.0], [])
    ring.add(message(1001.0, 100_000, MAP))
    latched, messages = ring.copy(1001.0)
    assert (times(latched), times(messages)) == ([2.0], [1001.0]), "a late joiner of before has the old map"
    assert times(ring.copy(1012.0)[0]) == [1001.0], "the new map replaces the old one"


def test_small_latched_messages_stay_together() -> None:
    ring = MessageRing(10.0, 1 << 20)
    for at in range(20):
        ring.add(message(at, b"%300d" % at, FRAMES))
    assert times(ring.copy(1000.0)[0]) == [*range(20)]


def test_latched_messages_give_way_to_bytes() -> None:
    ring = MessageRing(10.0, 100_000)
    for number in range(5):
        ring.add(message(number, 30_000, MAP._replace(topic=f"/map{number}")))
    ring.add(message(1000.0, 90_000))
    latched, messages = ring.copy(1000.0)
    assert (latched, times(messages)) == ([], [1000.0])
    assert ring.held == 90_000 + MESSAGE_COST


def test_shorter_window_begins_with_latched_messages() -> None:
    ring = MessageRing(100.0, 1 << 20)
    for at in range(10):
        ring.add(message(at + 0.1, 100_000 if at < 5 else 10, MAP if at < 5 else CHAT))
    latched, messages = of_last(*ring.copy(10.0), began=7.0)
    assert (times(latched), times(messages)) == ([4.1], [7.1, 8.1, 9.1])
    latched, messages = of_last(*ring.copy(10.0), began=50.0)
    assert (times(latched), messages) == ([4.1], [])


def test_all_latched_messages_of_a_large_ring_are_returned() -> None:
    """The ring may be twice as large as the bound on what a file of the ring on disk begins with."""
    ring = MessageRing(1.0, 256 << 20)
    for number, topic in enumerate(("/map", "/plan", "/world")):
        ring.add(message(number, bytes([number]) + bytes(50 << 20), TopicSpec(topic, MAP.type_name, "", LATCHED)))
    latched, _ = of_last(*ring.copy(10.0), began=9.0)
    assert times(latched) == [0, 1, 2]
