"""The providing half of an action: its server's answers outlive an interruption.

Goals go on while the link is down. The server is asked for the result of every goal as soon as it accepts the goal, and
what it answers is kept, so that it is there when the other side asks again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.calls import FEEDBACK, GET_RESULT, SEND_GOAL, STATUS, Refused
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.calls_route import frame_size
from rsb_bridge.route.calls.goals import Goals, accepted_by, goal_of, state_of, statuses_of
from rsb_bridge.route.calls.kept_calls import (
    INTERRUPTION,
    AnswerAction,
    KeptAnswers,
    Question,
    question_of,
    result_request,
)
from rsb_bridge.route.calls.providing import PeersCall, ProvidingRoute
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import RawMessage, Response
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose

_REFUSALS = {AnswerAction.REFUSE: Refused.NOT_ARRIVED, AnswerAction.LOSE: Refused.LOST}


class ProvidingAction(ProvidingRoute):
    """Has an action's server here answer."""

    takes: ClassVar[tuple[What, ...]] = (What.CALL, What.AGAIN)

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.goals = Goals(context.wall, context.now)
        self._answers = KeptAnswers()
        self._interrupted_at: float | None = None
        self._status = b""  # the server's last
        self._status_told = False  # to the other side, in the present opening

    # --- setting up

    def advance(self) -> None:
        """See who provides it, and ask and tell what an interruption has left."""
        had_server, opened = bool(self._provision.entries), dict(self._clients.types)
        super().advance()
        if not self.accepted:
            return
        if self._clients.types != opened:
            self._answers.clients_closed()
        if had_server and not self._provision.entries:
            self.goals.server_gone()

    def _tell(self) -> None:
        super()._tell()
        if not self.accepted:
            return
        if self._status and not self._status_told:  # the server does not publish it again for the new opening
            self._send_status()
        if self._clients.ready:
            self._interrupted_at = None
            for question in self._answers.to_ask(self._present):
                self._ask_result(question)

    def _no_clients(self, error: RosError) -> None:
        super()._no_clients(error)
        self._answers.clients_closed()

    def _close_clients(self) -> None:
        """Go on listening to the server as long as it owes something."""
        if not self._answers.under_way and not self.goals.running():
            self._clients.close()

    def close(self, reason: str) -> None:
        """End the opening; what the server was asked goes on."""
        super().close(reason)
        self._status_told = False

    def destroy(self) -> None:
        """End it for good."""
        super().destroy()
        self._clients.close()

    def _give_up_all(self, why: str) -> None:
        super()._give_up_all(why)
        if self._interrupted_at is None:
            now = self._interrupted_at = self.context.now()
            self._answers.interrupted(now)

    # --- calls

    def _refusal(self, frame: CallFrame) -> Refused | None:
        why = super()._refusal(frame)
        needs_no_server = frame.what is What.AGAIN or frame.lane == GET_RESULT
        if why is not Refused.PROVIDER_GONE or not needs_no_server:
            return why
        if not self._answers.has_answer(question_of(frame.lane, frame.content)):
            return why
        return self.peer.budget.provided.take(frame_size(frame.content), self.context.now())

    def _is_limited(self, frame: CallFrame) -> bool:
        if frame.what is What.AGAIN and question_of(frame.lane, frame.content) is not None:
            return False  # the server is not asked for a goal by that
        return super()._is_limited(frame)

    def _take_call(self, frame: CallFrame) -> None:
        question, again = question_of(frame.lane, frame.content), frame.what is What.AGAIN
        if question is None:
            super()._take_call(frame)
            return
        do = self._answers.take(question, frame.call, again=again)
        if do is AnswerAction.ASK and frame.lane == GET_RESULT:
            self._wait(frame)
            self._ask_result(question, frame.call)
        elif do is AnswerAction.ASK:
            super()._take_call(frame)
            if (call := self._under_way.get(frame.call)) is not None:
                self._answers.asked(question, call.number, frozenset(self._present))
                self._note_goal(frame)
        elif do in _REFUSALS:
            self.peer.budget.provided.give(frame_size(frame.content))
            self._refuse_peer(frame, _REFUSALS[do])
        else:
            self._wait(frame)
            if do is AnswerAction.ANSWER:
                self._answer_peer(frame.call, self._answers.answer(question))

    def _wait(self, frame: CallFrame) -> None:
        """A call waits for an answer to what the server has been asked already."""
        call = PeersCall(frame.lane, frame_size(frame.content), self.context.now(), 0, self._present)
        self._under_way.add(frame.call, call, self.timeout_of(frame.lane))

    def _note_goal(self, frame: CallFrame) -> None:
        if frame.lane == SEND_GOAL and (goal := goal_of(frame.content)) is not None:
            self.goals.asked(goal)

    def _want_result(self, goal: bytes) -> None:
        """Ask for a result now, as nobody knows how long the link will be there."""
        question = Question(GET_RESULT, goal)
        if question not in self._answers and GET_RESULT in self._clients.clients:
            self._ask_result(question)

    def _ask_result(self, question: Question, *calls: int) -> None:
        """Ask the server for a result; its answer is kept, and sent to the calls that wait for it."""
        try:
            number = self._clients.clients[GET_RESULT].call(result_request(question.about))
        except RosError as error:
            for call in calls:
                self._give_up(call, Refused.NOT_SENT)
            self._failed(f"a result could not be asked for: {error}")
            return
        self._answers.asked(question, number, frozenset(self._present), *calls)

    def _take_response(self, lane: int, response: Response) -> None:
        linked = self._interrupted_at is None
        answered = self._answers.answered(lane, response.number, response.payload, self.context.now(), linked=linked)
        if answered is None or (lane, response.number) in self._by_number:
            super()._take_response(lane, response)
        if answered is None:
            return
        question, calls = answered
        for call in calls:
            self._answer_peer(call, response.payload)
        if lane == SEND_GOAL and (accepted := accepted_by(response.payload)) is not None:
            self.goals.answered(question.about, accepted=accepted)
            if accepted:
                self._want_result(question.about)
        elif lane == GET_RESULT and (state := state_of(response.payload)) is not None:
            self.goals.result(question.about, state)

    def _is_over(self, peers: int) -> None:
        super()._is_over(peers)
        self._answers.is_over(peers, self.context.now())

    def _is_orphan(self, call: PeersCall) -> bool:
        """Whether nobody can answer it: whoever serves the action next is asked for results."""
        return call.lane != GET_RESULT and super()._is_orphan(call)

    def _give_up(self, peers: int, why: Refused) -> None:
        if (call := self._under_way.get(peers)) is not None:
            self._answers.gave_up(call.lane, call.number, self.context.now())
        super()._give_up(peers, why)

    def _expired(self, number: int, call: PeersCall) -> None:
        self._answers.gave_up(call.lane, call.number, self.context.now())
        super()._expired(number, call)

    def _give_up_results(self) -> None:
        """Of goals that have been over for as long as other calls may take: the other side has given them up, too."""
        for goal, calls in self._answers.results_awaited():
            over_for = self.goals.over_for(goal) if calls else None
            if over_for is None or over_for <= self.call_timeout:
                continue
            for number in calls:
                if (call := self._under_way.end(number)) is not None:
                    self._expired(number, call)

    # --- messages

    def _published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        if lane == STATUS:
            self._status, self._status_told = messages[-1].payload, False
        for message in messages:
            if lane == STATUS and (statuses := statuses_of(message.payload)) is not None:
                self.goals.listed(statuses)
            elif lane == FEEDBACK and (goal := goal_of(message.payload)) is not None:
                self.goals.feedback(goal)
        if not self.accepted:
            return
        if lane == STATUS:
            self._send_status()
        else:
            super()._published(lane, messages)

    def _send_status(self) -> None:
        self._status_told = True
        self._send(CallFrame(What.MESSAGE, STATUS, 0, 0, self._status))
        self.flush()

    # --- time

    def tick(self) -> None:
        """Once a second: forget what nobody has asked for."""
        now = self.context.now()
        self._answers.expire(now)
        if self._interrupted_at is not None and not (self.accepted and self._provision.entries):
            if now >= self._interrupted_at + INTERRUPTION:
                self._clients.close()
                self._answers.clients_closed()
            else:
                self._close_clients()
        self._give_up_results()
        super().tick()

    # --- how it is

    def snapshot(self) -> RouteSnapshot:
        return replace(super().snapshot(), goals=self.goals.snapshot(self._answers.awaited()))
