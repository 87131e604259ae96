"""Calls that wait for their answers: those of one route, each until it is given up, and the budget of a link's."""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.route.calls.calls_ledger import Refused
from rsb_bridge.wire.framing import Budget

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

CALLS_UNDER_WAY = 4096
BYTES_UNDER_WAY = 256 << 20
CALLS_A_SECOND = 5000.0
"""As many may come at once after a quiet second."""
PEERS_SHARE = 1.25
"""The providing side allows that much more, as calls end a little later there, and clocks differ."""
_LINGERS = 22.0
"""s for which DDS holds what a stopped program does not take: until it is given up (20 s), and a little more."""
_TOGETHER = 1.0  # s
_ROOM = 64


class CallBudget:
    """What the calls of one link may hold in one direction, over all its routes.

    Beyond that a call is refused, and never waits.

    Args:
        now: s.
        share: how much more than the usual is allowed.
    """

    def __init__(self, now: float, share: float = 1.0) -> None:
        self._calls = Budget(int(CALLS_UNDER_WAY * share))
        self._bytes = Budget(int(BYTES_UNDER_WAY * share))
        self._lingering: deque[tuple[float, int]] = deque()
        self._rate = TokenBucket(CALLS_A_SECOND * share, CALLS_A_SECOND * share, now)

    @property
    def held(self) -> tuple[int, int]:
        """Calls and bytes, now."""
        return self._calls.held, self._bytes.held

    def take(self, size: int, now: float) -> Refused | None:
        """Let a call of `size` bytes begin at `now` (s); else, why not."""
        if not self._rate.take(1.0, now):
            return Refused.CALLS_A_SECOND
        if not self._calls.take(1):
            return Refused.CALLS_UNDER_WAY
        if self._bytes.held + size + self._lingers(now) > self._bytes.limit or not self._bytes.take(size):
            self._calls.give(1)
            return Refused.BYTES_UNDER_WAY
        return None

    def change(self, before: int, size: int) -> bool:
        """Let a call hold `size` bytes instead of `before`; False: it may not, and nothing has changed."""
        self._bytes.give(before)
        if self._bytes.take(size):
            return True
        self._bytes.held += before
        return False

    def linger(self, size: int, now: float) -> None:
        """From `now` (s) on DDS holds `size` bytes for a server that may have stopped, though their call is over."""
        if self._lingering and now - self._lingering[-1][0] < _TOGETHER:
            began, before = self._lingering.pop()
            self._lingering.append((began, before + size))
        else:
            self._lingering.append((now, size))

    def _lingers(self, now: float) -> int:
        while self._lingering and now - self._lingering[0][0] > _LINGERS:
            self._lingering.popleft()
        return sum(size for _, size in self._lingering)

    def give(self, size: int) -> None:
        """A call that holds `size` bytes is over."""
        self._calls.give(1)
        self._bytes.give(size)


@dataclass(slots=True)
class Call:
    """A call.

    Attributes:
        lane: its place among the route's lanes.
        size: bytes that it holds of the link's budget.
        asked_at: s, when it came.
    """

    lane: int
    size: int
    asked_at: float


C = TypeVar("C", bound=Call)


class UnderWay(Generic[C]):
    """Holds calls by number, and gives back to the budget what ended calls held.

    Args:
        loop: sets the timer; its time is the clock.
        budget: of the link; whoever adds a call has taken its place there.
        on_expired: called with a call's number and the call, once it has been taken out after its timeout.
        on_end: called with the number of every call that is over, for whatever else is kept of it.
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
        self._deadlines: list[tuple[float, int]] = []  # a heap; those of ended calls stay for a while
        self._timer: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._calls)

    def __contains__(self, number: int) -> bool:
        return number in self._calls

    def get(self, number: int) -> C | None:
        """The call of that number; None: it is over, or never was."""
        return self._calls.get(number)

    def numbers(self) -> tuple[int, ...]:
        """Of all of them, in the order in which they were added."""
        return tuple(self._calls)

    def add(self, number: int, call: C, timeout: float | None) -> None:
        """A call is under way; it is given up after `timeout` s; None: never."""
        self._calls[number] = call
        if timeout is not None:
            if len(self._deadlines) > 2 * len(self._calls) + _ROOM:
                self._deadlines = [each for each in self._deadlines if each[1] in self._calls]
                heapq.heapify(self._deadlines)
            heapq.heappush(self._deadlines, (self._loop.time() + timeout, number))
            self._set_timer()

    def end(self, number: int) -> C | None:
        """A call is over; None: it was already, or never was."""
        call = self._calls.pop(number, None)
        if call is not None:
            self._budget.give(call.size)
            self._on_end(number)
            if not self._calls:
                self._deadlines.clear()
                self._set_timer()
        return call

    def resize(self, call: C, size: int) -> bool:
        """Let a call hold other bytes; False: the budget has no room for them."""
        if not self._budget.change(call.size, size):
            return False
        call.size = size
        return True

    def _set_timer(self) -> None:
        due = self._deadlines[0][0] if self._deadlines else None
        if self._timer is not None:
            if due is not None and self._timer.when() <= due:
                return
            self._timer.cancel()
            self._timer = None
        if due is not None:
            self._timer = self._loop.call_at(due, self._expire)

    def _expire(self) -> None:
        self._timer = None
        now = self._loop.time()
        expired = []
        while self._deadlines and self._deadlines[0][0] <= now:
            _, number = heapq.heappop(self._deadlines)
            if (call := self.end(number)) is not None:
                expired.append((number, call))
        self._set_timer()
        for number, call in expired:
            self._on_expired(number, call)
