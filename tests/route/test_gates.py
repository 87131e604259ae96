"""The gates, each alone; the order of each way's; and that each one is there from the next message on."""

from __future__ import annotations

import asyncio
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, TypeVar, cast

import pytest
from tests.route.gates_helpers import armed, leased
from tests.route.loop_filter_helpers import FIRST, SECOND, World, world
from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.offline import FakePeer, half_of
from tests.support.reports import told_counts
from tests.support.virtual_time import set_clock

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RawMessage, Request
from rsb_bridge.route.age import MessageAge
from rsb_bridge.route.arming import Arming, Disarmed
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.route.gates import (
    NO_SAMPLE,
    CallRateGate,
    GatedMessage,
    age_gate,
    armed_gate,
    armed_gates,
    budget_gate,
    calling_gates,
    chained,
    driver_sieve,
    fresh_sieve,
    incoming_gates,
    kept_age_sieve,
    kept_loop_sieve,
    lease_gate,
    loop_sieve,
    pause_gate,
    providing_gates,
    rate_gate,
    size_gate,
    throttle_sieve,
    young_gate,
    young_sieve,
)
from rsb_bridge.route.history_depth import Sample
from rsb_bridge.route.lease import LASTS
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.peer_budget import CallBudget
from rsb_bridge.route.rate_limit import AllowedRates
from rsb_bridge.route.sending import Outbox
from rsb_bridge.route.topic_flow import SilenceWatch
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import CallFrame, HistoryHeader, What, frame_size, with_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.gates import Gate, Gated, Sieve
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_flow import TopicFlow
    from rsb_bridge.wire.framing import Message

__all__ = ["world"]
A_SECOND = 10**9


def taken(number: int) -> GatedMessage:
    return GatedMessage(0, number)


# --- each alone


def test_armed_gate_asks_operators_and_then_link(make_context: Callable[..., Context]) -> None:
    context, arming = make_context(), Arming()
    arming.demand(required=True, deadman=0.0)
    gate = armed_gate(arming)
    assert gate(NO_SAMPLE, context.now()) is Refused.DISARMED
    leased(arming, context)
    assert gate(NO_SAMPLE, context.now()) is Refused.DISARMED
    arming.arm_for_peer("anna", context.now())
    assert gate(NO_SAMPLE, context.now()) is Refused.DISARMED
    arming.lives()
    assert gate(NO_SAMPLE, context.now()) is None
    context.loop.jump(LASTS * 1.1)  # type: ignore[attr-defined]
    assert gate(NO_SAMPLE, context.now()) is Refused.UNHEARD
    arming.end(Disarmed.OPERATOR)
    assert gate(NO_SAMPLE, context.now()) is Refused.DISARMED


def test_lease_gate_passes_young_of_this_arming(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    context, arming = make_context(), Arming()
    arming.demand(required=True, deadman=0.0)
    gate = lease_gate(arming)
    assert gate(taken(1), 0.0) is Refused.DISARMED
    lease = leased(arming, context)
    arming.arm_for_peer("anna", context.now())
    arming.lives()
    number = lease.number
    found = [gate(taken(each), 0.0) for each in (0, number - 1, number, number + 1)]
    assert found == [Refused.DISARMED, Refused.DISARMED, None, Refused.DISARMED]
    loop.jump(LASTS * 1.1)
    assert gate(taken(number), 0.0) is Refused.DISARMED


def test_the_age_gate_counts_by_cause(make_context: Callable[..., Context]) -> None:
    context = make_context()
    age = MessageAge(context, FakePeer())
    age.settle((0.5,), armed=False)
    gate, now = age_gate(age), context.stamps.now()
    assert gate(GatedMessage(now, 0), 0.0) is None
    assert age.total == 0
    assert gate(GatedMessage(now - A_SECOND, 0), 0.0) is Refused.TOO_OLD
    age.update(1, 1.0)
    age.update(2, 2.0)
    assert age.total == 1


def test_rate_gate_admits_what_this_side_allows() -> None:
    gate = rate_gate(AllowedRates(), "/chat", 10.0)
    found = [gate(NO_SAMPLE, number / 1000) for number in range(10_000)]
    assert set(found) == {None, Refused.TOO_FAST}
    assert found.count(None) <= 10 + 1.01 * 10 * 10


def test_call_gate_admits_second_at_once() -> None:
    gate = CallRateGate(10.0, 0.0).check
    assert [gate(NO_SAMPLE, 0.0) for _ in range(11)] == [None] * 10 + [Refused.TOO_FAST]
    assert [gate(NO_SAMPLE, 0.1) for _ in range(2)] == [None, Refused.TOO_FAST]


def test_age_gate_asks_clock_of_taking_side(make_context: Callable[..., Context]) -> None:
    context = make_context()
    age = MessageAge(context, FakePeer())
    age.settle((0.5,), armed=False)
    gate, now = young_gate(age), context.stamps.now()
    assert gate(GatedMessage(now - A_SECOND // 4, 0), 0.0) is None
    assert gate(GatedMessage(now - A_SECOND, 0), 0.0) is Refused.TOO_OLD


def test_what_passes_budget_has_its_place_in_it() -> None:
    budget = CallBudget(0.0)
    gate = budget_gate(budget)
    assert gate(Request(b"12345", b"", 0), 0.0) is None
    assert gate(CallFrame(What.CALL, 0, 1, 0, b"12345"), 0.0) is None
    assert budget.held == (2, 2 * frame_size(b"12345"))
    full = CallBudget(0.0, share=0.0)
    assert budget_gate(full)(Request(b"", b"", 0), 0.0) is Refused.TOO_FAST


def test_the_size_gate_passes_what_the_transport_carries() -> None:
    gate = size_gate(5)
    assert gate(Request(b"12345", b"", 0), 0.0) is None
    assert gate(Request(b"123456", b"", 0), 0.0) is Refused.TOO_LARGE


def shut(why: Refused | None, asked: list[Refused | None]) -> Gate[Gated]:
    """Return a gate that nothing passes, and that notes what it is asked."""

    def gate(_: Gated, __: float) -> Refused | None:
        asked.append(why)
        return why

    return gate


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_first_reason_counts_and_ends_questions(count: int) -> None:
    asked: list[Refused | None] = []
    gates: tuple[Gate[Gated], ...] = tuple(shut(None, asked) for _ in range(count - 1))
    check = chained((*gates, shut(Refused.TOO_OLD, asked), shut(Refused.PAUSED, asked)))
    assert check is not None
    assert check(NO_SAMPLE, 0.0) is Refused.TOO_OLD
    assert asked == [None] * (count - 1) + [Refused.TOO_OLD]


def test_without_gates_there_is_nothing_to_ask() -> None:
    assert chained(()) is None


# --- each sieve alone


def aged_half_a_second(context: Context) -> MessageAge:
    age = MessageAge(context, FakePeer())
    age.settle((0.5,), armed=False)
    return age


def cause_of(age: MessageAge) -> Cause | None:
    """Return the cause for which an age limit has dropped most."""
    for second in range(3):
        age.update(0, float(second))
    late = age.late()
    return None if late is None else late.cause


def sample_of(stamp: int, gid: bytes = FIRST, *, replayed: bool = False) -> Sample:
    return Sample(HistoryHeader(bytes(8), 1, 1), RawMessage(b"kept", stamp, gid), replayed)


def fresh_of(age: MessageAge, context: Context, ledger: RouteLedger) -> Sieve[RawMessage]:
    route, silence = SimpleNamespace(age=age, context=context), SilenceWatch(lambda *_: None, 0.0)
    return fresh_sieve(cast("TopicFlow", SimpleNamespace(route=route, silence=silence)), ledger)


def test_the_fresh_sieve_asks_the_publishers_stamps(make_context: Callable[..., Context]) -> None:
    context, ledger = make_context(), RouteLedger()
    age, now = aged_half_a_second(context), context.stamps.now()
    old, young = RawMessage(b"old", now - A_SECOND), RawMessage(b"young", now)
    sieve = fresh_of(age, context, ledger)
    assert sieve([old, young]) == [young]
    assert (ledger.offered, ledger.expired, age.total) == (1, 1, 1)


@pytest.mark.parametrize(("max_age", "passed"), [(0.5, 0), (None, 1)])
def test_unsure_clock_lets_nothing_limited_pass(
    max_age: float | None, passed: int, make_context: Callable[..., Context]
) -> None:
    """A lifespan promises less, and drops what is surely older."""
    context, ledger = make_context(), RouteLedger()
    age = MessageAge(context, FakePeer())
    age.settle((max_age,), armed=False, lifespan=0.5)
    set_clock(context.clock, 100.0)
    for second in range(3):
        age.update(second, float(second))
        stamped = age.stamped([RawMessage(b"young", context.wall_ns())] * 10)
        assert len(fresh_of(age, context, ledger)(stamped)) == 10 * passed
    assert (ledger.offered, ledger.expired) == (30 - 30 * passed, 30 - 30 * passed)
    age.update(3, 3.0)
    late = age.late()
    assert (None if late is None else late.cause) is (None if passed else Cause.CLOCK_UNKNOWN)


@pytest.mark.parametrize(("replayed", "cause"), [(True, Cause.PUBLISHER_STAMPS_OLD), (False, Cause.LINK_SLOW)])
def test_message_kept_too_long_names_keeper(replayed: bool, cause: Cause, make_context: Callable[..., Context]) -> None:
    context, ledger = make_context(), RouteLedger()
    age, now = aged_half_a_second(context), context.stamps.now()
    old, young = sample_of(now - A_SECOND, replayed=replayed), sample_of(now, replayed=replayed)
    age.update(0, 0.0)
    assert kept_age_sieve(age, ledger)([old, young]) == [young]
    assert ledger.expired == 1
    assert cause_of(age) is cause


def test_held_messages_are_checked_for_loops_again(world: World) -> None:
    (sieve,) = world.path.gates.kept
    known, unknown = sample_of(1), sample_of(1, SECOND)
    assert sieve([unknown, known]) == [known]
    assert world.ledger.dropped == {"would loop": 1}


def test_age_sieve_asks_clock_of_taking_side(make_context: Callable[..., Context]) -> None:
    context, ledger = make_context(), RouteLedger()
    age, now = aged_half_a_second(context), context.stamps.now()
    messages: list[Message] = [(b"old", now - A_SECOND, 0), (b"young", now, 0)]
    age.update(0, 0.0)
    assert young_sieve(age, ledger)(messages) == messages[1:]
    assert (ledger.offered, ledger.expired) == (0, 1)
    assert cause_of(age) is Cause.LINK_SLOW


# --- the order of each way


def order(gates: tuple[Callable[..., object], ...]) -> list[object]:
    """Return what the gates were made by."""
    return [getattr(sys.modules[each.__module__], each.__qualname__.partition(".")[0]) for each in gates]


def everything_on(route: Route) -> None:
    route.arming.demand(required=True, deadman=0.0)
    route.age.settle((0.5,), armed=True)
    route.limit.allow_here(10.0)


def test_nothing_old_and_nothing_unarmed_gets_to_channel(world: World) -> None:
    """Age is asked once more when the channel has room: a message may have waited in the queue."""
    assert [order(each) for each in world.path.gates] == [[], [loop_sieve], [], [kept_loop_sieve], [Outbox], []]
    everything_on(world.sender.route)
    gates = world.path.gates
    assert order(gates.batch) == [armed_gate]
    assert order(gates.arriving) == [fresh_sieve, loop_sieve, driver_sieve]
    assert order(gates.sourced) == [throttle_sieve]
    assert order(gates.kept) == [kept_age_sieve, kept_loop_sieve]
    assert order(gates.packed) == [Outbox]
    assert order(gates.leaving) == [young_sieve]
    world.sender.flow.qos = Qos(
        durability="transient_local"
    )  # its messages wait in their histories, and are asked later
    world.path.compose()
    assert order(world.path.gates.arriving) == [loop_sieve, driver_sieve]


def test_nothing_old_and_nothing_unarmed_gets_to_ros(make_context: Callable[..., Context]) -> None:
    """Age and lease are asked once more after a long check, right before DDS gets the message."""
    receiver = opened(make_context(ros=OnePublisher()), FakePeer(), "/chat")
    assert all(not each for each in incoming_gates(receiver.route))
    everything_on(receiver.route)
    batch, arriving, leaving = map(order, incoming_gates(receiver.route))
    assert batch == [armed_gate]
    assert arriving == [lease_gate, rate_gate]
    assert leaving == [lease_gate, age_gate]
    assert order(armed_gates(receiver.route)) == [armed_gate]


@pytest.mark.parametrize("max_age", [0.0, 0.5])
def test_what_is_too_old_is_not_new_from_another_node(
    max_age: float, make_context: Callable[..., Context], loop: VirtualLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot would drive to a goal of yesterday: only the sender knows what is young enough to be published again."""
    ros = OnePublisher()
    context = make_context(ros=ros)
    monkeypatch.setattr(ros.mirrors, "node_of", lambda _: "/planner")
    receiver = opened(context, FakePeer(), "/goal", Qos(durability="transient_local", depth=1))
    receiver.route.age.settle((max_age,), armed=False)
    receiver.deliver([(b"drive there", context.stamps.now(), 0)])
    assert ros.published.sizes == [11]
    loop.run_until_complete(asyncio.sleep(60.0))
    receiver.move()
    loop.run_until_complete(asyncio.sleep(1.0))
    assert ros.published.sizes == ([11] if max_age else [11, 11])


def test_calls_pass_them_from_callers_to_the_channel(make_context: Callable[..., Context]) -> None:
    """A call that stops or watches a robot always passes."""
    half = calls(make_context(), Caller)
    fast, slow = CallRateGate(0.0, 0.0), CallRateGate(10.0, 0.0)
    assert order(calling_gates(half.route, 5, fast, limited=True).arriving) == [
        pause_gate,
        size_gate,
        budget_gate,
    ]
    everything_on(half.route)
    arriving, leaving = map(order, calling_gates(half.route, 5, slow, limited=True))
    assert arriving == [pause_gate, armed_gate, young_gate, size_gate, CallRateGate, budget_gate]
    assert leaving == [young_gate]
    arriving, leaving = map(order, calling_gates(half.route, 5, slow, limited=False))
    assert (arriving, leaving) == ([size_gate, budget_gate], [])


def test_calls_pass_them_from_the_channel_to_servers(make_context: Callable[..., Context]) -> None:
    """Age and lease are asked again after the check of contents."""
    half = calls(make_context(), Provider)
    arriving, leaving = map(order, providing_gates(half.route, limited=True))
    assert (arriving, leaving) == ([pause_gate], [budget_gate])
    everything_on(half.route)
    arriving, leaving = map(order, providing_gates(half.route, limited=True))
    assert arriving == [age_gate, pause_gate, armed_gate, lease_gate]
    assert leaving == [age_gate, armed_gate, lease_gate, rate_gate, budget_gate]
    arriving, leaving = map(order, providing_gates(half.route, limited=False))
    assert (arriving, leaving) == ([], [budget_gate])


Calls = TypeVar("Calls", Caller, Provider)


def calls(context: Context, half: type[Calls]) -> Calls:
    return half_of(half, context, Topic("/dock", "transmit", kind="action"), here=False)


# --- each one is on the way as long as it is on


def disarmed(route: Route) -> None:
    route.arming.demand(required=True, deadman=0.0)


def aged(route: Route) -> None:
    route.age.settle((0.5,), armed=False)


def limited(route: Route) -> None:
    route.limit.allow_here(0.001)


def off(route: Route) -> None:
    route.arming.opened(required=False, deadman=0.0)
    route.age.settle((), armed=False)
    route.limit.allow_here(0.0)


@pytest.mark.parametrize(
    ("switch", "cause", "passed"), [(disarmed, "disarmed", 0), (aged, "expired", 0), (limited, "throttled", 2)]
)
def test_gate_counts_from_next_message_while_on(
    switch: Callable[[Route], None],
    cause: str,
    passed: int,
    loop: VirtualLoop,
    make_context: Callable[..., Context],
) -> None:
    ros = OnePublisher()
    context = make_context(ros=ros)
    receiver = opened(context, FakePeer(), "/chat")
    old: Message = (b"old", context.stamps.now() - A_SECOND, 0)

    def published() -> int:
        before = len(ros.published.sizes)
        for _ in range(5):
            loop.jump(0.02)  # late messages are published one by one
            receiver.deliver([old])
        return len(ros.published.sizes) - before

    assert published() == 5
    switch(receiver.route)
    assert published() == passed
    off(receiver.route)
    assert published() == 5
    report = told_counts(receiver)
    assert (report.received, report.delivered) == (15, 10 + passed)
    assert report.dropped == {cause: 5 - passed}


@pytest.mark.parametrize(
    ("switch", "cause", "passed"), [(disarmed, "disarmed", 0), (aged, "expired", 0), (limited, "throttled", 1)]
)
def test_outgoing_gate_counts_from_next_message_while_on(
    switch: Callable[[Route], None], cause: str, passed: int, world: World
) -> None:
    old = RawMessage(b"old", world.context.stamps.now() - A_SECOND, FIRST)

    def sent() -> int:
        before = len(world.sent)
        world.path.offer([old] * 5)
        return len(world.sent) - before

    assert sent() == 5
    switch(world.sender.route)
    assert sent() == passed
    off(world.sender.route)
    assert sent() == 5
    ledger = world.sender.facts.ledger
    assert ledger.offered == 15
    assert {"expired": ledger.expired, "throttled": ledger.throttled, **ledger.dropped}[cause] == 5 - passed


def test_message_of_unknown_arming_is_not_published(
    make_context: Callable[..., Context],
) -> None:
    """Also one that is too short for the lease's number."""
    ros = OnePublisher()
    receiver = opened(make_context(ros=ros), FakePeer(), "/chat")
    receiver.deliver([(with_number(1, b"moves"), 0, LEASED), (b"1", 0, LEASED)])
    armed(receiver.route.arming, receiver.route.context)
    receiver.deliver([(b"moves", 0, 0), (b"1", 0, LEASED)])
    assert not ros.published.sizes
    report = told_counts(receiver)
    assert report.dropped == {"disarmed": 4}


def test_expired_messages_cause_is_their_age(make_context: Callable[..., Context]) -> None:
    context = make_context(ros=OnePublisher())
    receiver = opened(context, FakePeer(), "/chat")
    aged(receiver.route)
    for second in range(3):
        receiver.deliver([(b"old", context.stamps.now() - A_SECOND, 0)] * 10)
        receiver.route.age.update(10 * second + 10, float(second))
    late = receiver.route.age.late()
    assert late is not None
    assert late.cause is Cause.LINK_SLOW
