"""The callers' half of an action: its goals and what is asked about them outlive an interruption.

While the action cannot be reached, ``send_goal``, feedback and status are withdrawn, so that clients see no server. As
long as goals run or callers wait, ``cancel_goal`` and ``get_result`` are still offered: a request to a service that is
not there is lost for good (rclpy and rclcpp send it to nobody). Once the action can be reached, cancels go first.

While it is paused or disarmed, only ``send_goal`` is withdrawn, so that goals can still be cancelled and watched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CANCEL_GOAL, FEEDBACK, GET_RESULT, SEND_GOAL, STATUS, Refused
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.calling import CallerCall, CallingRoute
from rsb_bridge.route.calls.calls_route import frame_size
from rsb_bridge.route.calls.goals import (
    Goals,
    accepted_by,
    goal_of,
    rejection_of,
    state_of,
    statuses_of,
)
from rsb_bridge.route.calls.kept_calls import INTERRUPTION, KeptCall, KeptCalls
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import Request, ServiceServer
    from rsb_bridge.route.calls.manual_call import ManualCall
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose, Provide

_OUTLIVING = (CANCEL_GOAL, GET_RESULT)
_FOR_NOW = (Refused.PAUSED, Refused.DISARMED, Refused.UNHEARD, Refused.PROVIDER_GONE, Refused.LOST)
"""Refusals after which asking again may help."""


@dataclass(slots=True)
class _ActionCall(CallerCall):
    """A call of a caller here.

    Attributes:
        payload: the request.
        instance: of the peer's process that it was sent to.
        again: it was under way before.
    """

    payload: bytes
    instance: str
    again: bool


class CallingAction(CallingRoute):
    """Offers an action here."""

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.goals = Goals(context.wall, context.now)
        self._waiting = KeptCalls(self.call_timeout)
        self._interrupted_at = 0.0

    # --- offering

    def provided(self, provide: Provide) -> None:
        """The providing side says what there is to call."""
        had_server = self._has_providers
        super().provided(provide)
        if had_server and not self._has_providers:
            self.goals.server_gone()
        if self._reach:
            self._ask_again()

    def _offer(self, provided: Provide, lanes: frozenset[int]) -> None:
        before = self._reach
        super()._offer(provided, lanes)
        if self._reach - before:
            self._ask_again()

    def _withdraw(self) -> None:
        """Withdraw all that would tell callers that the action can be reached."""
        if self._reach:
            self._interrupted_at = self.context.now()
            self._reach = frozenset()
        # While the link is up this may be for a moment, as when it is disarmed; else `tick` sees to it.
        keeps = self.peer.linked or len(self._under_way) or len(self._waiting) or self.goals.running()
        self._offers.close(keep=_OUTLIVING if keeps else ())
        self._rivals.close()

    def _owed(self) -> set[int]:
        return super()._owed() | ({SEND_GOAL} if self._waiting.requests(SEND_GOAL) else set())

    def destroy(self) -> None:
        """End it for good: nobody waits any longer."""
        super().destroy()
        self._offers.close()
        for call in self._waiting.release():
            self._give_up_kept(call, "the route was removed")

    # --- calls

    def _asked(self, lane: int, requests: Sequence[Request]) -> None:
        if self._reach:
            super()._asked(lane, requests)
            return
        now = self.context.now()
        for request in requests:
            self._asked_for(len(request.payload))
            call = KeptCall(lane, request.caller, request.payload, now, again=False)
            if not self._waiting.keep(call, now):
                self._give_up_kept(call)

    def _refuse_caller(self, lane: int, request: Request, why: Refused) -> None:
        super()._refuse_caller(lane, request, why)
        if lane == SEND_GOAL:
            self._reject(self._offers.servers[lane], request.caller, request.payload)

    def _begin(self, lane: int, request: Request, hand: ManualCall | None = None) -> None:
        if hand is not None:
            super()._begin(lane, request, hand)  # an operator who waits is not kept waiting over an interruption
            return
        stamp = self._stamp_of(lane, request)
        kept = KeptCall(lane, request.caller, request.payload, self.context.now(), again=False, stamp=stamp)
        self._ask(kept, request.lease)
        if lane == SEND_GOAL and (goal := goal_of(request.payload)) is not None:
            self.goals.asked(goal)

    def _ask(self, call: KeptCall, lease: int = 0) -> None:
        """Send a call, which has its place in the budget; `lease`: the number that says how old it can be."""
        self._last_number += 1
        self._came = True
        size, server = frame_size(call.payload), self._offers.servers[call.lane]
        under_way = _ActionCall(
            call.lane, size, call.asked, server, call.caller, call.payload, self.peer.instance, call.again
        )
        self._under_way.add(self._last_number, under_way, self.timeout_of(call.lane))
        what = What.AGAIN if call.again else What.CALL
        self._send(CallFrame(what, call.lane, self._last_number, 0, call.payload, lease, call.stamp))

    def _ask_again(self) -> None:
        """Ask whatever waits: cancels first."""
        now = self.context.now()
        for call in self._waiting.release():
            if call.lane == SEND_GOAL and call.instance != self.peer.instance:
                self._give_up_kept(call)  # only the process that it was sent to knows whether it arrived
            elif call.lane not in self._offers.servers:
                if not self._waiting.keep(call, now):
                    self._give_up_kept(call)
            elif (why := self.peer.budget.asked.take(frame_size(call.payload), now)) is None:
                self._ask(call)
            elif not self._waiting.keep(call, now):  # else it is asked in a second: a cancel must not get lost
                self._refuse(why)
                if call.lane == SEND_GOAL:
                    self._give_up_goal(call.payload)
        self.flush()

    def _keep(self, call: CallerCall) -> bool:
        """Have a call that was under way wait until it can be asked about again; False: it is over."""
        if not isinstance(call, _ActionCall):
            return False
        kept = KeptCall(call.lane, call.caller, call.payload, call.asked_at, again=True, instance=call.instance)
        return self._waiting.keep(kept, self.context.now())

    def _give_up_kept(self, call: KeptCall, why: str = "the action could not be reached") -> None:
        """A call will have no answer."""
        self._lose(1, why)
        if call.lane == SEND_GOAL:
            self._give_up_goal(call.payload)

    def _take_answer(self, frame: CallFrame) -> None:
        call = self._call_of(frame)
        if isinstance(call, _ActionCall) and (goal := goal_of(call.payload)) is not None:
            if frame.lane == SEND_GOAL and (accepted := accepted_by(frame.content)) is not None:
                self.goals.answered(goal, accepted=accepted)
            elif frame.lane == GET_RESULT and (state := state_of(frame.content)) is not None:
                self.goals.result(goal, state)
        super()._take_answer(frame)

    def _take_refusal(self, frame: CallFrame, why: Refused) -> None:
        call = self._call_of(frame)
        if not isinstance(call, _ActionCall):
            super()._take_refusal(frame, why)
        elif call.lane in _OUTLIVING and why in _FOR_NOW and self._keep(call):
            self._ended(frame)
        else:
            super()._take_refusal(frame, why)
            if call.lane != SEND_GOAL:
                return
            if why is Refused.NOT_ARRIVED or (why is not Refused.LOST and not call.again):
                self._reject(call.server, call.caller, call.payload)
            else:
                self._give_up_goal(call.payload)  # it may have begun, also where only the question after it is refused

    def _take_unusable(self, frame: CallFrame, why: Refused) -> None:
        call = self._call_of(frame)
        super()._take_unusable(frame, why)
        if frame.what is What.ANSWER and frame.lane == SEND_GOAL and isinstance(call, _ActionCall):
            self._give_up_goal(call.payload)  # it may have been accepted

    def _reject(self, server: ServiceServer, caller: bytes, request: bytes) -> None:
        """Answer that a goal is not accepted: it did not begin, and will not."""
        if (goal := goal_of(request)) is not None:
            self.goals.answered(goal, accepted=False)
        try:
            server.answer(caller, rejection_of(request))
        except RosError as error:
            self._failed(f"a caller could not be answered: {error}")

    def _give_up_goal(self, request: bytes) -> None:
        """The call that sent a goal has no answer."""
        if (goal := goal_of(request)) is not None:
            self.goals.unanswered(goal)

    def _take_message(self, frame: CallFrame) -> None:
        if frame.lane == STATUS and (statuses := statuses_of(frame.content)) is not None:
            self.goals.listed(statuses)
        elif frame.lane == FEEDBACK and (goal := goal_of(frame.content)) is not None:
            self.goals.feedback(goal)
        super()._take_message(frame)

    def _expired(self, number: int, call: CallerCall) -> None:
        if isinstance(call, _ActionCall) and call.lane == SEND_GOAL:
            self._give_up_goal(call.payload)
        super()._expired(number, call)

    def _give_up_all(self, why: str) -> None:
        for number in self._under_way.numbers():
            call = self._under_way.get(number)
            if call is None:
                continue
            if self._keep(call):
                self._under_way.end(number)
            elif isinstance(call, _ActionCall) and call.lane == SEND_GOAL:
                self._give_up_goal(call.payload)
        super()._give_up_all(why)

    # --- time

    def tick(self) -> None:
        """Once a second: what has waited too long, and what may be asked again."""
        now = self.context.now()
        if expired := self._waiting.expire(now):
            self.calls.expired += len(expired)
            self._failed("a call about a goal waited too long for the action to be reached again")
            for call in expired:
                if call.lane == SEND_GOAL:
                    self._give_up_goal(call.payload)
        self._give_up_results()
        if self._reach and self._waiting:
            self._ask_again()
        elif self._reach and self._offers.types.keys() - self._reach - self._owed():
            self.advance()  # whoever waited for the answer to a goal has it
        elif not self._reach and self._offers.types and not self._is_awaited(now):
            self._offers.close()
        super().tick()

    def _give_up_results(self) -> None:
        """Of goals that have been over for as long as other calls may take."""
        for number in self._under_way.numbers():
            call = self._under_way.get(number)
            if not isinstance(call, _ActionCall) or call.lane != GET_RESULT:
                continue
            goal = goal_of(call.payload)
            over_for = self.goals.over_for(goal) if goal is not None else None
            if over_for is not None and over_for > self.call_timeout:
                self._under_way.end(number)
                self._expired(number, call)

    def _is_awaited(self, now: float) -> bool:
        """Whether anybody may still ask about goals while the action cannot be reached."""
        if self._waiting:
            return True
        return not self.peer.linked and bool(self.goals.running()) and now < self._interrupted_at + INTERRUPTION

    # --- how it is

    def snapshot(self) -> RouteSnapshot:
        return replace(super().snapshot(), goals=self.goals.snapshot(self._awaited()))

    def _awaited(self) -> set[bytes]:
        """The goals for whose results callers wait."""
        under_way = [self._under_way.get(number) for number in self._under_way.numbers()]
        requests = [each.payload for each in under_way if isinstance(each, _ActionCall) and each.lane == GET_RESULT]
        requests += self._waiting.requests(GET_RESULT)
        return {goal for request in requests if (goal := goal_of(request)) is not None}
