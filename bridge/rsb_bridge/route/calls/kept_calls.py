"""The calls of an action that outlive an interruption, on the callers' side, and their answers, on the providing side.

A service's call that is under way when the link drops is given up: nobody knows whether the node has got it, and it
must not get it twice. An action's calls are about a goal that has an id, so they are asked about again by that id once
the action can be reached again: cancels first, then what became of goals that were under way, then results.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from rsb_bridge.route.calls.goals import STATES, cancel_of, goal_of, state_of

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

INTERRUPTION = 3600.0
"""s: how long a call outlives an interruption at most, and its answer on the other side."""
MOST_CALLS = 256
MOST_BYTES = 8 << 20
"""Of their requests."""

_FIRST = (CANCEL_GOAL, SEND_GOAL, GET_RESULT)
MOST_KEPT = 512
"""Questions that are remembered, with an answer and without."""
MOST_ANSWER_BYTES = 16 << 20
"""Of their answers."""
SENT_KEPT = 60.0
"""s: how long an answer is kept after it was sent. A link may take some of it to notice that nothing arrives."""
_LITTLE_ENDIAN = b"\0\1\0\0"


class KeptCall(NamedTuple):
    """One of them.

    Attributes:
        lane: of an action's, a service.
        caller: for `rsb_bridge.ros.ros_interface.ServiceServer.answer`.
        payload: the serialized request.
        asked: s, when the caller asked.
        again: it has been under way before.
        instance: of the peer's process that it was sent to; empty: it has not been.
        stamp: ns, from which its age counts, or 0 if that is not limited.
    """

    lane: int
    caller: bytes
    payload: bytes
    asked: float
    again: bool
    instance: str = ""
    stamp: int = 0


class KeptCalls:
    """The calls of one callers' half that wait for the end of an interruption.

    Args:
        timeout: s that a call which names no goal waits: a late "cancel all goals" would end goals that came after it.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._calls: OrderedDict[bytes, tuple[KeptCall, float]] = OrderedDict()  # by caller; until when
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._calls)

    def keep(self, call: KeptCall, now: float) -> bool:
        """Keep a call; False: it does not outlive an interruption, or there are too many."""
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
        if goal_of(call.payload) is None:
            return now
        if call.lane == SEND_GOAL:  # one that has not been under way must not begin late
            return now + INTERRUPTION if call.again else now
        return now + INTERRUPTION if call.lane == GET_RESULT else now

    def requests(self, lane: int) -> list[bytes]:
        """What the calls of a lane ask."""
        return [call.payload for call, _ in self._calls.values() if call.lane == lane]

    def expire(self, now: float) -> list[KeptCall]:
        """Those that have waited too long, which wait no longer."""
        return [self._drop(caller) for caller, (_, until) in list(self._calls.items()) if until <= now]

    def release(self) -> list[KeptCall]:
        """All of them, in the order in which to ask; they wait no longer."""
        calls = [call for call, _ in self._calls.values()]
        self._calls.clear()
        self._bytes = 0
        return sorted(calls, key=lambda call: _FIRST.index(call.lane))

    def _drop(self, caller: bytes) -> KeptCall:
        call, _ = self._calls.pop(caller)
        self._bytes -= len(call.payload)
        return call


class AnswerAction(Enum):
    """What to do with a call."""

    ASK = auto()
    """The server."""
    WAIT = auto()
    """The server has been asked that."""
    ANSWER = auto()
    """With what the server answered."""
    REFUSE = auto()
    """It never came here, and must not begin now."""
    LOSE = auto()
    """It must not begin now, and nobody knows whether it came here."""


class Question(NamedTuple):
    """What calls about the same have in common.

    Attributes:
        lane: of an action's, a service.
        about: the goal's id; of a cancel, all that it says.
    """

    lane: int
    about: bytes


@dataclass(slots=True)
class Kept:
    """A question to the server, and what it answered.

    Attributes:
        number: of the client's call here; 0: a result has to be asked for, and what became of a goal is not known.
        servers: that were there when it was asked: ids.
        calls: of the other side's present opening that wait for it.
        answer: None: none yet.
        until: s, when it is forgotten; None: not before its answer has come.
    """

    number: int
    servers: AbstractSet[bytes]
    calls: list[int] = field(default_factory=list)
    answer: bytes | None = None
    until: float | None = None


def question_of(lane: int, payload: bytes) -> Question | None:
    """What a request asks; None: nothing that could be asked about again."""
    if lane == CANCEL_GOAL:
        cancel = cancel_of(payload)
        return Question(lane, cancel.request) if cancel is not None else None
    goal = goal_of(payload) if lane in (SEND_GOAL, GET_RESULT) else None
    return Question(lane, goal) if goal is not None else None


def result_request(goal: bytes) -> bytes:
    """A get_result request."""
    return _LITTLE_ENDIAN + goal


class KeptAnswers:
    """What one action's server was asked lately.

    What a server was asked goes on here when the link drops: its answer, above all a result, is kept until it has been
    asked for again. Action servers forget results themselves (rcl_action: 10 s after the end, by default), so that
    without this an outage would outlast them.
    """

    def __init__(self) -> None:
        self._kept: dict[Question, Kept] = {}  # oldest first
        self._by_number: dict[tuple[int, int], Question] = {}
        self._waiting: dict[int, Question] = {}  # calls, all of which are in `Kept.calls`
        self._bytes = 0
        self._has_forgotten = False  # too early, for want of room

    def __contains__(self, question: Question) -> bool:
        return question in self._kept

    @property
    def under_way(self) -> bool:
        """Whether the server owes an answer."""
        return any(kept.answer is None for kept in self._kept.values())

    def has_answer(self, question: Question | None) -> bool:
        """Whether the server has answered that."""
        kept = self._kept.get(question) if question is not None else None
        return kept is not None and kept.answer is not None

    def awaited(self) -> set[bytes]:
        """The goals whose results calls of the other side wait for."""
        return {question.about for question, kept in self._kept.items() if question.lane == GET_RESULT and kept.calls}

    def answer(self, question: Question) -> bytes:
        """What the server answered to a call that is to be answered so."""
        answer = self._kept[question].answer
        assert answer is not None
        return answer

    def take(self, question: Question, call: int, *, again: bool) -> AnswerAction:
        """Decide on a call.

        Results may be asked for as often as anybody likes, as they do not change. Everything else goes to the server,
        unless it has been there.

        Args:
            question: what it asks.
            call: its number in the present opening; it waits, where that is the answer.
            again: it was under way in an earlier opening.
        """
        kept = self._kept.get(question)
        if kept is None and again and question.lane == SEND_GOAL:
            return AnswerAction.LOSE if self._has_forgotten else AnswerAction.REFUSE
        if kept is None:
            return AnswerAction.ASK
        if not again and question.lane != GET_RESULT:
            return AnswerAction.ASK
        if kept.answer is not None:
            return AnswerAction.ANSWER
        if not kept.number and question.lane == SEND_GOAL:
            return AnswerAction.LOSE
        kept.calls.append(call)
        self._waiting[call] = question
        kept.until = None
        return AnswerAction.WAIT

    def asked(self, question: Question, number: int, servers: AbstractSet[bytes], *calls: int) -> None:
        """The server has been asked, under a number of the client's; these calls wait for its answer.

        Of two goals with the same id, the answer to the first is kept: the server refuses the second.
        """
        kept = self._kept.get(question)
        self._waiting.update(dict.fromkeys(calls, question))
        if kept is not None and question.lane == GET_RESULT:
            self._by_number.pop((question.lane, kept.number), None)
            kept.number, kept.servers = number, servers
            kept.calls += calls
        elif kept is not None and question.lane == SEND_GOAL:
            return
        else:
            calls = (*(kept.calls if kept is not None else ()), *calls)
            self._forget(question)
            self._kept[question] = Kept(number, servers, [*calls])
            self._waiting.update(dict.fromkeys(calls, question))
        self._by_number[question.lane, number] = question
        if len(self._kept) > MOST_KEPT:
            self._forget_one()

    def answered(
        self, lane: int, number: int, answer: bytes, now: float, *, linked: bool
    ) -> tuple[Question, list[int]] | None:
        """The server has answered.

        Returns:
            The question, and the calls that waited; None: it is not kept.
        """
        question = self._by_number.pop((lane, number), None)
        if question is None:
            return None
        kept = self._kept[question]
        calls, kept.calls, kept.number = kept.calls, [], 0
        for call in calls:
            self._waiting.pop(call, None)
        if (lane == GET_RESULT and state_of(answer) in (None, STATES[0])) or len(answer) > MOST_ANSWER_BYTES:
            self._forget(question)  # that it does not know a goal may change
            return question, calls
        kept.answer, kept.until = answer, now + (SENT_KEPT if linked else INTERRUPTION)
        self._bytes += len(answer)
        while self._bytes > MOST_ANSWER_BYTES:
            self._forget_one()
        return question, calls

    def is_over(self, call: int, now: float) -> None:
        """A call waits no more."""
        if (question := self._waiting.pop(call, None)) is not None:
            self._kept[question].calls.remove(call)
            self._forget_soon(question, now)

    def gave_up(self, lane: int, number: int, now: float) -> None:
        """The call that asked the server is over without an answer."""
        if (question := self._by_number.get((lane, number))) is not None:
            self._forget_soon(question, now)

    def _forget_soon(self, question: Question, now: float) -> None:
        """Keep for a while what has no answer and no call waits for. Results are kept: a goal may take days."""
        kept = self._kept[question]
        if question.lane != GET_RESULT and kept.answer is None and not kept.calls:
            kept.until = now + SENT_KEPT

    def results_awaited(self) -> list[tuple[bytes, list[int]]]:
        """Goals for whose results calls wait, and these calls."""
        return [(about, [*kept.calls]) for (lane, about), kept in self._kept.items() if lane == GET_RESULT]

    def interrupted(self, now: float) -> None:
        """Keep what may be asked about again: all that is under way, and what was sent and may not have arrived."""
        for kept in self._kept.values():
            kept.until = now + INTERRUPTION + SENT_KEPT  # longer than the other side keeps its question

    def clients_closed(self) -> None:
        """No answer comes to what was asked: results have to be asked for again, the rest is not known."""
        self._by_number.clear()
        for question, kept in list(self._kept.items()):
            if kept.answer is not None:
                continue
            kept.number = 0  # a goal may have come to the server, and must not go there again
            if question.lane == CANCEL_GOAL:
                self._forget(question)

    def to_ask(self, servers: AbstractSet[bytes]) -> list[Question]:
        """Results to ask for, now that these servers can be called: none of those that were asked is there any more."""
        return [
            question
            for question, kept in self._kept.items()
            if question.lane == GET_RESULT
            and kept.answer is None
            and (kept.number == 0 or kept.servers.isdisjoint(servers))
        ]

    def expire(self, now: float) -> None:
        """Forget what is too old."""
        for question, kept in list(self._kept.items()):
            if kept.until is not None and kept.until <= now:
                self._forget(question)

    def _forget_one(self) -> None:
        """The oldest, those with answers first; none that calls wait for, which the link's bounds on calls are for."""
        answered = (each for each, kept in self._kept.items() if kept.answer is not None)
        idle = (each for each, kept in self._kept.items() if not kept.calls)
        oldest = next(answered, None) or next(idle, None)
        if oldest is not None:
            self._has_forgotten = True
            self._forget(oldest)

    def _forget(self, question: Question) -> None:
        kept = self._kept.pop(question, None)
        if kept is not None:
            self._by_number.pop((question.lane, kept.number), None)
            self._bytes -= len(kept.answer or b"")
            for call in kept.calls:
                self._waiting.pop(call, None)
