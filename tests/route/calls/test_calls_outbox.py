"""Frames that wait for a channel: in order, bounded, and none that is wanted no more."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import zstandard

from rsb_bridge.model.calls import FEEDBACK, LANES, SEND_GOAL, STATUS
from rsb_bridge.route.calls.call_frames import CallsOutbox
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.framing import ZSTD
from rsb_bridge.wire.headers import CallFrame, What, unpack_call
from rsb_bridge.wire.messages import Propose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.wire.framing import Message


class FakeChannel:
    """Takes everything."""

    batch_bytes = 1 << 16
    ready = True
    congested = False

    def __init__(self) -> None:
        self.sent: list[Message] = []

    def send(self, batch: Sequence[Message]) -> None:
        self.sent.extend(batch)

    def ask(self) -> None: ...

    def frames(self) -> list[CallFrame]:
        return [unpack_call(payload) for payload, _, _ in self.sent]


@pytest.fixture
def ended() -> set[int]:
    return set()


@pytest.fixture
def outbox(ended: set[int]) -> Queue:
    return Queue(ended)


class Queue(CallsOutbox):
    """The outbox of an action, with a channel when the test wants it to have one."""

    def __init__(self, ended: set[int], **proposed: Any) -> None:
        proposal = Propose(route=1, topic="/go", remote_topic="/go", from_client=True, kind="action", **proposed)
        context = SimpleNamespace(clock=SimpleNamespace(time_ns=lambda: 7), stamps=SimpleNamespace(shift=0))
        route = SimpleNamespace(transport=default_transports()["tcp"], proposal=proposal, context=context)
        self._carried = SimpleNamespace(channel=None)
        flow: Any = SimpleNamespace(route=route, members=LANES["action"], carried=self._carried)
        super().__init__(flow, lambda frame: frame.call not in ended)

    def flushed(self) -> FakeChannel:
        """Flush it into a new channel."""
        self._carried.channel = channel = FakeChannel()
        self.flush()
        return channel


def call(number: int) -> CallFrame:
    return CallFrame(What.CALL, SEND_GOAL, number, 0, b"request %d" % number)


def message(lane: int, content: bytes) -> CallFrame:
    return CallFrame(What.MESSAGE, lane, 0, 0, content)


def test_frames_leave_in_order_without_finished_calls(outbox: Queue, ended: set[int]) -> None:
    frames = [call(1), message(FEEDBACK, b"one"), call(2), call(3), CallFrame(What.REFUSED, SEND_GOAL, 9, 0, b"paused")]
    for frame in frames:
        outbox.put(frame)
    ended.add(2)
    assert outbox.flushed().frames() == [frames[0], frames[1], frames[3], frames[4]]


def test_finished_calls_are_not_sent(outbox: Queue, ended: set[int]) -> None:
    outbox.put(call(1))
    ended.add(1)
    assert not outbox.flushed().sent


def test_nothing_waits_of_a_call_that_is_over(outbox: Queue) -> None:
    """A peer that reads nothing makes calls expire, which give back their places in the budget."""
    for number in range(1, 4):
        outbox.put(call(number))
        outbox.put(message(FEEDBACK, b"%d" % number))
    for number in (1, 3, 9):
        outbox.forget(number)
    assert [each.content for each in outbox.flushed().frames()] == [b"1", b"request 2", b"2", b"3"]


def test_lane_keeps_its_depth_of_newest(outbox: Queue) -> None:
    for number in range(25):
        outbox.put(message(FEEDBACK, b"%d" % number))
        outbox.put(message(STATUS, b"status %d" % number))
    contents = [frame.content for frame in outbox.flushed().frames()]
    assert [each for each in contents if b"status" not in each] == [b"%d" % number for number in range(15, 25)]
    assert [each for each in contents if b"status" in each] == [b"status 24"]


def test_link_that_stands_still_keeps_more_messages(outbox: Queue) -> None:
    for number in range(25):
        outbox.put(message(FEEDBACK, b"%d" % number), still=1.0)
    for number in range(25, 30):
        outbox.put(message(FEEDBACK, b"%d" % number))
    assert [each.content for each in outbox.flushed().frames()] == [b"%d" % number for number in range(5, 30)]


def test_messages_that_wait_are_bounded_in_bytes(outbox: Queue) -> None:
    for _ in range(10):
        outbox.put(message(FEEDBACK, bytes(12 << 20)))
    assert len(outbox.flushed().sent) == 2


def test_large_message_displaces_as_much_as_it_needs(outbox: Queue) -> None:
    large = (32 << 20) - 10
    for size in (10, 10, 10, large):
        outbox.put(message(FEEDBACK, bytes(size)))
    assert [len(each.content) for each in outbox.flushed().frames()] == [10, large]


def test_refusals_that_wait_are_bounded(outbox: Queue) -> None:
    for number in range(1, 8200):
        outbox.put(CallFrame(What.REFUSED, SEND_GOAL, number, 0, b"paused"))
    assert [frame.call for frame in outbox.flushed().frames()] == [*range(1, 8193)]
    outbox.put(CallFrame(What.REFUSED, SEND_GOAL, 8200, 0, b"paused"))
    assert outbox.flushed().frames()[-1].call == 8200


def test_a_new_opening_begins_with_nothing(outbox: Queue) -> None:
    outbox.put(call(1))
    outbox.put(message(FEEDBACK, b"one"))
    outbox.clear()
    assert not outbox.flushed().sent


def test_contents_are_compressed_and_headers_are_not() -> None:
    outbox = Queue(set(), compression="zstd")
    large = call(1)._replace(content=bytes(100_000))
    outbox.put(large)
    outbox.put(call(2))
    (packed, _, flags), (plain, _, no_flags) = outbox.flushed().sent
    assert (flags, no_flags) == (ZSTD, 0)
    frame = unpack_call(packed)
    assert frame._replace(content=zstandard.decompress(frame.content)) == large
    assert unpack_call(plain) == call(2)
