"""The goals of one action, and the goal ids and states in the action's serialized messages.

Each of these messages begins with fields that are the same for every action (action_msgs, unique_identifier_msgs, and
the ROS 2 design article on actions): a bridge reads them without the action's type, and leaves a goal's own fields
alone. Functions return None for a message that they cannot read; it crosses nevertheless.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.calls import FEEDBACK, GET_RESULT, SEND_GOAL, STATUS, GoalSnapshot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from collections.abc import Set as AbstractSet

HEADER_LENGTH = 4
"""Bytes of the encapsulation header (DDSI-RTPS 2.5, section 10.2)."""
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # CDR_BE, CDR_LE
_ID_END = HEADER_LENGTH + 16
_RESPONSE_LENGTH = 12  # of send_goal: a bool, and a stamp aligned to four
_CANCELED = {order: struct.Struct(f"{order}b3xI") for order in "<>"}  # code, and how many goals
_REJECTED = 1
"""Of action_msgs/srv/CancelGoal. A goal that is unknown (2) or over (3) moves no robot."""
_COUNT_END = HEADER_LENGTH + 4
_FIRST_STATUS = struct.Struct("<16s8xB")  # goal id, stamp, state: one byte, so in either order
_NEXT_STATUS = struct.Struct("<16s11xB")
_MOST_STATUSES = 10_000  # goals of a message that are read. A round figure: any node may publish a longer list

STATES = ("unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted")
"""By their numbers in action_msgs/msg/GoalStatus."""
MOST_GOALS = 256
"""Goals that are remembered; the bridge forgets finished ones first."""
ASKED, UNKNOWN, REJECTED = "asked", "unknown", "rejected"
OVER = frozenset({REJECTED, "succeeded", "canceled", "aborted"})
"""Final states."""
_ORDER = (UNKNOWN, ASKED, "accepted", "executing", "canceling")


class GoalStatus(NamedTuple):
    """One goal of a status message."""

    goal: bytes
    state: str


def goal_of(payload: bytes) -> bytes | None:
    """Return the goal id in a send_goal or get_result request, or in a feedback message."""
    if payload[:2] not in _ORDERS or len(payload) < _ID_END:
        return None
    return payload[HEADER_LENGTH:_ID_END]


def cancel_request(goal: bytes) -> bytes:
    """Return a cancel_goal request for one goal."""
    return b"\x00\x01\x00\x00" + goal + bytes(8)


def result_request(goal: bytes) -> bytes:
    """Return a get_result request."""
    return b"\x00\x01\x00\x00" + goal


def refuses_cancel(payload: bytes) -> bool:
    """Return whether by a cancel_goal response, or one that cannot be read, a goal that runs goes on."""
    order = _ORDERS.get(payload[:2], "")
    if not order or len(payload) < HEADER_LENGTH + _CANCELED[order].size:
        return True
    code, goals = _CANCELED[order].unpack_from(payload, HEADER_LENGTH)
    # rclpy's servers, which reject every cancel by default, say that there was no error and cancel none.
    return bool(code == _REJECTED or (code == 0 and goals == 0))


def accepted_by(payload: bytes) -> bool | None:
    """Return whether a send_goal response accepts the goal."""
    if payload[:2] not in _ORDERS or len(payload) <= HEADER_LENGTH:
        return None
    return payload[HEADER_LENGTH] != 0


def rejection_of(request: bytes) -> bytes:
    """Return a send_goal response that does not accept the goal."""
    # In the request's byte order.
    return request[:2] + bytes(2 + _RESPONSE_LENGTH)


def state_of(payload: bytes) -> str | None:
    """Return the goal's last state in a get_result response; ``unknown`` if its server does not know the goal."""
    if payload[:2] not in _ORDERS or len(payload) <= HEADER_LENGTH:
        return None
    state = payload[HEADER_LENGTH]
    return STATES[state] if state < len(STATES) else None


def statuses_of(payload: bytes) -> list[GoalStatus] | None:
    """Return the first 10,000 goals of a status message (action_msgs/msg/GoalStatusArray)."""
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < _COUNT_END:
        return None
    (count,) = struct.unpack_from(f"{order}I", payload, HEADER_LENGTH)
    if count == 0:
        return []
    # The id of the second and of later ones follows a state, one byte; the stamp behind it is aligned to four.
    next_begins = _COUNT_END + _FIRST_STATUS.size
    # The count is anybody's word.
    if next_begins + (count - 1) * _NEXT_STATUS.size > len(payload):
        return None
    next_end = next_begins + (min(count, _MOST_STATUSES) - 1) * _NEXT_STATUS.size
    found = [_FIRST_STATUS.unpack_from(payload, _COUNT_END), *_NEXT_STATUS.iter_unpack(payload[next_begins:next_end])]
    return [GoalStatus(goal, STATES[state] if state < len(STATES) else STATES[0]) for goal, state in found]


@dataclass(slots=True)
class _Goal:
    state: str
    since: float  # s since the epoch
    feedbacks: int = 0
    crossed: bool = False  # sent by this route's callers, not by others of its server
    listed: bool = False  # by its server's last status message
    gone: bool = False  # with its server, or its server does not know it
    ended: bool = False  # with the arming: it is cancelled, even if its server accepts it only later


class Goals:
    """The newest goals of an action, including goals of the server's other callers."""

    def __init__(self, wall: Callable[[], float]) -> None:
        self._wall = wall
        self._goals: dict[bytes, _Goal] = {}

    def response(self, lane: int, goal: bytes, payload: bytes) -> None:
        """Read the server's response to a request about a goal."""
        if lane == SEND_GOAL and (accepted := accepted_by(payload)) is not None:
            self.answered(goal, accepted=accepted)
        elif lane == GET_RESULT and (state := state_of(payload)) is not None:
            self.result(goal, state)

    def message(self, lane: int, payload: bytes) -> None:
        """Read the server's status or feedback."""
        if lane == STATUS and (statuses := statuses_of(payload)) is not None:
            self.listed(statuses)
        elif lane == FEEDBACK and (goal := goal_of(payload)) is not None:
            self.feedback(goal)

    def asked(self, goal: bytes) -> None:
        """Note that a caller has sent a goal."""
        if goal not in self._goals:
            self._add(goal, ASKED)
        self._goals[goal].crossed = True

    def answered(self, goal: bytes, *, accepted: bool) -> None:
        """Note that the server has accepted or rejected a goal; it rejects a second goal with the same id."""
        known = self._goals.get(goal)
        if known is not None and known.state in (ASKED, UNKNOWN):
            self._change(goal, "accepted" if accepted else REJECTED)

    def unanswered(self, goal: bytes) -> None:
        """Note that the call that sent a goal was given up: its state is unknown."""
        known = self._goals.get(goal)
        if known is not None and known.state == ASKED:
            self._change(goal, UNKNOWN)

    def listed(self, statuses: Iterable[GoalStatus]) -> None:
        """Take the states that the server has published.

        If a goal is no longer listed, the server has forgotten it: it has been restarted, or it does not keep results
        for so long. The goal's state is unknown then.
        """
        stated = {each.goal: each.state for each in statuses}
        for goal, state in stated.items():
            if goal not in self._goals and state not in OVER and state != UNKNOWN:
                self._add(goal, state)
            elif goal in self._goals and self._follows(self._goals[goal].state, state):
                self._change(goal, state)
        for goal, known in self._goals.items():
            if known.listed and goal not in stated and known.state not in OVER:
                self._change(goal, UNKNOWN)
            known.listed = goal in stated
            known.gone = known.state == UNKNOWN and not known.listed

    def feedback(self, goal: bytes) -> None:
        """Count a goal's feedback message."""
        if (known := self._goals.get(goal)) is not None:
            known.feedbacks += 1

    def result(self, goal: bytes, state: str) -> None:
        """Take the state that came with a goal's result; `UNKNOWN` if the server does not know the goal."""
        known = self._goals.get(goal)
        if known is not None and known.state not in OVER:
            known.gone = state == UNKNOWN
            self._change(goal, state)

    def server_gone(self) -> None:
        """Note that the server has gone: the states of unfinished goals are unknown."""
        for goal, known in self._goals.items():
            known.listed = False
            if known.state not in OVER:
                known.gone = True
                self._change(goal, UNKNOWN)

    def is_over(self, goal: bytes) -> bool:
        """Return whether a goal has finished, as far as its server has told."""
        return goal in self._goals and self._goals[goal].state in OVER

    def running(self) -> list[bytes]:
        """Return the accepted goals of this route's callers that may still run."""
        return [
            goal
            for goal, known in self._goals.items()
            if known.crossed and known.state not in OVER and known.state != ASKED and not known.gone
        ]

    def end(self) -> list[bytes]:
        """End the goals of this route's callers with their arming, and return them; some may not have begun yet."""
        ended = [goal for goal, known in self._goals.items() if known.crossed and known.state == ASKED]
        ended += self.running()
        for goal in ended:
            self._goals[goal].ended = True
        return ended

    def has_ended(self, goal: bytes) -> bool:
        """Return whether a goal's arming has ended."""
        return goal in self._goals and self._goals[goal].ended

    def snapshot(self, awaited: AbstractSet[bytes]) -> tuple[GoalSnapshot, ...]:
        """Return all goals, unfinished ones first, and newer before older ones.

        Args:
            awaited: ids of goals whose results callers wait for.
        """
        newest = list(self._goals.items())[::-1]
        newest.sort(key=lambda item: item[1].state in OVER)
        return tuple(
            GoalSnapshot(goal.hex(), known.state, known.since, known.feedbacks, goal in awaited)
            for goal, known in newest
        )

    def _add(self, goal: bytes, state: str) -> None:
        if len(self._goals) >= MOST_GOALS:
            oldest = next((each for each, known in self._goals.items() if known.state in OVER), next(iter(self._goals)))
            del self._goals[oldest]
        self._goals[goal] = _Goal(state, self._wall())

    def _change(self, goal: bytes, state: str) -> None:
        known = self._goals.get(goal)
        if known is not None and known.state != state:
            known.state, known.since = state, self._wall()

    @staticmethod
    def _follows(old: str, new: str) -> bool:
        """Return whether a state is news, because messages of an action's five lanes overtake each other."""
        if old in OVER:
            return False
        return new in OVER or (new in _ORDER and _ORDER.index(new) > _ORDER.index(old))
