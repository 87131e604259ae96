"""Calls that wait for their answers, until they expire."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.route.peer_budget import CallBudget

_ROOM = 64
"""Entries of ended calls that may stay, however few calls there are. A round figure."""


@dataclass(slots=True)
class PendingCall:
    """A call that waits for its answer.

    Attributes:
        lane: its place among the route's members.
        size: bytes that it holds of the link's budget.
        asked_at: when it came, in s.
        expires: whether it has a timeout.
        goal: that a request for a result is about, or empty.
    """

    lane: int
    size: int
    asked_at: float
    expires: bool = field(default=False, kw_only=True)
    goal: bytes = field(default=b"", kw_only=True)


C = TypeVar("C", bound=PendingCall)


class PendingCalls(Generic[C]):
    """Holds calls by number, and returns to the budget what ended calls held.

    One timer serves them all: it stays when calls end, and looks at its time for the next deadline.

    Args:
        loop: sets the timer; its time is the clock.
        budget: of the link; adding a call does not take from it: the adder has done that.
        on_expired: called with the number and the call after its timeout, once it is removed.
        on_end: called with the number of each call that ends, for any reason.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        budget: CallBudget,
        on_expired: Callable[[int, C], None],
        on_end: Callable[[int], None],
    ) -> None:
        self._loop = loop
        self._budget = budget
        self._on_expired = on_expired
        self._on_end = on_end
        self._calls: dict[int, C] = {}
        self._deadlines: list[tuple[float, int]] = []  # a heap; entries of ended calls stay for a while
        self._timer: asyncio.TimerHandle | None = None
        self._looks_at = math.inf  # s, when the timer is due
        self._suspended_at: float | None = None

    def __len__(self) -> int:
        return len(self._calls)

    def __contains__(self, number: int) -> bool:
        return number in self._calls

    def get(self, number: int) -> C | None:
        """Return the call of a number, or None if it has ended or never began."""
        return self._calls.get(number)

    def items(self) -> list[tuple[int, C]]:
        """Return numbers and calls, oldest first."""
        return list(self._calls.items())

    def add(self, number: int, call: C, timeout: float | None) -> None:
        """Add a call that expires after `timeout` s, or if that is None, not before it is limited."""
        self._calls[number] = call
        if timeout is not None:
            self.limit(number, timeout)

    def limit(self, number: int, timeout: float) -> None:
        """Let a call expire after `timeout` s, unless it has ended or expires anyway."""
        if (call := self._calls.get(number)) is None or call.expires:
            return
        call.expires = True
        # Else ended calls stay until their timeout. At twice the number, a pass over all costs each call little.
        if len(self._deadlines) > 2 * len(self._calls) + _ROOM:
            self._deadlines = [each for each in self._deadlines if each[1] in self._calls]
            heapq.heapify(self._deadlines)
        due = (self._loop.time() if self._suspended_at is None else self._suspended_at) + timeout
        heapq.heappush(self._deadlines, (due, number))
        if due < self._looks_at and self._suspended_at is None:
            self._look_at(due)

    def end(self, number: int) -> C | None:
        """Remove a call and return it, or None if it has ended or never began."""
        call = self._calls.pop(number, None)
        if call is not None:
            self._budget.give(call.size)
            self._on_end(number)
        return call

    def clear(self) -> list[tuple[int, C]]:
        """End all calls, and return them with their numbers, oldest first. Later calls may have the same numbers."""
        calls = self.items()
        for number, _ in calls:
            self.end(number)
        self._deadlines.clear()
        self._look_at(math.inf)
        self._suspended_at = None
        return calls

    def suspend(self) -> None:
        """Let no call expire until `resume`: nobody can answer."""
        if self._suspended_at is None:
            self._suspended_at = self._loop.time()
            self._look_at(math.inf)

    def resume(self) -> None:
        """Give each call the time that was left when they were suspended, and later ones their whole timeout."""
        if self._suspended_at is not None:
            away, self._suspended_at = self._loop.time() - self._suspended_at, None
            self._deadlines = [(due + away, number) for due, number in self._deadlines]  # still a heap
            self._look_at(self._deadlines[0][0] if self._deadlines else math.inf)

    def resize(self, call: C, size: int) -> bool:
        """Have a call hold another number of bytes. Return False if the budget has no room for them."""
        if not self._budget.change(call.size, size):
            return False
        call.size = size
        return True

    def _look_at(self, due: float) -> None:
        """Set the timer to a time (s), or to none if that is infinite."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if due == math.inf else self._loop.call_at(due, self._expire)
        self._looks_at = due

    def _expire(self) -> None:
        now, deadlines = self._loop.time(), self._deadlines
        expired = []
        # Ended calls go, too: the timer would be set for nothing.
        while deadlines and (deadlines[0][0] <= now or deadlines[0][1] not in self._calls):
            _, number = heapq.heappop(deadlines)
            if (call := self.end(number)) is not None:
                expired.append((number, call))
        self._look_at(deadlines[0][0] if deadlines else math.inf)
        # After the next deadline is set: `_on_expired` may add calls.
        for number, call in expired:
            self._on_expired(number, call)
