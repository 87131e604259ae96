"""The queue of a route's channel, and its drops."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.route.sending import QueueLimits, SendQueue
from rsb_bridge.wire.framing import Budget

if TYPE_CHECKING:
    from rsb_bridge.wire.framing import Message

ANY = 1 << 30


def messages(*names: str) -> list[Message]:
    return [(name.encode(), 0, 0) for name in names]


def names(queue: SendQueue) -> str:
    return " ".join(payload.decode() for payload, _, _ in queue.take(1000, ANY))


def test_the_oldest_beyond_the_depth_give_way() -> None:
    queue = SendQueue(Budget(ANY))
    queue.add(messages("a", "b", "c"), 0.0, b"")
    assert queue.trim(QueueLimits(0, 0.0, ANY), 0.0, b"") == (0, 0)
    assert queue.trim(QueueLimits(2, 0.0, ANY), 0.0, b"") == (1, 0)
    assert names(queue) == "b c"


def test_what_is_young_enough_stays_beyond_the_depth() -> None:
    queue, limits = SendQueue(Budget(ANY)), QueueLimits(2, 5.0, ANY)
    for second in range(10):
        queue.add(messages(str(second)), float(second), b"")
        queue.trim(limits, float(second), b"")
    assert names(queue) == "5 6 7 8 9"


def test_old_messages_go_unless_newest() -> None:
    queue, limits = SendQueue(Budget(ANY)), QueueLimits(10, 0.0, ANY, 1.0)
    for second, name in ((0.0, "a"), (0.5, "b"), (1.2, "c")):
        queue.add(messages(name), second, b"")
        queue.trim(limits, second, b"")
    assert queue.trim(limits, 1.4, b"") == (0, 0)
    assert queue.trim(limits, 9.0, b"") == (1, 0)
    assert names(queue) == "c"


def test_bytes_are_bounded_but_for_one_message() -> None:
    queue, limits = SendQueue(Budget(ANY)), QueueLimits(0, 0.0, 10)
    queue.add(messages("123456", "12345", "x" * 100), 0.0, b"")
    assert queue.trim(limits, 0.0, b"") == (0, 2)
    assert len(queue) == 1
    queue.add(messages("ab"), 0.0, b"")
    assert queue.trim(limits, 0.0, b"") == (0, 1)
    assert names(queue) == "ab"


def test_each_publisher_has_a_depth_of_its_own() -> None:
    queue, limits = SendQueue(Budget(ANY)), QueueLimits(1, 0.0, ANY)
    for number in range(3):
        for publisher in ("a", "b", "c"):
            queue.add(messages(f"{publisher}{number}"), 0.0, publisher.encode())
            queue.trim(limits, 0.0, publisher.encode())
    queue.add(messages("d0", "d1"), 0.0, b"d")
    queue.trim(QueueLimits(5, 0.0, ANY), 0.0, b"d")
    assert names(queue) == "a2 b2 c2 d0 d1"


def test_publishers_are_told_apart_of_what_waited_without_limits() -> None:
    queue = SendQueue(Budget(ANY))
    for name in ("a0", "b0", "a1", "b1", "a2"):
        queue.add(messages(name), 0.0, name[:1].encode())
        queue.trim(QueueLimits(0, 0.0, ANY), 0.0, name[:1].encode())
    assert queue.take(1, ANY) == messages("a0")
    limits = QueueLimits(1, 0.0, ANY)
    assert queue.publishers == {b"a", b"b"}
    assert [queue.trim(limits, 0.0, publisher) for publisher in (b"a", b"b")] == [(1, 0), (1, 0)]
    assert names(queue) == "b1 a2"
    queue.add(messages("a3"), 0.0, b"a")
    assert queue.trim(limits, 0.0, b"a") == (0, 0)


def test_bytes_move_with_the_budget() -> None:
    first, second = Budget(10), Budget(4)
    queue, other = SendQueue(first), SendQueue(second)
    queue.add(messages("abc"), 0.0, b"")
    other.add(messages("d"), 0.0, b"")
    assert queue.room() == 10
    queue.charge(second)
    queue.charge(second)
    assert (first.held, second.held, queue.room()) == (0, 4, 3)
    assert queue.clear() == 1
    assert (first.held, second.held, queue.room()) == (0, 1, 3)


def test_a_batch_ends_at_its_size_or_number() -> None:
    queue = SendQueue(Budget(ANY))
    queue.add(messages("aa", "bb", "cc", "dd"), 0.0, b"")
    assert queue.take(10, 3) == messages("aa", "bb")
    assert queue.take(1, 100) == messages("cc")
    assert queue.clear() == 1
    assert queue.take(10, 10) == []
    assert not queue


def test_all_queues_of_a_link_are_counted_together() -> None:
    held = Budget(10)
    one, other = SendQueue(held), SendQueue(held)
    one.add(messages("abc", "d"), 0.0, b"")
    other.add(messages("efgh"), 0.0, b"")
    assert held.held == one.size + other.size == 8
    assert one.trim(QueueLimits(0, 0.0, 2), 0.0, b"") == (0, 1)
    assert other.take(1, ANY)
    assert held.held == one.size == 1
    one.clear()
    assert held.held == 0
