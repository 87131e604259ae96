"""Results of an action's goals that may be asked for again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support import constants
from tests.support.goals import goal, result_response

from rsb_bridge.route.calls.kept_calls import INTERRUPTION, KeptResults

if TYPE_CHECKING:
    import pytest

SERVERS = frozenset([b"server"])
NEW_SERVERS = frozenset([b"new server"])
RESULT = result_response("succeeded", b"a result")


def test_result_waits_for_its_question() -> None:
    """The link went after call 1 had made this side ask."""
    results = KeptResults()
    results.asked(goal(1), 7, SERVERS, 1)
    results.is_over(1)
    assert results.under_way
    assert results.answered(7, RESULT, 110.0) == (goal(1), [])
    results.expire(110.0 + INTERRUPTION - 1)
    assert results.answer(goal(1)) == RESULT
    assert not results.under_way
    results.expire(110.0 + INTERRUPTION)
    assert goal(1) not in results


def test_a_result_is_the_same_for_everybody() -> None:
    results = KeptResults()
    results.asked(goal(1), 7, SERVERS, 1)
    results.wait(goal(1), 2)
    results.wait(goal(1), 3)
    results.is_over(2)
    assert results.awaited() == {goal(1): [1, 3]}
    assert results.answered(7, RESULT, 0.0) == (goal(1), [1, 3])
    assert results.answered(7, RESULT, 0.0) is None


def test_goal_unknown_to_server_is_told_not_kept() -> None:
    results = KeptResults()
    results.asked(goal(1), 7, SERVERS, 1)
    assert results.answered(7, result_response("unknown"), 0.0) == (goal(1), [1])
    assert goal(1) not in results


def test_new_server_is_asked_once_old_ones_left() -> None:
    results = KeptResults()
    results.asked(goal(1), 7, SERVERS, 1)
    assert results.to_ask(SERVERS | NEW_SERVERS) == []
    assert results.to_ask(NEW_SERVERS) == [goal(1)]
    results.asked(goal(1), 8, NEW_SERVERS)
    assert results.to_ask(NEW_SERVERS) == []
    assert results.answered(7, RESULT, 0.0) is None
    assert results.answered(8, RESULT, 0.0) == (goal(1), [1])


def test_a_client_that_was_closed_has_no_answers() -> None:
    results = KeptResults()
    results.asked(goal(1), 7, SERVERS, 1)
    results.asked(goal(2), 8, SERVERS)
    results.answered(8, RESULT, 0.0)
    results.clients_closed()
    assert results.to_ask(SERVERS) == [goal(1)]
    assert results.answered(7, RESULT, 0.0) is None
    assert results.answer(goal(2)) == RESULT


def test_those_with_answers_are_forgotten_first(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.RESULTS_KEPT.set(monkeypatch, 3)
    results = KeptResults()
    for number in range(1, 4):
        results.asked(goal(number), number, SERVERS)
    results.answered(2, RESULT, 0.0)
    results.asked(goal(4), 4, SERVERS)
    assert [goal(number) in results for number in range(1, 5)] == [True, False, True, True]
    results.asked(goal(5), 5, SERVERS)
    assert [goal(number) in results for number in range(1, 6)] == [False, False, True, True, True]


def test_what_calls_wait_for_is_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a result would not reach who waits for it, though nothing was interrupted."""
    constants.RESULTS_KEPT.set(monkeypatch, 3)
    results = KeptResults()
    for number in range(1, 11):
        results.asked(goal(number), number, SERVERS, number)
    for number in range(1, 11):
        assert results.answered(number, RESULT, 0.0) == (goal(number), [number])
    results.asked(goal(11), 11, SERVERS)
    assert sum(goal(number) in results for number in range(1, 12)) <= 10


def test_their_bytes_are_bounded() -> None:
    half = RESULT.ljust(8 << 20, b"\0")
    results = KeptResults()
    for number in range(1, 4):
        results.asked(goal(number), number, SERVERS)
        results.answered(number, half, 0.0)
    assert [goal(number) in results for number in range(1, 4)] == [False, True, True]
    results.asked(goal(4), 4, SERVERS, 1)
    assert results.answered(4, 3 * half, 0.0) == (goal(4), [1])
    assert goal(4) not in results
    assert goal(3) in results
