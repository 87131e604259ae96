"""Large messages are taken and published without copies of their own, and are the same bytes."""

from __future__ import annotations

import contextlib
import random
import threading
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.replaced import PUBLISH_LONG_MESSAGE
from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RosError, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.node import RosNode

_HASH = "RIHS01_" + "5b" * 32
_HEADER = b"\x00\x01\x00\x00"
_SIZES = (4, 16_383, 16_384, 32_767, 32_768, 32_769, 65_535, 65_536, 65_537, 262_144, 1 << 20, 6_000_000, 100, 33 << 20)


def _payload(size: int) -> bytes:
    return (_HEADER + random.Random(size).randbytes(1 << 16) * (size // (1 << 16) + 1))[:size]


def test_messages_of_all_sizes_are_exact(open_node: Callable[..., RosNode]) -> None:
    sender, receiver = open_node(name="sender"), open_node(name="receiver")
    taken: list[bytes] = []
    spec = TopicSpec("/large", "made_up_msgs/msg/Blob", _HASH, Qos(depth=100))
    receiver.subscribe(spec, lambda batch: taken.extend(each.payload for each in batch), "link")
    publisher = sender.advertise(spec, "link")
    eventually(lambda: publisher.subscriber_count)
    for size in _SIZES:
        publisher.publish(_payload(size))
    eventually(lambda: len(taken) == len(_SIZES))
    for size, payload in zip(_SIZES, taken, strict=True):
        assert type(payload) is bytes
        assert payload == _payload(size)


def test_first_ones_are_handed_over_early(open_node: Callable[..., RosNode]) -> None:
    """Nor are all of them held at once by what takes them."""
    sender, receiver = open_node(name="sender"), open_node(name="receiver")
    batches: list[list[int]] = []
    goes_on = threading.Event()

    def take(batch: Any) -> None:
        batches.append([len(each.payload) for each in batch])
        goes_on.wait(60.0)

    spec = TopicSpec("/many", "made_up_msgs/msg/Blob", _HASH, Qos(depth=100))
    receiver.subscribe(spec, take, "link")
    publisher = sender.advertise(spec, "link")
    eventually(lambda: publisher.subscriber_count)
    for _ in range(60):
        publisher.publish(_payload(200_000))
    eventually(lambda: batches and publisher.acknowledged)
    goes_on.set()
    eventually(lambda: sum(map(len, batches)) == 60)
    assert max(map(sum, batches)) < (4 << 20) + 200_000


def test_our_own_large_messages_are_left_out(open_node: Callable[..., RosNode]) -> None:
    """The messages after them are whole."""
    ours, other = open_node(), open_node(name="other")
    taken: list[bytes] = []
    spec = TopicSpec("/own", "made_up_msgs/msg/Blob", _HASH, Qos(depth=100))
    mine, theirs = ours.advertise(spec, "link"), other.advertise(spec, "link")
    ours.subscribe(spec, lambda batch: taken.extend(each.payload for each in batch), "link")
    eventually(lambda: theirs.subscriber_count)
    for size in (300_000, 50, 40_000):
        mine.publish(_payload(size))
        theirs.publish(_payload(size + 1))
    eventually(lambda: len(taken) == 3)
    assert taken == [_payload(300_001), _payload(51), _payload(40_001)]


@pytest.mark.parametrize("size", [100, 20_000, 300_000])
def test_a_closed_publisher_says_so(open_node: Callable[..., RosNode], size: int) -> None:
    publisher = open_node().advertise(TopicSpec("/closed", "made_up_msgs/msg/Blob", _HASH, Qos()), "link")
    publisher.close()
    with pytest.raises(RosError, match="closed"):
        publisher.publish(_payload(size))


def test_a_publisher_is_not_freed_while_it_publishes(open_node: Callable[..., RosNode]) -> None:
    """A large message is published without the GIL: another thread may close the publisher meanwhile."""
    node, payload = open_node(), _payload(1 << 20)
    for _ in range(20):
        publisher = node.advertise(TopicSpec("/closing", "made_up_msgs/msg/Blob", _HASH, Qos()), "link")
        begun = threading.Event()

        def publish(publisher: Any = publisher, begun: threading.Event = begun) -> None:
            with contextlib.suppress(RosError):
                while True:
                    publisher.publish(payload)
                    begun.set()

        thread = threading.Thread(target=publish)
        thread.start()
        assert begun.wait(60)
        publisher.close()
        thread.join(60)
        assert not thread.is_alive()


@pytest.mark.parametrize("ends", ["publisher", "node"])
def test_long_publication_outlives_the_close_of_its_publisher(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    """Closing does not wait for it, but leaving the domain does: DDS may not lose what it works with."""
    publish: Callable[..., int] = PUBLISH_LONG_MESSAGE.value
    begun, goes_on, order = threading.Event(), threading.Event(), list[str]()

    def slow(*arguments: Any) -> int:
        begun.set()
        assert goes_on.wait(60)
        order.append("published")
        return publish(*arguments)

    PUBLISH_LONG_MESSAGE.set(monkeypatch, slow)
    node = open_node()
    publisher = node.advertise(TopicSpec("/long", "made_up_msgs/msg/Blob", _HASH, Qos()), "a link")
    publishing = threading.Thread(target=publisher.publish, args=(_payload(300_000),))
    publishing.start()
    assert begun.wait(60)
    publisher.close()

    def stop() -> None:
        node.stop()
        order.append("stopped")

    leaving = threading.Thread(target=stop)
    if ends == "node":
        leaving.start()
    goes_on.set()
    publishing.join()
    with pytest.raises(RosError):
        publisher.publish(_payload(300_000))
    if ends == "node":
        leaving.join()
        assert order == ["published", "stopped"]
