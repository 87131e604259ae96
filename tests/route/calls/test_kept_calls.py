"""Calls of an action that wait for the end of an interruption."""

from __future__ import annotations

import itertools

from tests.support.goals import cancel_request, goal, goal_request

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from rsb_bridge.route.calls.kept_calls import INTERRUPTION, MOST_BYTES, MOST_CALLS, KeptCall, KeptCalls

TIMEOUT = 30.0
_callers = itertools.count()


def call(lane: int, payload: bytes, asked: float = 0.0) -> KeptCall:
    return KeptCall(lane, str(next(_callers)).encode(), payload, asked)


def result_of(number: int) -> KeptCall:
    return call(GET_RESULT, goal_request(goal(number)))


def test_unrepeatable_requests_are_not_kept() -> None:
    kept = KeptCalls(TIMEOUT)
    for lane in (SEND_GOAL, GET_RESULT):
        assert not kept.keep(call(lane, b"malformed"), 0.0)


def test_a_call_is_kept_for_an_hour() -> None:
    kept = KeptCalls(TIMEOUT)
    first, second = result_of(1), call(CANCEL_GOAL, cancel_request(goal(1)))
    kept.keep(first, 0.0)
    kept.keep(second, 10.0)
    assert kept.expire(INTERRUPTION - 1) == []
    assert kept.expire(INTERRUPTION) == [first]
    assert kept.expire(INTERRUPTION + 10) == [second]
    assert len(kept) == 0


def test_cancel_of_all_waits_like_any_call() -> None:
    """Later it would end goals that nobody meant."""
    kept = KeptCalls(TIMEOUT)
    everything, malformed = call(CANCEL_GOAL, cancel_request(), asked=5.0), call(CANCEL_GOAL, b"malformed", asked=5.0)
    assert kept.keep(everything, 10.0)
    assert kept.keep(malformed, 10.0)
    assert kept.expire(34.9) == []
    assert kept.expire(35.0) == [everything, malformed]
    assert not kept.keep(call(CANCEL_GOAL, cancel_request(), asked=5.0), 35.0)


def test_their_number_is_bounded() -> None:
    kept = KeptCalls(TIMEOUT)
    assert all(kept.keep(result_of(number), 0.0) for number in range(MOST_CALLS))
    assert not kept.keep(result_of(MOST_CALLS), 0.0)
    kept.expire(INTERRUPTION)
    assert kept.keep(result_of(0), INTERRUPTION)


def test_their_bytes_are_bounded() -> None:
    kept = KeptCalls(TIMEOUT)
    large = MOST_BYTES // 2 + 1
    assert kept.keep(call(GET_RESULT, goal_request(goal(1), fields=bytes(large))), 0.0)
    assert not kept.keep(call(GET_RESULT, goal_request(goal(2), fields=bytes(large))), 0.0)
    kept.release()
    assert kept.keep(call(GET_RESULT, goal_request(goal(2), fields=bytes(large))), 0.0)


def test_cancels_are_sent_first_and_goals_never() -> None:
    kept = KeptCalls(TIMEOUT)
    sent = call(SEND_GOAL, goal_request(goal(1)), asked=-20.0)
    assert kept.keep(sent, 0.0)
    calls = [result_of(1), call(CANCEL_GOAL, cancel_request(goal(1))), result_of(2), call(CANCEL_GOAL, b"malformed")]
    for each in calls:
        assert kept.keep(each, 0.0)
    assert kept.release() == [calls[1], calls[3], calls[0], calls[2]]
    assert kept.release() == []
    assert kept.expire(29.0) == []
    assert kept.expire(30.0) == [sent]
