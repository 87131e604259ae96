"""The calls of an action that a pause, arming and limits hold up, for anything that the other side sends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.route.calls.held_helpers import GOAL, Dock, providing
from tests.support.goals import cancel_request, goal, goal_request
from tests.support.inside import refusal_of
from tests.support.offline import half_of

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, Refused
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_thread import RosTurns
from rsb_bridge.route.calls.action_goals import CallerGoals
from rsb_bridge.route.calls.asked_calls import CallerCall
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.goals import accepted_by
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.gates import why_not_by_hand
from rsb_bridge.route.lease import BEAT, LASTS, LeaseHalf
from rsb_bridge.wire.headers import CallFrame, What
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

UNREADABLE = b"\0\x0b" + GOAL[2:]
"""In an encoding that no goal's id is read of."""


@pytest.mark.parametrize(("how", "why"), [("paused", Refused.PAUSED), ("arm", Refused.DISARMED)])
@pytest.mark.parametrize(
    ("lane", "content", "held"),
    [
        (SEND_GOAL, GOAL, True),
        (SEND_GOAL, UNREADABLE, True),
        (CANCEL_GOAL, cancel_request(goal(1)), False),
        (CANCEL_GOAL, UNREADABLE, False),
        (GET_RESULT, GOAL, False),
    ],
)
def test_only_what_could_begin_goal_is_held_up(
    lane: int, content: bytes, held: bool, how: str, why: Refused, make_context: Callable[..., Context]
) -> None:
    half = providing(make_context(), **{how: True})
    refusal = refusal_of(half, CallFrame(What.CALL, lane, 1, 0, content))
    assert refusal is (why if held else Refused.PROVIDER_GONE)


@pytest.mark.parametrize(("lane", "limited"), [(SEND_GOAL, True), (GET_RESULT, False)])
def test_question_about_goal_is_within_no_limit(lane: int, limited: bool, make_context: Callable[..., Context]) -> None:
    half = providing(make_context())
    half.route.limit.allow_here(1.0)
    half.under_way.entries = (LaneEntry("a/action/B_SendGoal", "h", 1),)
    refusals = {refusal_of(half, CallFrame(What.CALL, lane, n, 0, goal_request(goal(n)))) for n in range(1, 50)}
    assert refusals == ({None, Refused.TOO_FAST} if limited else {None})


@pytest.mark.parametrize("paused", [False, True])
def test_unarmed_goal_is_never_sent_by_hand(
    paused: bool, make_context: Callable[..., Context], loop: VirtualLoop
) -> None:
    dock = Dock()
    half = providing(make_context(dock), paused=paused, arm=True)
    with pytest.raises(CallError):
        loop.run_until_complete(half.call_by_hand(SEND_GOAL, GOAL))
    assert not dock.clients


@pytest.mark.parametrize(("why", "rejected"), [(Refused.TOO_FAST, True), (Refused.PAUSED, True), (Refused.LOST, False)])
def test_goal_that_may_have_begun_is_not_rejected(
    why: Refused, rejected: bool, make_context: Callable[..., Context]
) -> None:
    half, server = half_of(Caller, make_context(), Topic("/dock", "receive", kind="action"), here=False), Answers()
    assert isinstance(half.kind, CallerGoals)
    half.kind.goals.asked(goal(1))
    half.under_way.pending.begin(CallerCall(SEND_GOAL, len(GOAL), 0.0, server, b"caller", GOAL), None)
    half.deliver([(CallFrame(What.REFUSED, SEND_GOAL, 1, 0, why.encode()).pack(), 0, 0)])
    assert server.answered == ([b"caller"] if rejected else [])
    assert [each.state for each in half.kind.goals.snapshot(half.kind.awaited())] == [
        "rejected" if rejected else "unknown"
    ]


def test_old_goal_is_refused_whatever_delayed_it(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    context = make_context()
    half = providing(context, arm=True)
    route = half.route
    lease = route.arming.lease = LeaseHalf(context.clock.steady, RosTurns(), lambda: None)
    lease.begin()

    def refusal(number: int) -> Refused | None:
        return refusal_of(half, CallFrame(What.CALL, SEND_GOAL, 1, 0, GOAL, number))

    before, _ = lease.beat()
    lease.hear(1, 0)
    lease.beat()
    route.arming.arm_for_peer("anna", context.now())
    number, _ = lease.beat()
    lease.hear(2, number)
    route.arming.lives()
    assert refusal(number) is Refused.PROVIDER_GONE, "it may pass"
    assert [refusal(each) for each in (0, before, number + 1)] == [Refused.DISARMED] * 3
    for _ in range(5):
        loop.jump(BEAT)
        newest, _ = lease.beat()
        lease.hear(newest, newest)
    assert (refusal(newest), refusal(number)) == (Refused.PROVIDER_GONE, Refused.DISARMED)


def test_silent_link_does_not_say_disarmed(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """The caller got the advice to arm an armed action."""
    context = make_context()
    half = providing(context, arm=True)
    route = half.route
    lease = route.arming.lease = LeaseHalf(context.clock.steady, RosTurns(), lambda: None)
    lease.begin()
    assert why_not_by_hand(route, context.now()) is Refused.DISARMED
    route.arming.arm_for_peer("anna", context.now())
    for newest in range(1, 3):  # the second shows that the other side knows that it is heard
        lease.hear(newest, lease.beat()[0])
    assert why_not_by_hand(route, context.now()) is Refused.DISARMED
    route.arming.lives()
    assert why_not_by_hand(route, context.now()) is None
    while loop.time() <= LASTS + BEAT:
        loop.jump(BEAT)
        lease.beat()  # nobody answers
    assert route.arming.crossing(context.now()) is Crossing.UNHEARD
    assert why_not_by_hand(route, context.now()) is Refused.UNHEARD
    assert refusal_of(half, CallFrame(What.CALL, CANCEL_GOAL, 1, 0, UNREADABLE)) is Refused.PROVIDER_GONE
    with pytest.raises(CallError, match=REMEDIES[Refused.UNHEARD]):
        loop.run_until_complete(half.call_by_hand(SEND_GOAL, GOAL))


class Answers:
    """A server of send_goal, for what it answers."""

    def __init__(self) -> None:
        self.answered: list[bytes] = []

    def answer(self, caller: bytes, payload: bytes) -> None:
        assert accepted_by(payload) is False
        self.answered.append(caller)

    def close(self) -> None:
        pass
