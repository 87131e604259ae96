"""Reads fields of an action's serialized messages."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.goals import (
    STATES,
    goal,
    goal_request,
    goal_response,
    result_response,
    statuses,
)

from rsb_bridge.route.calls import goals

ORDERS = pytest.mark.parametrize("order", "<>")
READERS = (
    goals.goal_of,
    goals.accepted_by,
    goals.state_of,
    goals.statuses_of,
)
IDS = st.binary(min_size=16, max_size=16)


@ORDERS
def test_the_goal_of_a_request(order: str) -> None:
    assert goals.goal_of(goal_request(goal(7), order, b"fields of the goal")) == goal(7)
    assert goals.goal_of(goal_request(goal(7), order)[:-1]) is None


@ORDERS
def test_answers(order: str) -> None:
    assert goals.accepted_by(goal_response(True, order)) is True
    assert goals.accepted_by(goal_response(False, order)) is False
    for state in STATES:
        assert goals.state_of(result_response(state, b"a result", order)) == state
    assert goals.state_of(result_response("unknown", order=order)[:4] + b"\7") is None


@ORDERS
@given(known=st.dictionaries(IDS, st.sampled_from(sorted(STATES)), max_size=5))
def test_statuses(order: str, known: dict[bytes, str]) -> None:
    message = statuses(*known.items(), order=order)
    found = list(known.items())
    assert goals.statuses_of(message) == found
    padded = message + bytes(3)  # DDS pads payloads between processes
    assert goals.statuses_of(padded) == found
    if known:
        assert goals.statuses_of(message[:-1]) is None


def test_a_state_of_a_later_ros_is_unknown() -> None:
    message = bytearray(statuses((goal(1), "aborted")))
    message[-1] = 99
    assert goals.statuses_of(bytes(message)) == [(goal(1), "unknown")]


def test_a_count_is_not_believed() -> None:
    message = statuses((goal(1), "aborted"))
    assert goals.statuses_of(message[:4] + b"\xff\xff\xff\xff" + message[8:]) is None


@given(st.binary(max_size=64))
def test_whatever_comes_is_read_or_not(payload: bytes) -> None:
    for read in READERS:
        read(payload)
        if payload[:2] not in (b"\0\0", b"\0\1"):
            assert read(payload) is None


def test_as_rclpy_writes_them() -> None:
    pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")
    from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
    from rclpy.serialization import serialize_message
    from test_msgs.action import Fibonacci
    from unique_identifier_msgs.msg import UUID

    goal_id = UUID(uuid=list(goal(7)))
    info = GoalInfo(goal_id=goal_id)
    info.stamp.sec, info.stamp.nanosec = -1, 4_000_000_000
    impl = Fibonacci.Impl
    for message in (
        impl.SendGoalService.Request(goal_id=goal_id),
        impl.GetResultService.Request(goal_id=goal_id),
        impl.FeedbackMessage(goal_id=goal_id),
    ):
        assert goals.goal_of(serialize_message(message)) == goal(7)
    assert goals.accepted_by(serialize_message(impl.SendGoalService.Response(accepted=True))) is True
    assert goals.state_of(serialize_message(impl.GetResultService.Response(status=4))) == "succeeded"
    array = GoalStatusArray(status_list=[GoalStatus(goal_info=info, status=each) for each in (2, 6)])
    found = [(goal(7), state) for state in ("executing", "aborted")]
    assert goals.statuses_of(serialize_message(array)) == found
