"""The callers' half of an action's route: its goals, and calls that outlive an interruption (`kept_calls`).

While the action cannot be reached, ``send_goal``, feedback and status are withdrawn, so that clients see no server. As
long as goals run or callers wait, ``cancel_goal`` and ``get_result`` are still offered: a request to a service that is
not there is lost for good (rclpy and rclcpp send it to nobody). Once the action can be reached, cancels go first. While
the action is paused or disarmed, only ``send_goal`` is withdrawn, so that goals can still be cancelled and watched.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.by_hand import END_NONE, more_careful_end
from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, STATUS, Refused
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.calling import CallerCall, CallingRoute
from rsb_bridge.route.calls.goals import Goals, acceptance_of, goal_of, rejection_of
from rsb_bridge.route.calls.kept_calls import INTERRUPTION, KeptCall, KeptCalls
from rsb_bridge.wire.headers import CallFrame, frame_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import Request, ServiceServer
    from rsb_bridge.route.calls.calling import OfferedService
    from rsb_bridge.route.calls.manual_call import ManualCall
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose, Provide

_OUTLIVING = (CANCEL_GOAL, GET_RESULT)
_FOR_NOW = (Refused.PAUSED, Refused.DISARMED, Refused.UNHEARD, Refused.PROVIDER_GONE, Refused.LOST)
"""Refusals after which a later attempt may succeed."""
_UNREACHABLE = "the action could not be reached"


class CallingActionRoute(CallingRoute):
    """Offers an action here.

    Attributes:
        goals: all that are known.
        waiting: calls that are sent once the action can be reached.
    """

    never_idle: ClassVar[bool] = True  # goals have times of their own, and a robot has few actions

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.goals = Goals(context.wall)
        self.waiting = KeptCalls(self.call_timeout)
        self._interrupted_at = 0.0  # s

    @property
    def on_end(self) -> str:
        return more_careful_end((self.arming.own.on_end, self.arming.peer_on_end, END_NONE))

    # --- offering

    def provided(self, provide: Provide) -> None:
        """Take the providing side's list, and send what waits once the action can be reached."""
        had_server = self._has_providers
        super().provided(provide)
        if had_server and not self._has_providers:
            self.goals.server_gone()
        # Else calls that were refused for now wait for the next tick.
        if self._reach:
            self._send_waiting()

    def _offer(self, lanes: frozenset[int]) -> None:
        before = self._reach
        super()._offer(lanes)
        if self._reach - before:
            self._send_waiting()

    def _owed(self) -> set[int]:
        owed = super()._owed()
        return owed | {SEND_GOAL} if self.waiting.of(SEND_GOAL) else owed

    def _withdraw(self) -> None:
        if self._reach:
            self._interrupted_at = self.context.now()
        super()._withdraw()

    def _outliving(self) -> tuple[int, ...]:
        # While the link is up this may be short, as when the action is disarmed; otherwise `tick` closes the rest.
        expected = len(self._pending) or len(self.waiting) or self.goals.running()
        return _OUTLIVING if self.peer.linked or expected else ()

    def destroy(self) -> None:
        super().destroy()
        self.failures.lost(len(self.waiting), "the route was removed")

    # --- calls and answers

    def asked(self, service: OfferedService, requests: Sequence[Request]) -> None:
        if self._reach:
            super().asked(service, requests)
            return
        # An interruption leaves some services open.
        now = self.context.now()
        for request in requests:
            self._asked_for(len(request.payload))
            call = KeptCall(service.lane, request.caller, request.payload, now)
            if service.lane == SEND_GOAL or not self.waiting.keep(call, now):
                self.failures.lost(1, _UNREACHABLE)

    def _refuse_request(self, service: OfferedService, request: Request, why: Refused) -> None:
        super()._refuse_request(service, request, why)
        if service.lane == SEND_GOAL:
            self._reject(service.server, request.caller, request.payload)

    def _remember(self, call: CallerCall, payload: bytes) -> None:
        call.kept = KeptCall(call.lane, call.caller, payload, call.asked_at)
        if call.lane == SEND_GOAL and (goal := goal_of(payload)) is not None:
            self.goals.asked(goal)

    def _answer_caller(self, call: CallerCall, frame: CallFrame) -> None:
        if call.kept is not None and (goal := goal_of(call.kept.payload)) is not None:
            self.goals.response(call.lane, goal, frame.content)
        super()._answer_caller(call, frame)

    def _end_refused(self, call: CallerCall, why: Refused) -> None:
        """Keep a call if a later attempt may succeed, or end it."""
        if call.lane in _OUTLIVING and why in _FOR_NOW and self._keep(call):
            return
        super()._end_refused(call, why)
        if call.kept is not None and call.lane == SEND_GOAL and why is not Refused.LOST:  # else the goal may run
            self._reject(call.server, call.caller, call.kept.payload)

    def _unanswered(self, call: CallerCall, reason: str) -> None:
        super()._unanswered(call, reason)
        if call.kept is not None and call.lane == SEND_GOAL and (goal := goal_of(call.kept.payload)) is not None:
            self.goals.unanswered(goal)  # it may have been accepted

    def _take_message(self, frame: CallFrame) -> None:
        self.goals.message(frame.lane, frame.content)
        super()._take_message(frame)
        if frame.lane == STATUS:
            self._tell_accepted()

    # --- calls that wait

    def _keep(self, call: CallerCall) -> bool:
        return call.kept is not None and self.waiting.keep(call.kept, self.context.now())

    def _tell_accepted(self) -> None:
        """Answer the callers of goals whose answer was lost, and that the server lists."""
        service = self._offers.services.get(SEND_GOAL)
        for call in self.waiting.of(SEND_GOAL) if service is not None else ():
            goal = goal_of(call.payload)
            if service is not None and goal is not None and (stamp := self.goals.accepted_at(goal)) is not None:
                self.waiting.end(call)
                service.server.answer(call.caller, acceptance_of(stamp))
                self._answered(0)

    def _send_waiting(self) -> None:
        """Send all calls that wait, cancels first."""
        self._tell_accepted()
        now = self.context.now()
        for kept in self.waiting.release():
            size, service = frame_size(kept.payload), self._offers.services.get(kept.lane)
            why = self.peer.budget.asked.take(size, now) if service is not None else None
            if service is not None and why is None:
                call = CallerCall(kept.lane, size, kept.asked, service.server, kept.caller, kept)
                self._begin(call, kept.payload)
            elif not self.waiting.keep(kept, now):  # else it is sent in a second: a cancel must not get lost
                if why is not None:
                    self.failures.refused(why)
                else:
                    self.failures.lost(1, _UNREACHABLE)
        self.flush()

    def _reject(self, server: ServiceServer | ManualCall, caller: bytes, request: bytes) -> None:
        """Answer that a goal is not accepted: it did not begin, and will not."""
        if (goal := goal_of(request)) is not None:
            self.goals.answered(goal, accepted=False)
        try:
            server.answer(caller, rejection_of(request))
        except RosError as error:
            self.failures.say(f"a caller could not be answered: {error}")

    def tick(self) -> None:
        if expired := self.waiting.expire(self.context.now()):
            self.calls.expired += len(expired)
            self.failures.say("a call about a goal waited too long for the action to be reached again")
            for call in expired:
                if call.lane == SEND_GOAL and (goal := goal_of(call.payload)) is not None:
                    self.goals.unanswered(goal)
        self._limit_results()
        if self._reach and self.waiting:
            self._send_waiting()
        elif self._reach and self._offers.services.keys() - self._reach - self._owed():
            self.advance()  # nobody waits for the answer to a goal any more
        elif not self._reach and self._offers.services and not self._awaits_end:
            self._offers.close()
        super().tick()

    @property
    def _awaits_end(self) -> bool:
        """Whether callers may still ask about goals although the action cannot be reached."""
        if self.waiting:
            return True
        lasts = self.context.now() < self._interrupted_at + INTERRUPTION
        return not self.peer.linked and bool(self.goals.running()) and lasts

    def _limit_results(self) -> None:
        """Give requests for the results of goals that are over as long as other calls."""
        for number, call in self._pending.items():
            if call.kept is None or call.lane != GET_RESULT:
                continue
            if (goal := goal_of(call.kept.payload)) is not None and self.goals.is_over(goal):
                self._pending.limit(number, self.call_timeout)

    # --- snapshot

    def snapshot(self) -> RouteSnapshot:
        kept = [call.kept for _, call in self._pending.items() if call.kept is not None and call.lane == GET_RESULT]
        requests = [each.payload for each in (*kept, *self.waiting.of(GET_RESULT))]
        awaited = {goal for request in requests if (goal := goal_of(request)) is not None}
        return replace(super().snapshot(), goals=self.goals.snapshot(awaited))
