"""The goals of one action, and what a bridge reads of the action's serialized messages: goal ids and states.

Each of these messages begins with fields that are the same for every action (action_msgs, unique_identifier_msgs, and
the ROS 2 design article on actions), so that the action's type need not be known. Nothing of a goal's own fields is
read. Whatever cannot be read is None; it crosses all the same.
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
_CANCEL_END = _ID_END + 8
_ALL = bytes(16)
_RESPONSE_LENGTH = 12  # of send_goal: a bool, and a stamp aligned to four
_COUNT_END = HEADER_LENGTH + 4
_FIRST_STATUS, _NEXT_STATUS = struct.Struct("16s8xB"), struct.Struct("16s3x8xB")  # goal id, stamp, state
_MOST_STATUSES = 10_000

STATES = ("unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted")
"""By their numbers in action_msgs/msg/GoalStatus."""
MOST_GOALS = 256
"""That are remembered; those that are not over stay longest."""
ASKED, UNKNOWN, REJECTED = "asked", "unknown", "rejected"
OVER = frozenset({REJECTED, "succeeded", "canceled", "aborted"})
"""The states that no goal leaves."""
_ORDER = (UNKNOWN, ASKED, "accepted", "executing", "canceling")


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


@dataclass(slots=True)
class _Goal:
    state: str
    since: float  # s since the epoch
    changed_at: float  # s
    feedbacks: int = 0
    crossed: bool = False  # sent by this route's callers, not by others of its server
    listed: bool = False  # by its server's last status message
    gone: bool = False  # with its server, or this says that it does not know it


class Goals:
    """The newest goals of an action, those of other callers of its server among them.

    Args:
        wall: gives s since the epoch.
        now: gives s on a clock that nobody sets.
    """

    def __init__(self, wall: Callable[[], float], now: Callable[[], float]) -> None:
        self._wall = wall
        self._now = now
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
        """A caller has sent it."""
        if goal not in self._goals:
            self._add(goal, ASKED)
        self._goals[goal].crossed = True

    def answered(self, goal: bytes, *, accepted: bool) -> None:
        """Its server has accepted or rejected it; it rejects a second goal of the same id."""
        known = self._goals.get(goal)
        if known is not None and known.state in (ASKED, UNKNOWN):
            self._change(goal, "accepted" if accepted else REJECTED)

    def unanswered(self, goal: bytes) -> None:
        """The call that sent it was given up: nobody here knows what became of it."""
        known = self._goals.get(goal)
        if known is not None and known.state == ASKED:
            self._change(goal, UNKNOWN)

    def listed(self, statuses: Iterable[GoalStatus]) -> None:
        """Its server has published the states of all its goals.

        A goal that it listed before and no longer does has been forgotten: the server began anew, or the goal was over
        for longer than the server keeps results. What became of it is not known then.
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
        """A feedback message of it has crossed."""
        if (known := self._goals.get(goal)) is not None:
            known.feedbacks += 1

    def result(self, goal: bytes, state: str) -> None:
        """Its server has answered with its result, or that it does not know the goal."""
        known = self._goals.get(goal)
        if known is not None and known.state not in OVER:
            known.gone = state == UNKNOWN
            self._change(goal, state)

    def server_gone(self) -> None:
        """The server is gone, and what becomes of its goals is not known."""
        for goal, known in self._goals.items():
            known.listed = False
            if known.state not in OVER:
                known.gone = True
                self._change(goal, UNKNOWN)

    def over_for(self, goal: bytes) -> float | None:
        """S since it was over; None: it is not known to be."""
        known = self._goals.get(goal)
        return self._now() - known.changed_at if known is not None and known.state in OVER else None

    def running(self) -> list[bytes]:
        """Those sent by this route's callers that are not known to be over, nor to wait for their acceptance."""
        return [
            goal
            for goal, known in self._goals.items()
            if known.crossed and known.state not in OVER and known.state != ASKED and not known.gone
        ]

    def snapshot(self, awaited: AbstractSet[bytes]) -> tuple[GoalSnapshot, ...]:
        """All of them: those that are not over first, newest first.

        Args:
            awaited: those for whose results callers wait.
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
        self._goals[goal] = _Goal(state, self._wall(), self._now())

    def _change(self, goal: bytes, state: str) -> None:
        known = self._goals.get(goal)
        if known is not None and known.state != state:
            known.state, known.since, known.changed_at = state, self._wall(), self._now()

    @staticmethod
    def _follows(old: str, new: str) -> bool:
        """Whether a state is news: messages of an action's five lanes overtake each other."""
        if old in OVER:
            return False
        return new in OVER or (new in _ORDER and _ORDER.index(new) > _ORDER.index(old))
