"""What one link's calls may hold and how often they may come. Beyond that a call is refused, and never waits."""

from __future__ import annotations

from collections import deque

from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.route.calls.refusals import Refused
from rsb_bridge.wire.framing import Budget

CALLS_UNDER_WAY = 4096
BYTES_UNDER_WAY = 256 << 20
CALLS_A_SECOND = 5000.0
"""As many may come at once after a quiet second."""
PEERS_SHARE = 1.25
"""The providing side allows that much more, as calls end a little later there, and clocks differ."""
_LINGERS = 22.0
"""s for which DDS holds what a stopped program does not take: until it is given up (20 s), and a little more."""
_TOGETHER = 1.0  # s


class CallBudget:
    """The calls of one link in one direction, over all its routes.

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
