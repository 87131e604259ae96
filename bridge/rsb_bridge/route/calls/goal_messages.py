"""What a bridge reads of an action's serialized messages: goal ids and states. It reads nothing of a goal's own fields.

Each of these messages begins with fields that are the same for every action (action_msgs, unique_identifier_msgs, and
the ROS 2 design article on actions), so that the action's type need not be known. Whatever cannot be read is None; it
crosses all the same.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

HEADER_LENGTH = 4
"""Bytes of the encapsulation header (DDSI-RTPS 2.5, section 10.2)."""
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # CDR_BE, CDR_LE
_ID_END = HEADER_LENGTH + 16
_CANCEL_END = _ID_END + 8
_ALL = bytes(16)
_RESPONSE_LENGTH = 12  # of send_goal: a bool, and a stamp aligned to four
_COUNT_END = HEADER_LENGTH + 4
_FIRST_STATUS, _NEXT_STATUS = struct.Struct("16s8xB"), struct.Struct("16s3x8xB")  # goal id, stamp, state
_MOST_STATUSES = 10_000

STATES = ("unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted")
"""By their numbers in action_msgs/msg/GoalStatus."""


class GoalStatus(NamedTuple):
    """One goal of a status message."""

    goal: bytes
    state: str


class Cancel(NamedTuple):
    """Which goals a cancel request is about.

    Attributes:
        goal: the goal's id, if it is about that goal alone; None: it is about all goals, or all up to some time.
        request: tells one request from another.
    """

    goal: bytes | None
    request: bytes


def goal_of(payload: bytes) -> bytes | None:
    """The goal id of a send_goal or get_result request, or of a feedback message."""
    if payload[:2] not in _ORDERS or len(payload) < _ID_END:
        return None
    return payload[HEADER_LENGTH:_ID_END]


def cancel_of(payload: bytes) -> Cancel | None:
    """What a cancel_goal request is about (action_msgs/srv/CancelGoal)."""
    goal = goal_of(payload)
    if goal is None or len(payload) < _CANCEL_END:
        return None
    request = payload[HEADER_LENGTH:_CANCEL_END]
    alone = goal != _ALL and request[16:] == bytes(8)
    return Cancel(goal if alone else None, request)


def accepted_by(payload: bytes) -> bool | None:
    """Whether a send_goal response accepts the goal."""
    if payload[:2] not in _ORDERS or len(payload) <= HEADER_LENGTH:
        return None
    return payload[HEADER_LENGTH] != 0


def rejection_of(request: bytes) -> bytes:
    """A send_goal response which says that the goal was not accepted."""
    return request[:2] + bytes(2 + _RESPONSE_LENGTH)


def state_of(payload: bytes) -> str | None:
    """The goal's last state by a get_result response; ``unknown``: its server does not know the goal, or no longer."""
    if payload[:2] not in _ORDERS or len(payload) <= HEADER_LENGTH:
        return None
    state = payload[HEADER_LENGTH]
    return STATES[state] if state < len(STATES) else None


def statuses_of(payload: bytes) -> list[GoalStatus] | None:
    """The goals of a status message (action_msgs/msg/GoalStatusArray), the first 10,000."""
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < _COUNT_END:
        return None
    (count,) = struct.unpack_from(f"{order}I", payload, HEADER_LENGTH)
    if count == 0:
        return []
    # The id of the second and of later ones follows a state, one byte; the stamp behind it is aligned to four.
    next_begins = _COUNT_END + _FIRST_STATUS.size
    if next_begins + (count - 1) * _NEXT_STATUS.size > len(payload):
        return None
    next_end = next_begins + (min(count, _MOST_STATUSES) - 1) * _NEXT_STATUS.size
    found = [_FIRST_STATUS.unpack_from(payload, _COUNT_END), *_NEXT_STATUS.iter_unpack(payload[next_begins:next_end])]
    return [GoalStatus(goal, STATES[state] if state < len(STATES) else STATES[0]) for goal, state in found]
