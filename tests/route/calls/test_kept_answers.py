"""Answers of an action's server that may be asked for again."""

from __future__ import annotations

import pytest
from tests.support import constants
from tests.support.goals import cancel_request, cancel_response, goal, goal_request, goal_response, result_response

from rsb_bridge.model.calls import CANCEL_GOAL, FEEDBACK, GET_RESULT, SEND_GOAL, Refused
from rsb_bridge.route.calls.kept_calls import (
    INTERRUPTION,
    SENT_KEPT,
    AnswerAction,
    CallIdentity,
    KeptAnswers,
    question_of,
    result_request,
)

SERVERS = frozenset([b"server"])
NEW_SERVERS = frozenset([b"new server"])
RESULT = result_response("succeeded", b"a result")


def asks(lane: int, number: int = 1) -> CallIdentity:
    payload = cancel_request(goal(number)) if lane == CANCEL_GOAL else goal_request(goal(number))
    question = question_of(lane, payload)
    assert question is not None
    return question


def interrupted_after_asking(question: CallIdentity) -> KeptAnswers:
    """Call 1 made this side ask, under number 7; the link went at 100 s."""
    answers = KeptAnswers()
    assert answers.decide(question, 1, again=False) is AnswerAction.ASK
    answers.asked(question, 7, SERVERS, 1)
    answers.is_over(1, 100.0)
    answers.interrupted(100.0)
    return answers


def test_what_questions_are_about() -> None:
    assert question_of(GET_RESULT, result_request(goal(1))) == asks(GET_RESULT)
    assert asks(CANCEL_GOAL) != question_of(CANCEL_GOAL, cancel_request(goal(1), seconds=5))
    assert asks(CANCEL_GOAL) != asks(CANCEL_GOAL, 2)
    for lane in (SEND_GOAL, CANCEL_GOAL, GET_RESULT):
        assert question_of(lane, b"malformed") is None
    assert question_of(FEEDBACK, goal_request(goal(1))) is None


@pytest.mark.parametrize(
    ("lane", "answer"),
    [
        (SEND_GOAL, goal_response(True)),
        (CANCEL_GOAL, cancel_response(goal(1))),
        (GET_RESULT, RESULT),
    ],
)
def test_answer_during_outage_waits_for_question(lane: int, answer: bytes) -> None:
    answers = interrupted_after_asking(asks(lane))
    assert answers.under_way
    assert answers.answered(lane, 7, answer, 110.0, linked=False) == (asks(lane), [])
    answers.expire(110.0 + INTERRUPTION - 1)
    assert answers.decide(asks(lane), 1, again=True) == answer
    assert not answers.under_way


def test_sent_answer_is_kept_until_surely_arrived() -> None:
    answers = KeptAnswers()
    answers.asked(asks(GET_RESULT), 7, SERVERS, 1)
    assert answers.answered(GET_RESULT, 7, RESULT, 10.0, linked=True) == (asks(GET_RESULT), [1])
    answers.expire(10.0 + SENT_KEPT - 1)
    answers.interrupted(10.0 + SENT_KEPT - 1)
    answers.expire(10.0 + INTERRUPTION)
    assert answers.decide(asks(GET_RESULT), 1, again=True) == RESULT
    answers.expire(10.0 + INTERRUPTION + 2 * SENT_KEPT)
    assert answers.decide(asks(GET_RESULT), 2, again=True) is AnswerAction.ASK


def test_a_result_is_the_same_for_everybody() -> None:
    answers = KeptAnswers()
    answers.asked(asks(GET_RESULT), 7, SERVERS, 1)
    assert answers.decide(asks(GET_RESULT), 2, again=False) is AnswerAction.WAIT
    assert answers.answered(GET_RESULT, 7, RESULT, 0.0, linked=True) == (asks(GET_RESULT), [1, 2])
    assert answers.decide(asks(GET_RESULT), 3, again=False) == RESULT


@pytest.mark.parametrize("lane", [SEND_GOAL, CANCEL_GOAL])
def test_new_call_goes_to_server_despite_kept_answer(lane: int) -> None:
    answers = interrupted_after_asking(asks(lane))
    answers.answered(lane, 7, goal_response(False), 101.0, linked=False)
    assert answers.decide(asks(lane), 1, again=False) is AnswerAction.ASK


def test_second_goal_of_id_hides_no_result() -> None:
    answers = KeptAnswers()
    answers.asked(asks(SEND_GOAL), 7, SERVERS)
    answers.answered(SEND_GOAL, 7, goal_response(True), 0.0, linked=True)
    answers.asked(asks(SEND_GOAL), 8, SERVERS)
    assert answers.answered(SEND_GOAL, 8, goal_response(False), 0.0, linked=True) is None
    answers.interrupted(0.0)
    assert answers.decide(asks(SEND_GOAL), 1, again=True) == goal_response(True)


def test_goal_unknown_to_server_is_told_not_kept() -> None:
    answers = KeptAnswers()
    answers.asked(asks(GET_RESULT), 7, SERVERS, 1)
    assert answers.answered(GET_RESULT, 7, result_response("unknown"), 0.0, linked=True) == (asks(GET_RESULT), [1])
    assert answers.decide(asks(GET_RESULT), 2, again=True) is AnswerAction.ASK


def test_new_server_is_asked_once_old_ones_left() -> None:
    answers = KeptAnswers()
    answers.asked(asks(GET_RESULT), 7, SERVERS, 1)
    assert answers.to_ask(SERVERS | NEW_SERVERS) == []
    assert answers.to_ask(NEW_SERVERS) == [asks(GET_RESULT)]
    answers.asked(asks(GET_RESULT), 8, NEW_SERVERS)
    assert answers.to_ask(NEW_SERVERS) == []
    assert answers.answered(GET_RESULT, 7, RESULT, 0.0, linked=True) is None
    assert answers.answered(GET_RESULT, 8, RESULT, 0.0, linked=True) == (asks(GET_RESULT), [1])


def test_a_client_that_was_closed_has_no_answers() -> None:
    """Requests for results are repeated. The outcome of goals is unknown, and the other side repeats cancels."""
    answers = KeptAnswers()
    for lane in (SEND_GOAL, CANCEL_GOAL, GET_RESULT):
        answers.asked(asks(lane), 7, SERVERS)
    answers.answered(SEND_GOAL, 7, goal_response(True), 0.0, linked=True)
    answers.asked(asks(SEND_GOAL, 2), 8, SERVERS)
    answers.clients_closed()
    assert answers.to_ask(SERVERS) == [asks(GET_RESULT)]
    assert answers.decide(asks(SEND_GOAL), 1, again=True) == goal_response(True)
    assert answers.decide(asks(SEND_GOAL, 2), 1, again=True) is Refused.LOST, "it may have come to the server"
    assert asks(CANCEL_GOAL) not in answers


def test_those_with_answers_are_forgotten_first(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.ANSWERS_KEPT.set(monkeypatch, 3)
    answers = KeptAnswers()
    for number in range(1, 4):
        answers.asked(asks(GET_RESULT, number), number, SERVERS)
    answers.answered(GET_RESULT, 2, RESULT, 0.0, linked=True)
    answers.asked(asks(GET_RESULT, 4), 4, SERVERS)
    assert [asks(GET_RESULT, number) in answers for number in range(1, 5)] == [True, False, True, True]
    answers.asked(asks(GET_RESULT, 5), 5, SERVERS)
    assert [asks(GET_RESULT, number) in answers for number in range(1, 6)] == [False, False, True, True, True]
    assert answers.decide(asks(SEND_GOAL), 1, again=True) is Refused.LOST, "it may have been one of those forgotten"
    answers.expire(INTERRUPTION + 2 * SENT_KEPT + 1)
    assert answers.decide(asks(SEND_GOAL), 1, again=True) is Refused.NOT_ARRIVED, "it is too new for that"


def test_what_calls_wait_for_is_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a result would not reach who waits for it, though nothing was interrupted."""
    constants.ANSWERS_KEPT.set(monkeypatch, 3)
    answers = KeptAnswers()
    for number in range(1, 11):
        answers.asked(asks(GET_RESULT, number), number, SERVERS, number)
    for number in range(1, 11):
        assert answers.answered(GET_RESULT, number, RESULT, 0.0, linked=True) == (asks(GET_RESULT, number), [number])
        answers.asked(asks(SEND_GOAL, number), number, SERVERS)
    assert sum(asks(GET_RESULT, number) in answers for number in range(1, 11)) < 3


def test_their_bytes_are_bounded() -> None:
    half = RESULT.ljust(8 << 20, b"\0")
    answers = KeptAnswers()
    for number in range(1, 4):
        answers.asked(asks(GET_RESULT, number), number, SERVERS)
        answers.answered(GET_RESULT, number, half, 0.0, linked=True)
    assert [asks(GET_RESULT, number) in answers for number in range(1, 4)] == [False, True, True]
    answers.asked(asks(GET_RESULT, 4), 4, SERVERS, 1)
    assert answers.answered(GET_RESULT, 4, 3 * half, 0.0, linked=True) == (asks(GET_RESULT, 4), [1])
    assert asks(GET_RESULT, 4) not in answers
    assert asks(GET_RESULT, 3) in answers
