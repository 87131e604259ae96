"""Ages as the two halves of a route measure them, and the verdict on messages that expire."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.route.loop_filter_helpers import FIRST, world
from tests.route.missed_while_down_helpers import reopen
from tests.support.offline import FakePeer
from tests.support.virtual_time import set_clock

from rsb_bridge.model.motion import LATEST, SLOWEST
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RawMessage, Request
from rsb_bridge.route.age import MessageAge

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.route.loop_filter_helpers import World
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["world"]
S = 1_000_000_000


def age_of(
    context: Context, max_age: float | None = 0.5, lifespan: float = 0.0, *, moves: bool = False
) -> tuple[MessageAge, FakePeer]:
    peer = FakePeer()
    age = MessageAge(context, peer)
    age.settle((max_age,), armed=False, lifespan=lifespan, moves=moves)
    return age, peer


def test_nothing_is_limited_unless_somebody_asks(make_context: Callable[..., Context]) -> None:
    age, _ = age_of(make_context(), None)
    assert not age.is_on
    assert age.why_old(0) is None or not age.is_on


def test_old_messages_are_left_out_when_taken(make_context: Callable[..., Context]) -> None:
    context = make_context()
    age, _ = age_of(context)
    wall = context.wall_ns()
    batch = [RawMessage(b"", wall, b"a", source=wall - round(old * S)) for old in (3.0, 0.6, 0.4, 0.0)]
    young = age.fresh(age.stamped(batch))
    assert [each.stamp for each in young] == pytest.approx([wall - round(0.4 * S), wall], abs=10**6)
    assert age.total == 2


@pytest.mark.parametrize(
    ("offset", "uncertainty", "old", "expected"),
    [
        (0.0, 0.001, 0.4, None),
        (0.0, 0.001, 0.6, Cause.LINK_SLOW),
        (0.0, 0.2, 0.4, Cause.LINK_SLOW),  # the uncertainty counts against it
        (0.0, 0.4, 0.3, Cause.CLOCK_UNKNOWN),
        (100.0, 0.001, 0.4, None),  # the peer's clock is ahead
        (-100.0, 0.001, 0.6, Cause.LINK_SLOW),
        (None, None, 0.0, Cause.CLOCK_UNKNOWN),
        (0.0, 0.001, -1.0, Cause.CLOCK_UNKNOWN),  # from the future: the measured offset of the clocks is wrong
    ],
)
def test_the_receiver_counts_the_uncertainty_against_the_message(
    make_context: Callable[..., Context], offset: float | None, uncertainty: float | None, old: float, expected: str
) -> None:
    context = make_context()
    age, peer = age_of(context)
    peer.stamps.offset, peer.stamps.uncertainty = offset, uncertainty
    assert age.why_old(context.stamps.now() + round(((offset or 0.0) - old) * S)) == expected


@pytest.mark.parametrize(
    ("offset", "uncertainty", "old", "expected"),
    [
        (0.0, 0.001, 1.4, None),
        (0.0, 0.001, 1.6, Cause.LINK_SLOW),
        (0.0, 0.3, 1.6, None),  # it may be younger
        (None, None, 9.0, None),
    ],
)
def test_a_lifespan_drops_what_is_surely_older(
    make_context: Callable[..., Context], offset: float | None, uncertainty: float | None, old: float, expected: str
) -> None:
    context = make_context()
    age, peer = age_of(context, None, lifespan=1.5)
    peer.stamps.offset, peer.stamps.uncertainty = offset, uncertainty
    assert age.why_old(context.stamps.now() - round(old * S)) == expected


@pytest.mark.parametrize(
    ("offset", "uncertainty", "old", "expected"),
    [
        (0.0, 0.001, LATEST - 0.1, None),
        (0.0, 0.001, LATEST + 0.1, Cause.LINK_SLOW),
        (0.0, 0.2, LATEST + 0.1, None),  # it may be younger, or the link takes as long
        (0.0, 0.2, LATEST + 0.3, Cause.LINK_SLOW),
        (0.0, 1.5, LATEST + SLOWEST - 0.1, None),
        (0.0, 1.5, LATEST + SLOWEST + 0.1, Cause.LINK_SLOW),
        (None, None, 9.0, None),  # nothing is known yet, and nothing has waited
        (0.0, 0.001, -1.0, None),  # from the future
    ],
)
def test_command_is_dropped_if_surely_late(
    make_context: Callable[..., Context],
    offset: float | None,
    uncertainty: float | None,
    old: float,
    expected: str,
) -> None:
    context = make_context()
    age, peer = age_of(context, None, moves=True)
    peer.stamps.offset, peer.stamps.uncertainty = offset, uncertainty
    assert age.why_old(context.stamps.now() - round(old * S)) == expected


@pytest.mark.parametrize("before", [1, 5, 60])
@pytest.mark.parametrize("held", [0.6, 3.0])
def test_network_that_holds_for_a_minute_is_not_usually_slow(
    make_context: Callable[..., Context], held: float, before: int
) -> None:
    """Each command is as late as the pings that tell the delay."""
    context = make_context()
    age, peer = age_of(context, None, moves=True)
    now = context.stamps.now()
    for delay in [0.01] * before + [held] * 60:
        now += S
        back = now + round(delay * S)
        peer.stamps.add(now, back, back, back + round(delay * S))
        expected = Cause.LINK_SLOW if delay == held else None
        assert age.why_old(context.stamps.now() - round(delay * S)) == expected


@pytest.mark.parametrize(
    ("max_age", "armed", "moves", "only_newest", "oldest"),
    [
        (None, False, False, False, None),
        (None, False, True, True, LATEST),
        (None, True, True, True, LATEST),
        (2.0, False, True, True, 2.0),
        (0.0, False, True, False, None),
        (0.0, True, True, False, None),
    ],
)
def test_session_decides_how_late_command_may_be(
    make_context: Callable[..., Context],
    max_age: float | None,
    armed: bool,
    moves: bool,
    only_newest: bool,
    oldest: float | None,
) -> None:
    context = make_context()
    age, _ = age_of(context, None)
    age.settle((max_age, None), armed=armed, moves=moves)
    assert (age.only_newest, age.is_on) == (only_newest, oldest is not None)
    now, limit = context.stamps.now(), oldest or 60.0
    assert age.is_young(now - round((limit - 0.1) * S))
    assert age.is_young(now - round((limit + 0.1) * S)) == (oldest is None)


def test_unsure_clock_drops_no_fresh_command(make_context: Callable[..., Context]) -> None:
    """For some seconds after this machine's clock was set, stamps tell nothing."""
    context = make_context()
    age, _ = age_of(context, None, moves=True)
    set_clock(context.clock, -3600.0)
    batch = [RawMessage(b"", context.wall_ns(), b"a", source=context.wall_ns() - 3 * S)]
    assert len(age.fresh(age.stamped(batch))) == 1
    assert age.is_young(age.stamped(batch)[0].stamp)


def test_many_expired_messages_make_a_topic_late(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    age, _ = age_of(make_context())
    for second in range(20):
        age.update(100 * second, float(second))
        assert age.late() is None
    age.expired(Cause.LINK_SLOW, 30)
    age.update(2000, 20.0)
    assert age.late() is None  # 30 of 1,000
    age.expired(Cause.CLOCK_UNKNOWN, 40)
    age.update(2100, 21.0)
    late = age.late()
    assert late is not None
    assert (late.cause, late.lost, late.of, late.since) == (Cause.CLOCK_UNKNOWN, 70, 1000, 21.0)
    for second in range(22, 33):
        age.update(100 * second, float(second))
    assert age.late() is None


@pytest.mark.parametrize("world", [{"max_age": 0.5}], indirect=True)
def test_lagging_clock_is_known_after_own_was_set(world: World) -> None:
    def passes() -> bool:
        world.wait(1.0)
        before, now = len(world.sent), world.context.wall_ns()
        world.path.offer([RawMessage(b"x", now, FIRST, source=now - 3 * S)])
        world.sender.route.tick()
        return len(world.sent) > before

    assert passes()
    set_clock(world.context.clock, 0.06)
    for _ in range(30):
        assert not passes()
        if not world.sender.route.id:
            break
    reopen(world)
    assert passes()
    assert passes()


@pytest.mark.parametrize("world", [{"max_age": 0.5, "expected_rate": 20.0}], indirect=True)
def test_publisher_has_not_stopped_while_clock_is_unsure(world: World) -> None:
    """It publishes all the time; its messages are dropped for 10 s, as nobody knows how old they are."""

    def publish(seconds: int) -> set[tuple[State, str]]:
        shown = set()
        for _ in range(seconds):
            for _ in range(20):
                now = world.context.wall_ns()
                world.path.offer([RawMessage(b"x", now, FIRST, source=now)])
                world.wait(0.05)
            world.sender.route.tick()
            verdict = world.sender.route.verdict()
            shown.add((verdict.state, verdict.cause))
        return shown

    publish(20)
    set_clock(world.context.clock, 3600.0)
    shown = publish(9)
    assert (State.LATE, Cause.CLOCK_UNKNOWN) in shown
    assert {State.STOPPED, State.STALE}.isdisjoint(state for state, _ in shown)


def test_request_before_setting_clock_tells_nothing(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    context = make_context()
    age, _ = age_of(context)
    before = context.wall_ns()
    set_clock(context.clock, -3600.0)
    assert age.aged(Request(b"", b"caller", context.wall_ns(), source=before)).stamp == 0
    loop.run_until_complete(asyncio.sleep(11.0))
    assert age.aged(Request(b"", b"caller", context.wall_ns(), source=context.wall_ns())).stamp > 0


def test_no_stamp_is_negative(make_context: Callable[..., Context]) -> None:
    """A frame has no room for it."""
    context = make_context()
    age, _ = age_of(context, None, lifespan=1.0)
    taken = 100 * S
    set_clock(context.clock, 2 * context.stamps.now() / S)
    (found,) = age.stamped([RawMessage(b"", taken)])
    assert found.stamp == 0
