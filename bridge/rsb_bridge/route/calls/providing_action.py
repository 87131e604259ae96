"""The providing half of an action's route: its goals, and its server's answers, which outlive an interruption.

Goals go on while the link is down. The server is asked for the result of every goal as soon as it accepts the goal, and
its answers are kept, so that they are there when the other side asks again (`rsb_bridge.route.calls.kept_calls`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.by_hand import END_CANCEL, END_NONE, more_careful_end
from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, STATUS, Refused
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.goals import Goals, accepted_by, cancel_request, refuses_cancel
from rsb_bridge.route.calls.kept_calls import (
    INTERRUPTION,
    AnswerAction,
    CallIdentity,
    KeptAnswers,
    question_of,
    result_request,
)
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
        answers: what the server was asked, and answered.
        interrupted_at: when the interruption began (s), or None while the action can be reached.
    """

    never_idle: ClassVar[bool] = True  # as of the other half
    come_as: ClassVar[tuple[What, ...]] = (What.CALL, What.AGAIN)

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.goals = Goals(context.wall)
        self.answers = KeptAnswers()
        self.interrupted_at: float | None = None
        self._status = b""  # the server's last one
        self._status_sent = False  # in the present opening
        # Goals that are being cancelled, and since when (s), by the cancel's number, or by goal before its turn.
        # Also by client, as another one numbers from the start.
        self._cancels: dict[tuple[PacedClient, int | bytes], tuple[bytes, float]] = {}

    @property
    def on_end(self) -> str:
        return more_careful_end((self.arming.own.on_end, self.arming.peer_on_end, END_NONE))

    def snapshot(self) -> RouteSnapshot:
        return replace(super().snapshot(), goals=self.goals.snapshot(self.answers.awaited().keys()))

    # --- setting up

    def _advance(self) -> None:
        had_server, opened = bool(self._provision.entries), dict(self._clients.services)
        super()._advance()
        if not self.life.accepted:
            return
        # New clients number their calls from the start: their answers would be taken for answers to earlier questions.
        if self._clients.services != opened:
            self.answers.clients_closed()
        if had_server and not self._provision.entries:
            self.goals.server_gone()

    def _tell(self) -> None:
        super()._tell()
        if not self.life.accepted:
            return
        if self._status and not self._status_sent:  # the server does not publish it again for the new opening
            self._send_status()
        if self._is_ready:
            self.interrupted_at = None
            for question in self.answers.to_ask(self._present):
                self._ask_result(question)

    def endpoint_failed(self, error: RosError) -> None:
        super().endpoint_failed(error)
        self.answers.clients_closed()

    def _close_clients(self) -> None:
        if not (self.answers.under_way or self.goals.running()):  # the server owes no answer
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
        """Answer a call from the kept answers, have it wait for one, refuse it, or ask the server."""
        question = question_of(frame.lane, frame.content)
        if question is None:
            super()._pass_on(frame, call)
            return
        todo = self.answers.decide(question, frame.call, again=frame.what is What.AGAIN)
        if isinstance(todo, Refused):
            self._give_up(frame.call, todo)
        elif isinstance(todo, bytes):
            self._answer(frame.call, todo)
        elif todo is AnswerAction.ASK and frame.lane == GET_RESULT:
            self._ask_result(question, frame.call)
        elif todo is AnswerAction.ASK:
            super()._pass_on(frame, call)

    def _call(self, frame: CallFrame, call: PeersCall) -> None:
        super()._call(frame, call)
        if call.number and (question := question_of(frame.lane, frame.content)) is not None:
            self.answers.asked(question, call.number, frozenset(self._present))
            if frame.lane == SEND_GOAL:
                self.goals.asked(question.about)

    def _is_limited(self, frame: CallFrame) -> bool:
        """Return whether arming, pauses and limits apply to a call: not if it only asks about a goal again."""
        # A call whose goal's id cannot be read may begin a goal.
        asks_again = frame.what is What.AGAIN and question_of(frame.lane, frame.content) is not None
        return super()._is_limited(frame) and not asks_again

    def _is_answered(self, frame: CallFrame) -> bool:
        if frame.what is not What.AGAIN and frame.lane != GET_RESULT:
            return False
        question = question_of(frame.lane, frame.content)
        return question is not None and self.answers.answer(question) is not None

    def _ask_result(self, question: CallIdentity, *calls: int) -> None:
        """Ask the server for a result in its turn; its answer is kept, and sent to the calls that wait for it."""
        client = self._clients.services[GET_RESULT].client
        self.answers.asked(question, 0, frozenset(self._present), *calls)
        if question not in client.waiting:
            client.in_turn(question, partial(self._send_result_request, question))

    def _send_result_request(self, question: CallIdentity) -> None:
        if question not in self.answers:
            return  # it was forgotten
        try:
            number = self._clients.services[GET_RESULT].client.call(result_request(question.about))
        except RosError as error:
            for call in self.answers.awaited().get(question.about, ()):
                self._give_up(call, Refused.NOT_SENT)
            self.failures.say(f"a result could not be asked for: {error}")
        else:
            self.answers.asked(question, number, frozenset(self._present))

    # --- answers

    def _take_response(self, service: CalledService, response: Response) -> None:
        # An answer to one of this side's cancels, and to no call of the other side's.
        if (cancel := self._cancels.pop((service.client, response.number), None)) is not None:
            if refuses_cancel(response.payload):
                self._may_go_on(cancel[0], "its server refuses that")
            return
        lane, number, payload, linked = service.lane, response.number, response.payload, self.interrupted_at is None
        answered = self.answers.answered(lane, number, payload, self.context.now(), linked=linked)
        if answered is None:  # its question is not kept
            super()._take_response(service, response)
            return
        question, calls = answered
        if (lane, number) in self._by_number:
            super()._take_response(service, response)
        for call in calls:
            self._answer(call, payload)
        self.goals.response(lane, question.about, payload)
        if lane != SEND_GOAL or not accepted_by(payload):
            return
        # Again, because its server knew nothing of it when it got the first cancel.
        if self.goals.has_ended(question.about):
            self._cancel((question.about,))
        # The result is asked for at once, because the link may be lost at any time.
        result = CallIdentity(GET_RESULT, question.about)
        if result not in self.answers and GET_RESULT in self._clients.services:
            self._ask_result(result)

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
        self.answers.is_over(peers, self.context.now())

    def _expired(self, number: int, call: PeersCall) -> None:
        self.answers.gave_up(call.lane, call.number, self.context.now())
        super()._expired(number, call)

    def _give_up(self, peers: int, why: Refused) -> None:
        if (call := self._pending.get(peers)) is not None:
            self.answers.gave_up(call.lane, call.number, self.context.now())
        super()._give_up(peers, why)

    def _is_orphan(self, call: PeersCall) -> bool:
        return call.lane != GET_RESULT and super()._is_orphan(call)  # the next server is asked for results

    def _give_up_all(self, why: str) -> None:
        super()._give_up_all(why)
        if self.interrupted_at is None:
            now = self.interrupted_at = self.context.now()
            self.answers.interrupted(now)

    def tick(self) -> None:
        now = self.context.now()
        for call, (goal, asked_at) in tuple(self._cancels.items()):
            if asked_at < now - _CANCELLED_WITHIN:
                del self._cancels[call]
                self._may_go_on(goal, f"its server has not answered for {_CANCELLED_WITHIN:g} s")
        self.answers.expire(now)
        if self.interrupted_at is not None and not (self.life.accepted and self._provision.entries):
            if now >= self.interrupted_at + INTERRUPTION:
                self._clients.close()
                self.answers.clients_closed()
            else:
                self._close_clients()
        # Once a goal is over, a request for its result may take as long as other calls.
        for goal, calls in self.answers.awaited().items():
            for number in calls if self.goals.is_over(goal) else ():
                self._pending.limit(number, self.call_timeout)
        super().tick()
