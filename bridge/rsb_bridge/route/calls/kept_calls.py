"""Requests about an action's goals, and the goals' results, which outlive a session of the link.

A call that is open when a session ends is given up: the node may have received it, and must not receive it twice.
A cancel, or a request for a result, names its goal, and does no harm twice. The callers' side keeps it, and sends it
again once the action can be reached, even by another process of the peer: cancels first. A goal is not sent again: its
caller is answered if the server's status shows that it has accepted the goal. The providing side keeps the results of
goals, as their server forgets them soon.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT
from rsb_bridge.route.calls.goals import STATES, cancelled_by, goal_of, state_of

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

INTERRUPTION = 3600.0
"""s for which a call outlives an interruption at most, and for which a result is kept. A round figure."""
MOST_CALLS = 256
"""Calls of one action that wait. A round figure that bounds memory, as the three others here."""
MOST_BYTES = 8 << 20
"""Bytes of the kept calls' requests."""
MOST_RESULTS = 256
"""Results of one action that are kept, or that its server owes."""
MOST_RESULT_BYTES = 16 << 20
_LITTLE_ENDIAN = b"\0\1\0\0"


class KeptCall(NamedTuple):
    """A call that can be sent again.

    Attributes:
        lane: of a service of the action.
        caller: for `rsb_bridge.ros.ros_interface.ServiceServer.answer`.
        asked: when the caller asked, in s.
    """

    lane: int
    caller: bytes
    payload: bytes
    asked: float


class KeptCalls:
    """The calls of one callers' half that wait for the end of an interruption.

    Args:
        timeout: s that a goal that was sent waits, and a call without a goal: a late "cancel all goals" would end goals
            that came after it.
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
            return now + INTERRUPTION if cancelled_by(call.payload) is not None else call.asked + self.timeout
        if goal_of(call.payload) is None:
            return now
        return now + (INTERRUPTION if call.lane == GET_RESULT else self.timeout)

    def of(self, lane: int) -> list[KeptCall]:
        """Return a lane's calls."""
        return [call for call, _ in self._calls.values() if call.lane == lane]

    def expire(self, now: float) -> list[KeptCall]:
        """Remove and return the calls that have waited too long."""
        over = [call for call, until in self._calls.values() if until <= now]
        for call in over:
            self.end(call)
        return over

    def end(self, call: KeptCall) -> None:
        """Remove a call."""
        del self._calls[call.caller]
        self._bytes -= len(call.payload)

    def release(self) -> list[KeptCall]:
        """Remove and return the calls that can be sent again, in the order in which to send them."""
        calls = [*self.of(CANCEL_GOAL), *self.of(GET_RESULT)]
        for call in calls:
            self.end(call)
        return calls


@dataclass(slots=True)
class KeptResult:
    """A goal's result, or the question to the server.

    Attributes:
        number: of the client's call here, or 0 if no answer to that call can come any more.
        servers: ids of the servers that were there when the question was asked.
        calls: numbers of the peer's calls, in the present opening, that wait for the result.
        answer: the serialized response, or None until it comes.
        until: when an answer is forgotten, in s.
    """

    number: int
    servers: AbstractSet[bytes]
    calls: list[int] = field(default_factory=list)
    answer: bytes | None = None
    until: float = 0.0


def result_request(goal: bytes) -> bytes:
    """Return a get_result request."""
    return _LITTLE_ENDIAN + goal


class KeptResults:
    """The results of one action's goals.

    Action servers forget results (rcl_action: by default 10 s after the goal): a longer outage would lose them.

    Attributes:
        kept: by goal, the oldest first.
    """

    def __init__(self) -> None:
        self.kept: dict[bytes, KeptResult] = {}
        self._by_number: dict[int, bytes] = {}
        self._waiting: dict[int, bytes] = {}  # by call; each of these calls is in `KeptResult.calls`
        self._bytes = 0

    def __contains__(self, goal: bytes) -> bool:
        return goal in self.kept

    @property
    def under_way(self) -> bool:
        """Whether the server owes a result."""
        return any(kept.answer is None for kept in self.kept.values())

    def answer(self, goal: bytes) -> bytes | None:
        """Return the kept result, or None."""
        kept = self.kept.get(goal)
        return kept.answer if kept is not None else None

    def wait(self, goal: bytes, call: int) -> None:
        """Have a call of the peer's wait for a result that the server was asked for."""
        self.kept[goal].calls.append(call)
        self._waiting[call] = goal

    def asked(self, goal: bytes, number: int, servers: AbstractSet[bytes], *calls: int) -> None:
        """Note that the server was asked, under the client's number or with 0 later, and calls that wait for it."""
        kept = self.kept.setdefault(goal, KeptResult(0, servers))
        kept.calls += calls
        self._waiting.update(dict.fromkeys(calls, goal))
        self._by_number.pop(kept.number, None)
        kept.number, kept.servers = number, servers
        if number:
            self._by_number[number] = goal
        if len(self.kept) > MOST_RESULTS:
            self._forget_one()

    def answered(self, number: int, answer: bytes, now: float) -> tuple[bytes, list[int]] | None:
        """Keep an answer of the server.

        Returns:
            The goal and the calls that waited for its result, or None if the question is not kept.
        """
        goal = self._by_number.pop(number, None)
        if goal is None:
            return None
        kept = self.kept[goal]
        calls, kept.calls, kept.number = kept.calls, [], 0
        for call in calls:
            del self._waiting[call]
        if state_of(answer) in (None, STATES[0]) or len(answer) > MOST_RESULT_BYTES:
            self._forget(goal)  # a goal that the server does not know may still come
            return goal, calls
        kept.answer, kept.until = answer, now + INTERRUPTION
        self._bytes += len(answer)
        while self._bytes > MOST_RESULT_BYTES:
            self._forget_one()
        return goal, calls

    def is_over(self, call: int) -> None:
        """Note that a call has ended."""
        if (goal := self._waiting.pop(call, None)) is not None:
            self.kept[goal].calls.remove(call)

    def awaited(self) -> dict[bytes, list[int]]:
        """Return the peer's calls that wait for results, by goal."""
        return {goal: [*kept.calls] for goal, kept in self.kept.items() if kept.calls}

    def clients_closed(self) -> None:
        """Give up open questions; they can be asked again."""
        self._by_number.clear()
        for kept in self.kept.values():
            kept.number = 0

    def to_ask(self, servers: AbstractSet[bytes]) -> list[bytes]:
        """Return the goals whose results nobody has been asked for yet, or only servers that are not among these."""
        return [
            goal
            for goal, kept in self.kept.items()
            if kept.answer is None and (kept.number == 0 or kept.servers.isdisjoint(servers))
        ]

    def expire(self, now: float) -> None:
        """Forget old results. Called once a second."""
        for goal in [each for each, kept in self.kept.items() if kept.answer is not None and kept.until <= now]:
            self._forget(goal)

    def _forget_one(self) -> None:
        """Forget the oldest one, answered ones first. If calls wait for it, the link's bounds on calls apply."""
        answered = (each for each, kept in self.kept.items() if kept.answer is not None)
        idle = (each for each, kept in self.kept.items() if not kept.calls)
        if (oldest := next(answered, None) or next(idle, None)) is not None:
            self._forget(oldest)

    def _forget(self, goal: bytes) -> None:
        kept = self.kept.pop(goal)
        self._by_number.pop(kept.number, None)
        self._bytes -= len(kept.answer or b"")
        for call in kept.calls:
            del self._waiting[call]
