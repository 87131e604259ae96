"""The goals of an action's route, as its halves follow them by calls, answers and messages.

While the action is paused or disarmed, only ``send_goal`` is withdrawn: goals can still be cancelled and watched. The
providing half cancels them once an arming ends, if a session wants that.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.by_hand import END_CANCEL
from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, STATUS
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.asked_calls import CallerKind
from rsb_bridge.route.calls.goals import (
    MOST_GOALS,
    Goals,
    accepted_by,
    cancel_request,
    goal_of,
    refuses_cancel,
    rejection_of,
)
from rsb_bridge.route.calls.provided_calls import ProviderKind
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Response, ServiceServer
    from rsb_bridge.route.calls.asked_calls import CallerCall, CallerCalls
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.manual_call import ManualCall
    from rsb_bridge.route.calls.paced_client import PacedClient
    from rsb_bridge.route.calls.provided_calls import CalledService, PeersCall

_ALL_GOALS = bytes(16)
"""In the place of a cancelled goal's id."""
_CANCELLED_WITHIN = 5.0  # s. A round figure: an operator has to hear soon that a robot may go on


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


class ProviderGoals(ProviderKind):
    """Follows goals by the calls, responses and messages of an action; they go on while the link is down.

    Attributes:
        undecided: goals that the server has neither accepted nor rejected, by the client's number.
    """

    goals: Goals

    def __init__(self, flow: CallsFlow, *parts: Any) -> None:
        super().__init__(flow, *parts)
        self.goals = Goals(flow.route.context.wall)
        self._status = b""  # the server's last one
        self._status_sent = False  # in the present opening
        # Goals that are being cancelled, and since when (s), by the cancel's number, or by goal before its turn.
        # Also by client, as another one numbers from the start.
        self._cancels: dict[tuple[PacedClient, int | bytes], tuple[bytes, float]] = {}
        self.undecided: dict[int, bytes] = {}

    @property
    def keeps_clients(self) -> bool:
        """Whether goals may have to be cancelled yet."""
        return bool(self.undecided or self.goals.running())

    def told(self) -> None:
        """Send the status, as the server does not publish it again for a new opening."""
        if self._status and not self._status_sent:
            self._send_status()

    # --- calls, responses and messages

    def called(self, frame: CallFrame, call: PeersCall) -> None:
        goal = goal_of(frame.content)
        if goal is None:
            return
        if frame.lane == GET_RESULT:
            call.goal = goal
        elif frame.lane == SEND_GOAL:
            self.goals.asked(goal)
            self.undecided[call.number] = goal
            if len(self.undecided) > MOST_GOALS:
                del self.undecided[next(iter(self.undecided))]

    def takes(self, service: CalledService, response: Response, call: PeersCall | None) -> bool:
        """Read a response, and return whether it is to a cancel of this side's own."""
        if (cancel := self._cancels.pop((service.client, response.number), None)) is not None:
            if refuses_cancel(response.payload):
                self._may_go_on(cancel[0], "its server refuses that")
            return True
        if service.lane == SEND_GOAL and (goal := self.undecided.pop(response.number, b"")):
            self._decided(goal, response.payload)
        elif service.lane == GET_RESULT and call is not None and call.goal:
            self.goals.response(GET_RESULT, call.goal, response.payload)
        return False

    def _decided(self, goal: bytes, payload: bytes) -> None:
        """Take the server's answer to a goal."""
        self.goals.response(SEND_GOAL, goal, payload)
        # Again, because its server knew nothing of it when it got the first cancel.
        if accepted_by(payload) and self.goals.has_ended(goal):
            self._cancel((goal,))

    def published(self, lane: int, messages: Sequence[RawMessage]) -> Sequence[RawMessage]:
        for message in messages:
            self.goals.message(lane, message.payload)
        is_open = self._route.life.accepted
        if lane != STATUS:
            return messages if is_open else ()
        self._status, self._status_sent = messages[-1].payload, False
        if is_open:
            self._send_status()
        return ()

    def _send_status(self) -> None:
        self._status_sent = True
        self._outbox.put(CallFrame(What.MESSAGE, STATUS, 0, 0, self._status))

    def clients_changed(self) -> None:
        self.undecided.clear()  # else answers to other calls would be taken for answers to these

    def server_gone(self) -> None:
        super().server_gone()
        self.undecided.clear()

    def close(self) -> None:
        self._status_sent = False

    # --- cancels of this side's, once an arming ends (``on_end: cancel``)

    def disarm(self) -> None:
        if self.on_end == END_CANCEL:
            self._cancel(self.goals.end())

    def _cancel(self, goals: Iterable[bytes]) -> None:
        service = self._clients.services.get(CANCEL_GOAL)
        for goal in goals:
            if service is None:
                self._may_go_on(goal, "its server has gone")
            else:
                client = service.client
                self._cancels[client, goal] = goal, self._route.context.now()
                client.in_turn(goal, partial(self._send_cancel, client, goal))

    def _send_cancel(self, client: PacedClient, goal: bytes) -> None:
        self._cancels.pop((client, goal), None)
        try:
            self._cancels[client, client.call(cancel_request(goal))] = goal, self._route.context.now()
        except RosError as error:
            self._may_go_on(goal, str(error))

    def _may_go_on(self, goal: bytes, why: str) -> None:
        self._flow.failures.say(f"the robot may go on: goal {goal.hex()} is not cancelled: {why}")

    # --- time

    def act(self, now: float) -> None:
        """Report cancels without an answer, besides what is due in either half."""
        for call, (goal, asked_at) in tuple(self._cancels.items()):
            if asked_at < now - _CANCELLED_WITHIN:
                del self._cancels[call]
                self._may_go_on(goal, f"its server has not answered for {_CANCELLED_WITHIN:g} s")
        super().act(now)
