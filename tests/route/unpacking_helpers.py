"""Helpers of `test_unpacking` and others."""

from __future__ import annotations

import asyncio
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
import zstandard
from tests.support.virtual_time import T, Ts, VirtualLoop, closed_in_the_end

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.message_check import EXPANSION_A_TURN, PUBLISHED_ASIDE
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.route import Entry, Route
from rsb_bridge.wire.framing import ZSTD
from rsb_bridge.wire.messages import Describe, Propose
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from tests.support.offline import FakePeer

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import TopicSpec
    from rsb_bridge.wire.framing import Message


LARGE = EXPANSION_A_TURN * 3 // 4


HUGE = PUBLISHED_ASIDE + 1
"""Published on another thread, too."""


class Published:
    """A publisher that notes the sizes of its messages."""

    gid = b""
    subscriber_count = 0
    acknowledged = True

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.refuses = False

    def assert_liveliness(self) -> None:
        pass

    def publish(self, content: bytes) -> None:
        if self.refuses:
            raise RosError("refused")
        self.sizes.append(len(content))

    def close(self) -> None:
        pass


class OnePublisher(NoRos):
    def __init__(self) -> None:
        self.published = Published()

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Published:
        return self.published


def opened(context: Context, peer: FakePeer, topic: str, qos: Qos | None = None) -> Receiver:
    proposal = Propose(route=2, topic=topic, remote_topic=topic, from_client=False)
    entry = Entry(Topic(topic, "receive"), proposal)
    receiver = Route(Receiver, context, peer, entry, proposed_here=False).half
    assert isinstance(receiver, Receiver)
    reopened(receiver, qos or Qos())
    return receiver


def reopened(receiver: Receiver, qos: Qos = Qos()) -> None:  # noqa: B008
    """Begin an opening with one source."""
    receiver.route.open(2)
    receiver.route.on_accepted()
    receiver.described(Describe(2, "std_msgs/msg/String", "RIHS01_" + "0" * 64, qos, (Source(("there",)),)))


def grown(size: int) -> Message:
    return zstandard.ZstdCompressor(1).compress(bytes(size)), 0, ZSTD


class HeldLoop(VirtualLoop):
    """A loop whose other threads work on the test's command.

    Attributes:
        held: their work, and what gets its result.
    """

    def __init__(self) -> None:
        super().__init__()
        self.held: deque[tuple[Callable[[], Any], asyncio.Future[Any]]] = deque()

    def run_in_executor(self, executor: Any, func: Callable[[*Ts], T], *args: *Ts) -> asyncio.Future[T]:
        done: asyncio.Future[T] = self.create_future()
        self.held.append((partial(func, *args), done))
        return done

    def finish_one(self) -> None:
        work, done = self.held.popleft()
        done.set_result(work())
        self.run_until_complete(asyncio.sleep(0))
        self.run_until_complete(asyncio.sleep(0))


@pytest.fixture
def loop() -> Iterator[HeldLoop]:
    with closed_in_the_end(HeldLoop()) as loop:
        yield loop
