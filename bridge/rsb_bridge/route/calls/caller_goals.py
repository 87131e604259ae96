"""The goals of an action's route in its callers' half.

While the action is paused or disarmed, only ``send_goal`` is withdrawn: goals can still be cancelled and watched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.asked_calls import CallerKind
from rsb_bridge.route.calls.goals import Goals, goal_of, rejection_of

if TYPE_CHECKING:
    from rsb_bridge.ros.ros_interface import ServiceServer
    from rsb_bridge.route.calls.asked_calls import CallerCall, CallerCalls
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.manual_call import ManualCall
    from rsb_bridge.wire.headers import CallFrame

_ALL_GOALS = bytes(16)
"""In the place of a cancelled goal's id."""


class CallerGoals(CallerKind):
    """Follows goals by the calls, answers and messages of an action."""

    goals: Goals

    def __init__(self, flow: CallsFlow, pending: CallerCalls) -> None:
        super().__init__(flow, pending)
        self.goals = Goals(flow.route.context.wall)

    def begins(self, call: CallerCall, payload: bytes) -> None:
        call.request = payload
        goal = goal_of(payload)
        if call.lane == SEND_GOAL and goal is not None:
            self.goals.asked(goal)
        elif call.lane == GET_RESULT and goal is not None:
            call.goal = goal

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
