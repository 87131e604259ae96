"""What is sent to managed nodes and read from them, beside what ROS itself makes of it."""

from __future__ import annotations

import pytest
from lifecycle_msgs.msg import State, Transition, TransitionDescription
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.serialization import deserialize_message, serialize_message

from rsb_extras.node_control.cdr_fields import FieldReader, FieldWriter, MalformedAnswerError
from rsb_extras.node_control.lifecycle_messages import (
    NO_FIELDS,
    OfferedTransition,
    change_request,
    read_offers,
    read_state,
    read_success,
)
from rsb_extras.node_control.lifecycle_nodes import phases


def test_requests_are_those_of_ros() -> None:
    request = deserialize_message(change_request(OfferedTransition("activate", 3)), ChangeState.Request)
    assert (request.transition.id, request.transition.label) == (3, "activate")
    deserialize_message(NO_FIELDS, GetState.Request)


def test_answers_of_ros_are_read() -> None:
    state = State(id=3, label="active")
    assert read_state(serialize_message(GetState.Response(current_state=state))) == "active"
    told = [
        TransitionDescription(transition=Transition(id=number, label=label), start_state=state, goal_state=state)
        for number, label in ((4, "deactivate"), (7, "shutdown"), (9, "dance"))
    ]
    answer = serialize_message(GetAvailableTransitions.Response(available_transitions=told))
    assert read_offers(answer) == (OfferedTransition("deactivate", 4), OfferedTransition("shutdown", 7))
    for success in (True, False):
        assert read_success(serialize_message(ChangeState.Response(success=success))) is success


@pytest.mark.parametrize("broken", [b"", b"\0\1\0", b"\0\1\0\0", b"\0\7\0\0\3", b"\0\1\0\0" + b"\xff" * 40])
def test_nonsense_is_refused(broken: bytes) -> None:
    for read in (read_state, read_offers):
        with pytest.raises(MalformedAnswerError):
            read(broken)


def test_both_byte_orders_are_read() -> None:
    assert FieldReader(b"\0\0\0\0" + b"\0\0\0\2").number("I") == 2
    assert FieldReader(FieldWriter().number("I", 2).message).number("I") == 2


def test_control_characters_of_a_node_are_cleaned() -> None:
    assert (
        read_state(FieldWriter().number("B", 1).text("\x1b[2Jactive").message) == "\N{REPLACEMENT CHARACTER}[2Jactive"
    )


def test_phases_go_as_navs_manager_does() -> None:
    nodes = ("/a", "/b")
    assert phases("up", nodes) == [("configure", nodes), ("activate", nodes)]
    assert phases("down", nodes) == [("deactivate", nodes[::-1]), ("cleanup", nodes[::-1])]
    assert phases("activate", nodes) == [("activate", nodes)]
    assert phases("shutdown", nodes) == [("shutdown", nodes[::-1])]
