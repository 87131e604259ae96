"""The goals of an action's route in its callers' half.

While the action is paused or disarmed, only ``send_goal`` is withdrawn: goals can still be cancelled and watched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.by_hand import END_NONE, more_careful_end
from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.asked_calls import CallerKind
from rsb_bridge.route.calls.goals import Goals, goal_of, rejection_of

if TYPE_CHECKING:
    from rsb_bridge.model.calls import GoalSnapshot
    from rsb_bridge.ros.ros_interface import ServiceServer
    from rsb_bridge.route.calls.asked_calls import CallerCall, CallerCalls
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.manual_call import ManualCall
    from rsb_bridge.wire.headers import CallFrame

_ALL_GOALS = bytes(16)
"""In the place of a cancelled goal's id."""


class CallerGoals(CallerKind):
    """Follows goals by the calls, answers and messages of an action.

    Attributes:
        goals: all that are known.
    """

    never_idle: ClassVar[bool] = True  # goals have times of their own, and a robot has few actions
    goals: Goals

    def __init__(self, flow: CallsFlow, pending: CallerCalls) -> None:
        super().__init__(flow, pending)
        self.goals = Goals(flow.route.context.wall)

    @property
    def on_end(self) -> str:
        return more_careful_end((self._route.arming.own.on_end, self._route.arming.peer_on_end, END_NONE))

    def begins(self, call: CallerCall, payload: bytes) -> None:
        call.request = payload
        if call.lane == SEND_GOAL and (goal := goal_of(payload)) is not None:
            self.goals.asked(goal)

    def repeats(self, call: CallerCall) -> bool:
        # A goal may begin once only, and a late cancel of all goals would end some that have begun since.
        return call.lane in (CANCEL_GOAL, GET_RESULT) and goal_of(call.request) not in (None, _ALL_GOALS)

    def refused(self, lane: int, server: ServiceServer | ManualCall, caller: bytes, request: bytes) -> None:
        """Answer that a goal is not accepted: it did not begin, and will not."""
        if lane != SEND_GOAL or not request:  # an operator's is not remembered
            return
        if (goal := goal_of(request)) is not None:
            self.goals.answered(goal, accepted=False)
        try:
            server.answer(caller, rejection_of(request))
        except RosError as error:
            self._flow.failures.say(f"a caller could not be answered: {error}")

    def answered(self, call: CallerCall, frame: CallFrame) -> None:
        if (goal := goal_of(call.request)) is not None:
            self.goals.response(call.lane, goal, frame.content)

    def unanswered(self, call: CallerCall) -> None:
        if call.lane == SEND_GOAL and (goal := goal_of(call.request)) is not None:
            self.goals.unanswered(goal)  # it may have been accepted

    def publishes(self, frame: CallFrame) -> bool:
        self.goals.message(frame.lane, frame.content)
        return True

    def server_gone(self) -> None:
        self.goals.server_gone()

    def act(self, now: float) -> None:
        """Give requests for the results of goals that are over as long as other calls."""
        for number, goal in self._awaited():
            if self.goals.is_over(goal):
                self._pending.limit(number, self._flow.call_timeout)

    def _awaited(self) -> list[tuple[int, bytes]]:
        calls = ((number, goal_of(call.request)) for number, call in self._pending.items() if call.lane == GET_RESULT)
        return [(number, goal) for number, goal in calls if goal is not None]

    def snapshot(self) -> tuple[GoalSnapshot, ...]:
        return self.goals.snapshot({goal for _, goal in self._awaited()})
