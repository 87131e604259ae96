"""Messages beyond 8 MiB, which DDS gets on another thread: all conditions are asked right before that."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.gates_helpers import armed
from tests.route.unpacking_helpers import HUGE, HeldLoop, OnePublisher, grown, opened, reopened
from tests.support.inside import outputs_of
from tests.support.offline import FakePeer
from tests.support.reports import told_counts

from rsb_bridge.model.qos import Qos
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.latched import LatchedTopic
from rsb_bridge.route.lease import LASTS
from rsb_bridge.wire.framing import HISTORY, LEASED
from rsb_bridge.wire.headers import HistoryHeader, with_number
from rsb_bridge.wire.messages import Ready

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.context import Context
    from rsb_bridge.route.receiver import Receiver
    from rsb_bridge.wire.framing import Message

MAX_AGE = 0.5
ARMED, AGED, LATCHED = "armed", "aged", "latched"
"""The kinds of topics whose messages may not be wanted any more, or have to wait."""


@pytest.fixture
def loop() -> Iterator[HeldLoop]:
    loop = HeldLoop()
    yield loop
    loop.close()


class Side:
    """A receiving half whose long messages wait until a test lets the other thread work."""

    def __init__(self, kind: str, loop: HeldLoop, make_context: Callable[..., Context]) -> None:
        self.loop, self.ros = loop, OnePublisher()
        self.context = make_context(ros=self.ros)
        qos = Qos(durability="transient_local", depth=3) if kind == LATCHED else Qos()
        self.receiver: Receiver = opened(self.context, FakePeer(), "/x", qos)
        self._kind, self._number = kind, 0
        self._lease = armed(self.receiver.route.arming, self.context).number if kind == ARMED else 0
        if kind == AGED:
            self.receiver.route.age.settle((MAX_AGE,), armed=False)

    def message(self, content: Message) -> Message:
        payload, _, flags = content
        self._number += 1
        if self._kind == LATCHED:
            payload, flags = HistoryHeader(bytes(16), self._number, 3).pack() + payload, flags | HISTORY
        if self._kind == ARMED:
            payload, flags = with_number(self._lease, payload), flags | LEASED
        return payload, self.context.stamps.now(), flags

    def deliver(self, *contents: Message) -> None:
        self.receiver.deliver([self.message(each) for each in contents])

    @property
    def sizes(self) -> list[int]:
        return self.ros.published.sizes

    def counts(self) -> tuple[int, int, dict[str, int]]:
        report = told_counts(self.receiver)
        return report.received, report.delivered, report.dropped

    def settle(self) -> None:
        """Let the other thread do all that is left, and timers end."""
        while self.loop.held:
            self.loop.finish_one()
        self.loop.run_until_complete(asyncio.sleep(0.1))


@pytest.fixture(params=[ARMED, AGED, LATCHED])
def side(request: Any, loop: HeldLoop, make_context: Callable[..., Context]) -> Side:
    return Side(request.param, loop, make_context)


def test_all_go_to_the_other_thread_in_order(side: Side) -> None:
    side.deliver(grown(HUGE), (b"small", 0, 0))
    side.loop.finish_one()  # unpacks it
    side.deliver((b"last", 0, 0))
    assert not side.sizes
    side.settle()
    assert side.sizes == [HUGE, 5, 4]
    assert side.counts() == (3, 3, {})
    assert not side.loop.errors


@pytest.mark.parametrize("kind", [ARMED, AGED])
@pytest.mark.parametrize("handed", [False, True])
def test_old_message_is_dropped_before_dds(
    kind: str, handed: bool, loop: HeldLoop, make_context: Callable[..., Context]
) -> None:
    """Whether the thread has it already, or is busy."""
    side = Side(kind, loop, make_context)
    if not handed:
        other = opened(side.context, side.receiver.route.peer, "/other")  # type: ignore[arg-type]
        other.deliver([grown(HUGE)])
    side.deliver((bytes(HUGE), 0, 0), (b"small", 0, 0))
    loop.jump(max(LASTS, MAX_AGE) * 1.1)
    side.settle()
    assert [each for each in side.sizes if each == HUGE] == [HUGE] * (not handed)
    received, delivered, dropped = side.counts()
    assert (received, delivered) == (2, 0)
    assert sum(dropped.values()) == 2
    assert not loop.errors


@pytest.mark.parametrize("handed", [False, True])
def test_disarmed_message_is_dropped_before_dds(
    handed: bool, loop: HeldLoop, make_context: Callable[..., Context]
) -> None:
    side = Side(ARMED, loop, make_context)
    if not handed:
        opened(side.context, side.receiver.route.peer, "/other").deliver([grown(HUGE)])  # type: ignore[arg-type]
    side.deliver((bytes(HUGE), 0, 0), (b"small", 0, 0))
    side.receiver.route.disarm(Disarmed.OPERATOR)
    side.settle()
    assert side.sizes == [HUGE] * (not handed)
    assert side.counts() == (2, 0, {"disarmed": 2})


@pytest.mark.parametrize("kind", [ARMED, AGED])
def test_message_of_a_closed_opening_is_not_published(
    kind: str, loop: HeldLoop, make_context: Callable[..., Context]
) -> None:
    """It has not been counted, so that its sender counts it as lost with the link."""
    side = Side(kind, loop, make_context)
    side.deliver((b"small", 0, 0), (bytes(HUGE), 0, 0))
    side.receiver.route.close("over")
    side.settle()
    assert side.sizes == [5]
    peer = side.receiver.route.peer
    assert isinstance(peer, FakePeer)
    reopened(side.receiver)
    (before,) = [each.before for each in peer.sent[-3:] if isinstance(each, Ready) and each.before]
    assert (before.received, before.delivered) == (1, 1)


def test_latched_message_outlives_its_opening(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """The sender does not send it again, because the receiver has its number."""
    side = Side(LATCHED, loop, make_context)
    side.deliver((bytes(HUGE), 0, 0))
    side.receiver.route.close("over")
    side.settle()
    assert side.sizes == [HUGE]


def test_late_latched_message_goes_to_the_other_thread(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """It has waited for an output of DDS that had to be discovered."""
    side = Side(LATCHED, loop, make_context)
    (topic,) = outputs_of(side.receiver).sinks
    assert isinstance(topic, LatchedTopic)
    side.ros.published.acknowledged = False
    for _ in range(4):
        side.deliver((b"small", 0, 0))
    side.deliver((bytes(HUGE), 0, 0), (b"last", 0, 0))
    assert side.sizes == [5, 5, 5]
    side.ros.published.acknowledged = True
    loop.run_until_complete(asyncio.sleep(0.1))
    assert side.sizes == [5] * 4
    side.settle()
    assert side.sizes == [5, 5, 5, 5, HUGE, 4]


def test_aged_latched_message_is_dropped_before_dds(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    side = Side(LATCHED, loop, make_context)
    side.receiver.route.age.settle((MAX_AGE,), armed=False)
    side.deliver((bytes(HUGE), 0, 0), (b"small", 0, 0))
    loop.jump(2 * MAX_AGE)
    side.settle()
    assert not side.sizes
    assert side.counts() == (2, 0, {"expired": 2})
