"""Armed messages and requests are checked right before DDS gets them, after all delays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.route.calls.goal_cancels_helpers import Client
from tests.route.calls.held_helpers import GOAL, Dock, providing
from tests.route.gates_helpers import armed
from tests.route.unpacking_helpers import OnePublisher, Published, opened
from tests.route.volatile_helpers import unwanted
from tests.support.inside import outputs_of, refusal_of
from tests.support.offline import FakePeer
from tests.support.reports import told_counts

from rsb_bridge.model.calls import SEND_GOAL, Refused
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.lease import LASTS
from rsb_bridge.route.source_publishers import FREE, VolatileTopic
from rsb_bridge.wire.framing import LEASED, Budget
from rsb_bridge.wire.headers import CallFrame, What, with_number
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.calls.provider import Provider
    from rsb_bridge.route.receiver import Receiver

LONG = bytes(4) + bytes(FREE)
"""A message before which DDS is asked what it still holds."""


class _Waits:
    """A check of contents, in which the process stands still."""

    loops = False

    def __init__(self, loop: VirtualLoop, seconds: float) -> None:
        self._loop = loop
        self._seconds = seconds

    def check(self, _: bytes) -> None:
        self._loop.jump(self._seconds)


class _Asked(Published):
    """A publisher that stands still when it is asked what it holds."""

    def __init__(self, loop: VirtualLoop, seconds: float) -> None:
        super().__init__()
        self._loop = loop
        self._seconds = seconds

    @property
    def acknowledged(self) -> bool:  # type: ignore[override]
        self._loop.jump(self._seconds)
        return True


def _stands_in_the_check(receiver: Receiver, _: OnePublisher, loop: VirtualLoop, seconds: float) -> None:
    receiver.check.checker = _Waits(loop, seconds)  # type: ignore[assignment]


def _stands_in_dds(receiver: Receiver, ros: OnePublisher, loop: VirtualLoop, seconds: float) -> None:
    outputs_of(receiver).close()
    ros.published = _Asked(loop, seconds)
    outputs_of(receiver).sinks.append(
        VolatileTopic(ros.published, 10, receiver.route.peer.budget.unacknowledged, loop.time)
    )


@pytest.mark.parametrize("stand", [_stands_in_the_check, _stands_in_dds])
@pytest.mark.parametrize(("seconds", "count"), [(LASTS / 2, 1), (LASTS * 1.1, 0)])
def test_message_that_aged_towards_dds_is_dropped(
    stand: Callable[[Receiver, OnePublisher, VirtualLoop, float], None],
    seconds: float,
    count: int,
    loop: VirtualLoop,
    make_context: Callable[..., Context],
) -> None:
    ros = OnePublisher()
    context = make_context(ros=ros)
    receiver = opened(context, FakePeer(), "/cmd")
    number = armed(receiver.route.arming, context).number
    stand(receiver, ros, loop, seconds)
    receiver.deliver([(with_number(number, LONG), context.stamps.now(), LEASED)])
    assert len(ros.published.sizes) == count
    report = told_counts(receiver)
    assert (report.received, report.delivered, report.dropped.get("disarmed", 0)) == (1, count, 1 - count)


@pytest.mark.parametrize(("seconds", "why"), [(LASTS / 2, None), (LASTS * 1.1, Refused.UNHEARD)])
def test_goal_that_aged_towards_dds_is_dropped(
    seconds: float, why: Refused | None, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    context = make_context()
    half = providing(context)
    half.under_way.entries = (LaneEntry("a/action/B_SendGoal", "h", 1),)
    number = armed(half.route.arming, context).number

    def slow(frame: CallFrame, part: str) -> Refused | None:
        loop.jump(seconds)
        return None

    half.types.malformed = slow  # type: ignore[method-assign]
    assert refusal_of(half, CallFrame(What.CALL, SEND_GOAL, 1, 0, GOAL, number)) is why


def _disarmed(half: Provider) -> None:
    half.route.arming.end(Disarmed.OPERATOR)


def _armed_by_another(half: Provider) -> None:
    _disarmed(half)
    route = half.route
    route.id += 1
    route.arming.opened(required=True, deadman=0.0)
    route.arming.arm_for_peer("bert", route.context.now())
    route.arming.lives()


@pytest.mark.parametrize(("meanwhile", "sent"), [(_disarmed, []), (_armed_by_another, []), (lambda _: None, [GOAL])])
def test_goal_by_hand_needs_present_arming(
    meanwhile: Callable[[Provider], None],
    sent: list[bytes],
    loop: VirtualLoop,
    make_context: Callable[..., Context],
) -> None:
    """DDS may take seconds to find the server."""
    client = Client()
    context = make_context(Dock(client))
    half = providing(context)
    armed(half.route.arming, context)
    client.ready = False
    loop.call_later(0.1, meanwhile, half)
    loop.call_later(0.2, setattr, client, "ready", True)
    with pytest.raises(CallError):  # nobody answers, either
        loop.run_until_complete(half.call_by_hand(SEND_GOAL, GOAL))
    assert client.calls == sent


def test_unwanted_message_is_not_counted_as_memory(loop: VirtualLoop) -> None:
    published, budget = Published(), Budget(10 * len(LONG))
    topic = VolatileTopic(published, 1000, budget, loop.time)

    for _ in range(100):
        assert topic.publish(LONG, unwanted) is unwanted()
    assert not published.sizes
    assert budget.held <= len(LONG)
    topic.publish(LONG)
    assert published.sizes == [len(LONG)]
