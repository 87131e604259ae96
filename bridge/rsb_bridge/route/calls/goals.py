"""The goals of one action, as the messages that cross tell of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import GoalSnapshot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from collections.abc import Set as AbstractSet

    from rsb_bridge.route.calls.goal_messages import GoalStatus

MOST_GOALS = 256
"""That are remembered; those that are not over stay longest."""

ASKED, UNKNOWN, REJECTED = "asked", "unknown", "rejected"
OVER = frozenset({REJECTED, "succeeded", "canceled", "aborted"})
"""The states that no goal leaves."""
_ORDER = (UNKNOWN, ASKED, "accepted", "executing", "canceling")


@dataclass(slots=True)
class _Goal:
    state: str
    since: float  # s since the epoch
    changed_at: float  # s
    feedbacks: int = 0
    crossed: bool = False  # sent by this route's callers, not by others of its server
    listed: bool = False  # by its server's last status message
    gone: bool = False  # with its server, or this says that it does not know it


class Goals:
    """The newest goals of an action, those of other callers of its server among them.

    Args:
        wall: gives s since the epoch.
        now: gives s on a clock that nobody sets.
    """

    def __init__(self, wall: Callable[[], float], now: Callable[[], float]) -> None:
        self._wall = wall
        self._now = now
        self._goals: dict[bytes, _Goal] = {}

    def asked(self, goal: bytes) -> None:
        """A caller has sent it."""
        if goal not in self._goals:
            self._add(goal, ASKED)
        self._goals[goal].crossed = True

    def answered(self, goal: bytes, *, accepted: bool) -> None:
        """Its server has accepted or rejected it; it rejects a second goal of the same id."""
        known = self._goals.get(goal)
        if known is not None and known.state in (ASKED, UNKNOWN):
            self._change(goal, "accepted" if accepted else REJECTED)

    def unanswered(self, goal: bytes) -> None:
        """The call that sent it was given up: nobody here knows what became of it."""
        known = self._goals.get(goal)
        if known is not None and known.state == ASKED:
            self._change(goal, UNKNOWN)

    def listed(self, statuses: Iterable[GoalStatus]) -> None:
        """Its server has published the states of all its goals.

        A goal that it listed before and no longer does has been forgotten: the server began anew, or the goal was over
        for longer than the server keeps results. What became of it is not known then.
        """
        stated = {each.goal: each.state for each in statuses}
        for goal, state in stated.items():
            if goal not in self._goals and state not in OVER and state != UNKNOWN:
                self._add(goal, state)
            elif goal in self._goals and self._follows(self._goals[goal].state, state):
                self._change(goal, state)
        for goal, known in self._goals.items():
            if known.listed and goal not in stated and known.state not in OVER:
                self._change(goal, UNKNOWN)
            known.listed = goal in stated
            known.gone = known.state == UNKNOWN and not known.listed

    def feedback(self, goal: bytes) -> None:
        """A feedback message of it has crossed."""
        if (known := self._goals.get(goal)) is not None:
            known.feedbacks += 1

    def result(self, goal: bytes, state: str) -> None:
        """Its server has answered with its result, or that it does not know the goal."""
        known = self._goals.get(goal)
        if known is not None and known.state not in OVER:
            known.gone = state == UNKNOWN
            self._change(goal, state)

    def server_gone(self) -> None:
        """The server is gone, and what becomes of its goals is not known."""
        for goal, known in self._goals.items():
            known.listed = False
            if known.state not in OVER:
                known.gone = True
                self._change(goal, UNKNOWN)

    def over_for(self, goal: bytes) -> float | None:
        """S since it was over; None: it is not known to be."""
        known = self._goals.get(goal)
        return self._now() - known.changed_at if known is not None and known.state in OVER else None

    def running(self) -> list[bytes]:
        """Those sent by this route's callers that are not known to be over, nor to wait for their acceptance."""
        return [
            goal
            for goal, known in self._goals.items()
            if known.crossed and known.state not in OVER and known.state != ASKED and not known.gone
        ]

    def snapshot(self, awaited: AbstractSet[bytes]) -> tuple[GoalSnapshot, ...]:
        """All of them: those that are not over first, newest first.

        Args:
            awaited: those for whose results callers wait.
        """
        newest = list(self._goals.items())[::-1]
        newest.sort(key=lambda item: item[1].state in OVER)
        return tuple(
            GoalSnapshot(goal.hex(), known.state, known.since, known.feedbacks, goal in awaited)
            for goal, known in newest
        )

    def _add(self, goal: bytes, state: str) -> None:
        if len(self._goals) >= MOST_GOALS:
            oldest = next((each for each, known in self._goals.items() if known.state in OVER), next(iter(self._goals)))
            del self._goals[oldest]
        self._goals[goal] = _Goal(state, self._wall(), self._now())

    def _change(self, goal: bytes, state: str) -> None:
        known = self._goals.get(goal)
        if known is not None and known.state != state:
            known.state, known.since, known.changed_at = state, self._wall(), self._now()

    @staticmethod
    def _follows(old: str, new: str) -> bool:
        """Whether a state is news: messages of an action's five lanes overtake each other."""
        if old in OVER:
            return False
        return new in OVER or (new in _ORDER and _ORDER.index(new) > _ORDER.index(old))
