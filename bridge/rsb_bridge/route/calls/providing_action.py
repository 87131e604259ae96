"""The providing half of an action's route: its goals, and their results, which outlive an interruption.

Goals go on while the link is down. The server is asked for the result of every goal as soon as it accepts the goal, and
results are kept, so that they are there when the other side asks again (`rsb_bridge.route.calls.kept_calls`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.by_hand import END_CANCEL, END_NONE, more_careful_end
from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, STATUS, Refused
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.goals import Goals, accepted_by, cancel_request, goal_of, refuses_cancel
from rsb_bridge.route.calls.kept_calls import INTERRUPTION, MOST_RESULTS, KeptResults, result_request
from rsb_bridge.route.calls.providing import PeersCall, ProvidingRoute
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import RawMessage, Response
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.calls.paced_client import PacedClient
    from rsb_bridge.route.calls.providing import CalledService
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose

_CANCELLED_WITHIN = 5.0  # s. A round figure: an operator has to hear soon that a robot may go on


class ProvidingActionRoute(ProvidingRoute):
    """Tells the peer of an action here, and passes its calls on.

    Attributes:
        goals: all that are known.
        results: of the goals.
        undecided: goals that the server has neither accepted nor rejected, by the client's number.
        interrupted_at: when the interruption began (s), or None while the action can be reached.
    """

    never_idle: ClassVar[bool] = True  # as of the other half

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.goals = Goals(context.wall)
        self.results = KeptResults()
        self.interrupted_at: float | None = None
        self._status = b""  # the server's last one
        self._status_sent = False  # in the present opening
        # Goals that are being cancelled, and since when (s), by the cancel's number, or by goal before its turn.
        # Also by client, as another one numbers from the start.
        self._cancels: dict[tuple[PacedClient, int | bytes], tuple[bytes, float]] = {}
        self.undecided: dict[int, bytes] = {}

    @property
    def on_end(self) -> str:
        return more_careful_end((self.arming.own.on_end, self.arming.peer_on_end, END_NONE))

    def snapshot(self) -> RouteSnapshot:
        return replace(super().snapshot(), goals=self.goals.snapshot(self.results.awaited().keys()))

    # --- setting up

    def _advance(self) -> None:
        had_server, opened = bool(self._provision.entries), dict(self._clients.services)
        super()._advance()
        if not self.life.accepted:
            return
        # New clients number their calls from the start: their answers would be taken for answers to earlier questions.
        if self._clients.services != opened:
            self._clients_closed()
        if had_server and not self._provision.entries:
            self.goals.server_gone()
            self.undecided.clear()

    def _tell(self) -> None:
        super()._tell()
        if not self.life.accepted:
            return
        if self._status and not self._status_sent:  # the server does not publish it again for the new opening
            self._send_status()
        if self._is_ready:
            self.interrupted_at = None
            for goal in self.results.to_ask(self._present):
                self._ask_result(goal)

    def endpoint_failed(self, error: RosError) -> None:
        super().endpoint_failed(error)
        self._clients_closed()

    def _clients_closed(self) -> None:
        self.results.clients_closed()
        self.undecided.clear()

    def _close_clients(self) -> None:
        if not (self.undecided or self.results.under_way or self.goals.running()):  # the server owes no answer
            super()._close_clients()

    def close(self, reason: str) -> None:
        """End the opening; pending calls are lost, but the server goes on answering."""
        super().close(reason)
        self._status_sent = False

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        # First: what follows may close the clients.
        if self.on_end == END_CANCEL:
            self._cancel(self.goals.end())
        super().disarm(why, reason)

    # --- cancels of this side's, once an arming ends (``on_end: cancel``)

    def _cancel(self, goals: Iterable[bytes]) -> None:
        service = self._clients.services.get(CANCEL_GOAL)
        for goal in goals:
            if service is None:
                self._may_go_on(goal, "its server has gone")
            else:
                client = service.client
                self._cancels[client, goal] = goal, self.context.now()
                client.in_turn(goal, partial(self._send_cancel, client, goal))

    def _send_cancel(self, client: PacedClient, goal: bytes) -> None:
        self._cancels.pop((client, goal), None)
        try:
            self._cancels[client, client.call(cancel_request(goal))] = goal, self.context.now()
        except RosError as error:
            self._may_go_on(goal, str(error))

    def _may_go_on(self, goal: bytes, why: str) -> None:
        self.failures.say(f"the robot may go on: goal {goal.hex()} is not cancelled: {why}")

    # --- calls

    def _pass_on(self, frame: CallFrame, call: PeersCall) -> None:
        """Answer a request for a result that is kept or awaited; anything else asks the server."""
        goal = goal_of(frame.content) if frame.lane == GET_RESULT else None
        if goal is None:
            super()._pass_on(frame, call)
        elif (answer := self.results.answer(goal)) is not None:
            self._answer(frame.call, answer)
        elif goal in self.results:
            self.results.wait(goal, frame.call)
        else:
            self._ask_result(goal, frame.call)

    def _call(self, frame: CallFrame, call: PeersCall) -> None:
        super()._call(frame, call)
        if call.number and frame.lane == SEND_GOAL and (goal := goal_of(frame.content)) is not None:
            self.goals.asked(goal)
            self.undecided[call.number] = goal
            if len(self.undecided) > MOST_RESULTS:
                del self.undecided[next(iter(self.undecided))]

    def _is_answered(self, frame: CallFrame) -> bool:
        goal = goal_of(frame.content) if frame.lane == GET_RESULT else None
        return goal is not None and self.results.answer(goal) is not None

    def _ask_result(self, goal: bytes, *calls: int) -> None:
        """Ask the server for a result in its turn; its answer is kept, and sent to the calls that wait for it."""
        client = self._clients.services[GET_RESULT].client
        self.results.asked(goal, 0, frozenset(self._present), *calls)
        if goal not in client.waiting:
            client.in_turn(goal, partial(self._send_result_request, goal))

    def _send_result_request(self, goal: bytes) -> None:
        if goal not in self.results:
            return  # it was forgotten
        try:
            number = self._clients.services[GET_RESULT].client.call(result_request(goal))
        except RosError as error:
            for call in self.results.awaited().get(goal, ()):
                self._give_up(call, Refused.NOT_SENT)
            self.failures.say(f"a result could not be asked for: {error}")
        else:
            self.results.asked(goal, number, frozenset(self._present))

    # --- answers

    def _take_response(self, service: CalledService, response: Response) -> None:
        # An answer to one of this side's cancels, and to no call of the other side's.
        if (cancel := self._cancels.pop((service.client, response.number), None)) is not None:
            if refuses_cancel(response.payload):
                self._may_go_on(cancel[0], "its server refuses that")
            return
        payload, now = response.payload, self.context.now()
        if service.lane == GET_RESULT and (found := self.results.answered(response.number, payload, now)) is not None:
            goal, calls = found
            for call in calls:
                self._answer(call, payload)
            self.goals.response(GET_RESULT, goal, payload)
            return
        super()._take_response(service, response)
        if service.lane == SEND_GOAL and (goal := self.undecided.pop(response.number, b"")):
            self._decided(goal, payload)

    def _decided(self, goal: bytes, payload: bytes) -> None:
        """Take the server's answer to a goal."""
        self.goals.response(SEND_GOAL, goal, payload)
        if not accepted_by(payload):
            return
        # Again, because its server knew nothing of it when it got the first cancel.
        if self.goals.has_ended(goal):
            self._cancel((goal,))
        # The result is asked for at once, because the link may be lost at any time.
        if goal not in self.results and GET_RESULT in self._clients.services:
            self._ask_result(goal)

    def published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Read the server's feedback or status, and send it."""
        if lane == STATUS:
            self._status, self._status_sent = messages[-1].payload, False
        for message in messages:
            self.goals.message(lane, message.payload)
        if self.life.accepted and lane == STATUS:
            self._send_status()
        elif self.life.accepted:
            super().published(lane, messages)

    def _send_status(self) -> None:
        self._status_sent = True
        self._outbox.put(CallFrame(What.MESSAGE, STATUS, 0, 0, self._status))
        self.flush()

    # --- calls without an answer

    def _ended(self, peers: int) -> None:
        super()._ended(peers)
        self.results.is_over(peers)

    def _is_orphan(self, call: PeersCall) -> bool:
        return call.lane != GET_RESULT and super()._is_orphan(call)  # the next server is asked for results

    def _give_up_all(self, why: str) -> None:
        super()._give_up_all(why)
        if self.interrupted_at is None:
            self.interrupted_at = self.context.now()

    def tick(self) -> None:
        now = self.context.now()
        for call, (goal, asked_at) in tuple(self._cancels.items()):
            if asked_at < now - _CANCELLED_WITHIN:
                del self._cancels[call]
                self._may_go_on(goal, f"its server has not answered for {_CANCELLED_WITHIN:g} s")
        self.results.expire(now)
        if self.interrupted_at is not None and not (self.life.accepted and self._provision.entries):
            if now >= self.interrupted_at + INTERRUPTION:
                self._clients.close()
                self._clients_closed()
            else:
                self._close_clients()
        # Once a goal is over, a request for its result may take as long as other calls.
        for goal, calls in self.results.awaited().items():
            for number in calls if self.goals.is_over(goal) else ():
                self._pending.limit(number, self.call_timeout)
        super().tick()
