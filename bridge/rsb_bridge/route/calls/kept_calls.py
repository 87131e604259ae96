"""An action's calls and answers that outlive an interruption of the link.

When the link drops, a service's pending call is given up: the node may have received it, and must not receive it twice.
An action's call names its goal by an id. The callers' side keeps it, and sends it again once the action can be reached:
cancels first, then goals, then requests for results. The providing side recognizes the id, and answers from what the
server has answered meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, Refused
from rsb_bridge.route.calls.goals import STATES, cancel_of, goal_of, state_of

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

INTERRUPTION = 3600.0
"""s for which a call outlives an interruption at most, and its answer on the other side. A round figure."""
MOST_CALLS = 256
"""Calls of one action that wait. A round figure that bounds memory, as the three others here."""
MOST_BYTES = 8 << 20
"""Bytes of the kept calls' requests."""

_FIRST = (CANCEL_GOAL, SEND_GOAL, GET_RESULT)
MOST_KEPT = 512
"""Questions that are remembered, answered or not."""
MOST_ANSWER_BYTES = 16 << 20
"""Bytes of the kept answers."""
SENT_KEPT = 60.0
"""s for which an answer is kept after it was sent, as a link may notice late that nothing arrives. A round
figure."""
_LITTLE_ENDIAN = b"\0\1\0\0"


class KeptCall(NamedTuple):
    """A call that can be sent again.

    Attributes:
        lane: of a service of the action.
        caller: for `rsb_bridge.ros.ros_interface.ServiceServer.answer`.
        asked: when the caller asked, in s.
        again: whether it was sent before.
        instance: the peer's process that it was sent to, or empty if it was not sent.
    """

    lane: int
    caller: bytes
    payload: bytes
    asked: float
    again: bool
    instance: str = ""


class KeptCalls:
    """The calls of one callers' half that wait for the end of an interruption.

    Args:
        timeout: s that a call without a goal waits: a late "cancel all goals" would end goals that came after it.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._calls: dict[bytes, tuple[KeptCall, float]] = {}  # by caller, oldest first; until when
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._calls)

    def keep(self, call: KeptCall, now: float) -> bool:
        """Keep a call. Return False if it must not outlive an interruption, or too many are kept."""
        until = self._until(call, now)
        if until <= now or call.caller in self._calls:
            return False
        if len(self._calls) >= MOST_CALLS or self._bytes + len(call.payload) > MOST_BYTES:
            return False
        self._calls[call.caller] = (call, until)
        self._bytes += len(call.payload)
        return True

    def _until(self, call: KeptCall, now: float) -> float:
        if call.lane == CANCEL_GOAL:
            cancel = cancel_of(call.payload)
            return now + INTERRUPTION if cancel is not None and cancel.goal is not None else call.asked + self.timeout
        begins_late = call.lane == SEND_GOAL and not call.again  # a goal that was never sent must not
        return now if begins_late or goal_of(call.payload) is None else now + INTERRUPTION

    def requests(self, lane: int) -> list[bytes]:
        """Return the requests of a lane's calls."""
        return [call.payload for call, _ in self._calls.values() if call.lane == lane]

    def expire(self, now: float) -> list[KeptCall]:
        """Remove and return the calls that have waited too long."""
        over = [call for call, until in self._calls.values() if until <= now]
        for call in over:
            del self._calls[call.caller]
            self._bytes -= len(call.payload)
        return over

    def release(self) -> list[KeptCall]:
        """Remove and return all calls, in the order in which to send them."""
        calls = [call for call, _ in self._calls.values()]
        self._calls.clear()
        self._bytes = 0
        return sorted(calls, key=lambda call: _FIRST.index(call.lane))


class AnswerAction(Enum):
    """The decision on a call that is neither refused nor answered at once."""

    ASK = auto()
    """Ask the server."""
    WAIT = auto()
    """Wait for the answer to an earlier call with the same question."""


class CallIdentity(NamedTuple):
    """Identifies calls with the same meaning.

    Attributes:
        lane: of a service of the action.
        about: the goal's id, or the whole content of a cancel.
    """

    lane: int
    about: bytes


@dataclass(slots=True)
class Kept:
    """A question to the server, and its answer.

    Attributes:
        number: of the client's call here, or 0 if no answer to that call can come any more.
        servers: ids of the servers that were there when the question was asked.
        calls: numbers of the peer's calls, in the present opening, that wait for the answer.
        answer: the serialized response, or None until it comes.
        until: when it is forgotten, in s, or None to keep it until its answer comes.
    """

    number: int
    servers: AbstractSet[bytes]
    calls: list[int] = field(default_factory=list)
    answer: bytes | None = None
    until: float | None = None


def question_of(lane: int, payload: bytes) -> CallIdentity | None:
    """Return the question that a request asks, or None if it cannot be recognized later."""
    if lane == CANCEL_GOAL:
        cancel = cancel_of(payload)
        return CallIdentity(lane, cancel.request) if cancel is not None else None
    goal = goal_of(payload) if lane in (SEND_GOAL, GET_RESULT) else None
    return CallIdentity(lane, goal) if goal is not None else None


def result_request(goal: bytes) -> bytes:
    """Return a get_result request."""
    return _LITTLE_ENDIAN + goal


class KeptAnswers:
    """The recent questions to one action's server, and its answers.

    A question stays open when the link drops. Its answer, above all a result, is kept until the other side asks again.
    Action servers forget results (rcl_action: by default 10 s after the goal): a longer outage would lose them.
    """

    def __init__(self) -> None:
        self._kept: dict[CallIdentity, Kept] = {}  # oldest first
        self._by_number: dict[tuple[int, int], CallIdentity] = {}
        self._waiting: dict[int, CallIdentity] = {}  # by call; each of these calls is in `Kept.calls`
        self._bytes = 0
        self._looked = 0.0  # s, when it was looked for old questions
        self._forgot_at = float("-inf")  # s, when a question was forgotten too early, because there was no room

    def __contains__(self, question: CallIdentity) -> bool:
        return question in self._kept

    @property
    def under_way(self) -> bool:
        """Whether the server owes an answer."""
        return any(kept.answer is None for kept in self._kept.values())

    def answer(self, question: CallIdentity) -> bytes | None:
        """Return the kept answer to a question, or None."""
        kept = self._kept.get(question)
        return kept.answer if kept is not None else None

    def decide(self, question: CallIdentity, call: int, *, again: bool) -> AnswerAction | bytes | Refused:
        """Decide how to handle a call, or return its answer, or why to refuse it.

        A result does not change, so that one answer serves all calls for it. Other calls go to the server, unless the
        call was sent to it before. A goal that never arrived must not begin late, and one that may have arrived must
        not begin twice.

        Args:
            question: the question of the call.
            call: its number in the present opening; it is noted if the decision is `WAIT`.
            again: whether the call was sent in an earlier opening.
        """
        kept = self._kept.get(question)
        if kept is None and again and question.lane == SEND_GOAL:
            # The question may have been among those forgotten too early. It would have been kept for so long at most.
            lately = self._looked - self._forgot_at <= INTERRUPTION + 2 * SENT_KEPT
            return Refused.LOST if lately else Refused.NOT_ARRIVED
        if kept is None:
            return AnswerAction.ASK
        if not again and question.lane != GET_RESULT:
            return AnswerAction.ASK
        if kept.answer is not None:
            return kept.answer
        if not kept.number and question.lane == SEND_GOAL:
            return Refused.LOST
        kept.calls.append(call)
        self._waiting[call] = question
        kept.until = None
        return AnswerAction.WAIT

    def asked(self, question: CallIdentity, number: int, servers: AbstractSet[bytes], *calls: int) -> None:
        """Note that the server was asked, under the client's number, and the calls that wait for its answer.

        The number is 0 for a result that is asked for later.
        """
        kept = self._kept.get(question)
        if kept is not None and question.lane == SEND_GOAL:
            return  # another goal with the same id, which the server refuses: the answer to the first one is kept
        if kept is None or question.lane != GET_RESULT:
            waiting = kept.calls if kept is not None else []
            self._forget(question)
            kept = self._kept[question] = Kept(0, servers, waiting)
        self._by_number.pop((question.lane, kept.number), None)
        kept.number, kept.servers = number, servers
        kept.calls += calls
        self._waiting.update(dict.fromkeys(kept.calls, question))
        if number:
            self._by_number[question.lane, number] = question
        if len(self._kept) > MOST_KEPT:
            self._forget_one()

    def answered(
        self, lane: int, number: int, answer: bytes, now: float, *, linked: bool
    ) -> tuple[CallIdentity, list[int]] | None:
        """Keep an answer of the server.

        Returns:
            The question and the calls that waited for it, or None if the question is not kept.
        """
        question = self._by_number.pop((lane, number), None)
        if question is None:
            return None
        kept = self._kept[question]
        calls, kept.calls, kept.number = kept.calls, [], 0
        for call in calls:
            self._waiting.pop(call, None)
        if (lane == GET_RESULT and state_of(answer) in (None, STATES[0])) or len(answer) > MOST_ANSWER_BYTES:
            self._forget(question)  # a goal that the server does not know may still come
            return question, calls
        kept.answer, kept.until = answer, now + (SENT_KEPT if linked else INTERRUPTION)
        self._bytes += len(answer)
        while self._bytes > MOST_ANSWER_BYTES:
            self._forget_one()
        return question, calls

    def is_over(self, call: int, now: float) -> None:
        """Note that a call has ended."""
        if (question := self._waiting.pop(call, None)) is not None:
            self._kept[question].calls.remove(call)
            self._forget_soon(question, now)

    def gave_up(self, lane: int, number: int, now: float) -> None:
        """Note that the call that asked the server has ended without an answer."""
        if (question := self._by_number.get((lane, number))) is not None:
            self._forget_soon(question, now)

    def _forget_soon(self, question: CallIdentity, now: float) -> None:
        """Forget an unanswered question after a while if no call waits for it, but no result: a goal may take days."""
        kept = self._kept[question]
        if question.lane != GET_RESULT and kept.answer is None and not kept.calls:
            kept.until = now + SENT_KEPT

    def awaited(self) -> dict[bytes, list[int]]:
        """Return the other side's calls that wait for results, by goal."""
        return {goal: [*kept.calls] for (lane, goal), kept in self._kept.items() if lane == GET_RESULT and kept.calls}

    def interrupted(self, now: float) -> None:
        """Keep every question and answer for longer: answers that were sent may not have arrived."""
        for kept in self._kept.values():
            kept.until = now + INTERRUPTION + SENT_KEPT  # longer than the other side keeps its question

    def clients_closed(self) -> None:
        """Give up open questions. Results can be asked for again; the fate of goals is unknown."""
        self._by_number.clear()
        for question, kept in list(self._kept.items()):
            if kept.answer is not None:
                continue
            kept.number = 0  # a goal may have come to the server, and must not go there again
            if question.lane == CANCEL_GOAL:
                self._forget(question)

    def to_ask(self, servers: AbstractSet[bytes]) -> list[CallIdentity]:
        """Return the results to ask these servers for, because the servers that were asked have gone."""
        return [
            question
            for question, kept in self._kept.items()
            if question.lane == GET_RESULT
            and kept.answer is None
            and (kept.number == 0 or kept.servers.isdisjoint(servers))
        ]

    def expire(self, now: float) -> None:
        """Forget old questions. Called once a second."""
        self._looked = now
        for question, kept in list(self._kept.items()):
            if kept.until is not None and kept.until <= now:
                self._forget(question)

    def _forget_one(self) -> None:
        """Forget the oldest question, answered ones first. If calls wait for it, the link's bounds on calls apply."""
        answered = (each for each, kept in self._kept.items() if kept.answer is not None)
        idle = (each for each, kept in self._kept.items() if not kept.calls)
        oldest = next(answered, None) or next(idle, None)
        if oldest is not None:
            self._forgot_at = self._looked
            self._forget(oldest)

    def _forget(self, question: CallIdentity) -> None:
        kept = self._kept.pop(question, None)
        if kept is not None:
            self._by_number.pop((question.lane, kept.number), None)
            self._bytes -= len(kept.answer or b"")
            for call in kept.calls:
                self._waiting.pop(call, None)
