"""The order of the gates of each way, and that each one is there from the next message on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import pytest
from tests.route.test_unpacking import OnePublisher, opened
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import Request
from rsb_bridge.ros.ros_thread import RosTurns
from rsb_bridge.route.age import MessageAge
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.providing import ProvidingRoute
from rsb_bridge.route.gates import (
    NO_SAMPLE,
    AgeGate,
    ArmedGate,
    BudgetGate,
    CallRateGate,
    GatedMessage,
    LeaseGate,
    PauseGate,
    RateGate,
    SizeGate,
    YoungGate,
    calling_gates,
    chained,
    hand_gates,
    incoming_gates,
    providing_gates,
)
from rsb_bridge.route.lease import LeaseHalf
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import with_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.route.arming import Arming
    from rsb_bridge.route.gates import Gate, Gated
    from rsb_bridge.route.incoming import IncomingRoute
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.framing import Message

SECOND = 10**9


def armed(arming: Arming, context: Context) -> LeaseHalf:
    """Arm by the other side; return the lease, which both sides have answered."""
    lease = arming.lease = LeaseHalf(context.clock.steady, RosTurns(), lambda: None)
    arming.demand(required=True, deadman=0.0)
    lease.begin()
    arming.take("anna", context.now())
    for newest in range(1, 3):  # the second shows that the other side knows that it is heard
        lease.hear(newest, lease.beat()[0])
    return lease


def test_the_young_gate_asks_the_clock_of_the_side_that_took_it(make_context: Callable[..., Context]) -> None:
    context = make_context()
    age = MessageAge(context, FakePeer())
    age.settle((0.5,), armed=False)
    gate, now = YoungGate(age), context.stamps.now()
    assert gate.check(GatedMessage(now - SECOND // 4, 0), 0.0) is None
    assert gate.check(GatedMessage(now - SECOND, 0), 0.0) is Refused.TOO_OLD


class _CarriesFive:
    largest = 5


def test_the_size_gate_passes_what_the_transport_carries() -> None:
    gate = SizeGate(_CarriesFive())
    assert gate.check(Request(b"12345", b"", 0), 0.0) is None
    assert gate.check(Request(b"123456", b"", 0), 0.0) is Refused.TOO_LARGE


class _Shut:
    """A gate that nothing passes, and that notes what it is asked."""

    def __init__(self, why: Refused | None, asked: list[Refused | None]) -> None:
        self._why = why
        self._asked = asked

    def check(self, _: Gated, __: float) -> Refused | None:
        self._asked.append(self._why)
        return self._why


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_first_reason_counts_and_no_later_gate_is_asked(count: int) -> None:
    asked: list[Refused | None] = []
    gates: tuple[Gate[Gated], ...] = tuple(_Shut(None, asked) for _ in range(count - 1))
    check = chained((*gates, _Shut(Refused.TOO_OLD, asked), _Shut(Refused.PAUSED, asked)))
    assert check is not None
    assert check(NO_SAMPLE, 0.0) is Refused.TOO_OLD
    assert asked == [None] * (count - 1) + [Refused.TOO_OLD]


def test_without_gates_there_is_nothing_to_ask() -> None:
    assert chained(()) is None


# --- the order of each way


def order(gates: tuple[Gate[Any], ...]) -> list[type[object]]:
    return [type(each) for each in gates]


def everything_on(route: Route) -> None:
    route.arming.demand(required=True, deadman=0.0)
    route.age.settle((0.5,), armed=True)
    route.limit.allow_here(10.0)


def test_nothing_old_and_nothing_unarmed_gets_to_ros(make_context: Callable[..., Context]) -> None:
    """What a long check or DDS could let in is asked once more, right before DDS gets the message."""
    route = opened(make_context(ros=OnePublisher()), FakePeer(), "/cmd")
    assert all(not each for each in incoming_gates(route))
    everything_on(route)
    batch, arriving, leaving = map(order, incoming_gates(route))
    assert batch == [ArmedGate]
    assert arriving == [LeaseGate, RateGate]
    assert leaving == [LeaseGate, AgeGate]
    assert order(hand_gates(route)) == [ArmedGate]


def test_calls_pass_them_from_callers_to_the_channel(make_context: Callable[..., Context]) -> None:
    """What stops or watches a robot passes whatever it is."""
    route = calls(make_context(), CallingRoute)
    fast, slow = CallRateGate(0.0, 0.0), CallRateGate(10.0, 0.0)
    assert order(calling_gates(route, _CarriesFive(), fast, limited=True).arriving) == [PauseGate, SizeGate, BudgetGate]
    everything_on(route)
    arriving, leaving = map(order, calling_gates(route, _CarriesFive(), slow, limited=True))
    assert arriving == [PauseGate, ArmedGate, YoungGate, SizeGate, CallRateGate, BudgetGate]
    assert leaving == [YoungGate]
    arriving, leaving = map(order, calling_gates(route, _CarriesFive(), slow, limited=False))
    assert (arriving, leaving) == ([SizeGate, BudgetGate], [])


def test_calls_pass_them_from_the_channel_to_servers(make_context: Callable[..., Context]) -> None:
    """What time may change is asked again after the check of contents."""
    route = calls(make_context(), ProvidingRoute)
    arriving, leaving = map(order, providing_gates(route, limited=True))
    assert (arriving, leaving) == ([PauseGate], [BudgetGate])
    everything_on(route)
    arriving, leaving = map(order, providing_gates(route, limited=True))
    assert arriving == [AgeGate, PauseGate, ArmedGate, LeaseGate]
    assert leaving == [AgeGate, ArmedGate, LeaseGate, RateGate, BudgetGate]
    arriving, leaving = map(order, providing_gates(route, limited=False))
    assert (arriving, leaving) == ([], [BudgetGate])


Calls = TypeVar("Calls", CallingRoute, ProvidingRoute)


def calls(context: Context, half: type[Calls]) -> Calls:
    return half_of(half, context, Topic("/dock", "transmit", kind="action"), here=False)


# --- each one is on the way as long as it is on


def disarmed(route: IncomingRoute) -> None:
    route.arming.demand(required=True, deadman=0.0)


def aged(route: IncomingRoute) -> None:
    route.age.settle((0.5,), armed=False)


def limited(route: IncomingRoute) -> None:
    route.limit.allow_here(0.001)


def off(route: IncomingRoute) -> None:
    route.arming.opened(required=False, deadman=0.0)
    route.age.settle((), armed=False)
    route.limit.allow_here(0.0)


@pytest.mark.parametrize(
    ("switch", "cause", "passed"), [(disarmed, "disarmed", 0), (aged, "expired", 0), (limited, "throttled", 2)]
)
def test_a_gate_is_asked_from_the_next_message_on_until_it_is_off(
    switch: Callable[[IncomingRoute], None], cause: str, passed: int, make_context: Callable[..., Context]
) -> None:
    ros = OnePublisher()
    context = make_context(ros=ros)
    route = opened(context, FakePeer(), "/cmd")
    old: Message = (b"old", context.stamps.now() - SECOND, 0)

    def published() -> int:
        before = len(ros.published.sizes)
        route.deliver([old] * 5)
        return len(ros.published.sizes) - before

    assert published() == 5
    switch(route)
    assert published() == passed
    off(route)
    assert published() == 5
    report = route.news()
    assert report is not None
    assert (report.received, report.delivered) == (15, 10 + passed)
    assert report.dropped == {cause: 5 - passed}


def test_a_message_of_an_arming_that_this_side_does_not_know_is_not_published(
    make_context: Callable[..., Context],
) -> None:
    """Also one that is too short for the lease's number."""
    ros = OnePublisher()
    route = opened(make_context(ros=ros), FakePeer(), "/cmd")
    route.deliver([(with_number(1, b"moves"), 0, LEASED), (b"1", 0, LEASED)])
    armed(route.arming, route.context)
    route.deliver([(b"moves", 0, 0), (b"1", 0, LEASED)])
    assert not ros.published.sizes
    report = route.news()
    assert report is not None
    assert report.dropped == {"disarmed": 4}


def test_the_cause_of_an_expired_message_is_that_of_its_age(make_context: Callable[..., Context]) -> None:
    context = make_context(ros=OnePublisher())
    route = opened(context, FakePeer(), "/cmd")
    aged(route)
    for second in range(3):
        route.deliver([(b"old", context.stamps.now() - SECOND, 0)] * 10)
        route.age.tick(10 * second + 10, float(second))
    late = route.age.late()
    assert late is not None
    assert late.cause is Cause.LINK_SLOW
