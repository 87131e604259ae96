"""Messages that have waited for a link, once it is back: how many are left, and the pace of their publication.

A subscription keeps ten messages by default. If they arrive faster than its node takes them, it loses the oldest, even
though DDS has acknowledged them. So where all are wanted, as with `keep`, late messages are published one by one, and
faster only the longer that takes. Other topics tell a state, which is of use while it is live: all that is late is
published at once, spread over a moment.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.wire.framing import Message

LATE = 0.2
"""Age (s) from which a message is late. On a link that is always slower, the pace holds nothing up."""
EVERY = 0.01  # s from one to the next
AT_FIRST, FASTER = 100.0, 50.0
"""Messages a second, and how many more after each second. A node takes one in 0.1 to 1 ms, but others hold it up: at
500 a second one on a busy machine lost 13 of 200 (`bench.outages`, 20 s)."""
_PAUSE = 1.0  # s without a late message, after which the pace begins again. A round figure
_ROUNDED = 1e-6
_LEAST, _LEAST_BUSY = 2.0, 1.5
"""Times the topic's rate, and while timers are late. Round figures."""
_TELLS = 0.5
"""Seconds of late messages whose stamps tell the topic's rate. On a Wi-Fi with a gap of 3 s each 30 s it is never
learned, and joint states of 100 Hz were late for 5 s after each (`bench.robot`). In a shorter time it may be a burst's.
"""
_LATEST = 0.1  # s by which timers may be late. A round figure
LIVE_WITHIN = 0.3
"""s from the first late message in which all are published that tell a state. With all at once a subscription of depth
10 has ten of them; the joint states of a Wi-Fi had p99 247 ms with it and 731 ms without (`bench.robot`)."""

_STUCK_AFTER = 10.0  # s in which the backlog gets no shorter: the link carries less than is published. A round figure


class Backlog:
    """The messages that waited for a link, and those behind them, until the receiving side has reported them.

    Attributes:
        exists: whether the link is away, or not all of them are settled.
        left: how many are not settled, once the link is back, or 0 before.
        dropped_before: messages dropped in earlier outages.
    """

    def __init__(self) -> None:
        self.exists = False
        self.left = self.dropped_before = 0
        self._until = 0  # number of the newest message that belongs to it, counted as offered
        self._least = 0  # smallest `left` so far
        self._shrank_at = 0.0

    def begin(self, dropped: int) -> None:
        """Begin, as the link is away; `dropped` messages were lost to earlier outages."""
        self.exists, self.dropped_before = True, dropped
        self.left = self._least = 0

    def end(self) -> None:
        self.exists = False

    def judge(self, ledger: Ledger, now: float, *, held_up: bool = False) -> None:
        """Judge what is left at `now` (s), as the link is back. Called once a second.

        Args:
            held_up: whether messages are still late, as the receiving side publishes them one by one.
        """
        if ledger.waiting or held_up or not self.left:  # what comes now waits behind them
            self._until = ledger.offered
        self.left = max(0, self._until - (ledger.offered - ledger.open))
        if not self._least or self.left < self._least:
            self._least, self._shrank_at = self.left, now
        self.exists = self.left > 0 and now - self._shrank_at < _STUCK_AFTER


class CatchUp:
    """The pace of one topic. It is at least twice the topic's rate: else it would be late for long."""

    def __init__(self) -> None:
        self._began = self._asked = float("-inf")
        self._own = self._left = 0.0
        self._first = self._count = 0  # stamp of the first late message, and how many are published

    def allowed(self, messages: Sequence[Message], now: float, own_rate: float, within: float = math.inf) -> int:
        """Return how many late messages of a topic may be published at `now` (s).

        Args:
            own_rate: the topic's rate (Hz), or less if it is not known.
            within: s from the first late message in which all are to be published.
        """
        since, self._asked = now - self._asked, now
        if since > _PAUSE:
            # Its rate from now on contains what is published late, and would drive itself up.
            self._began, since, self._own, self._first, self._count = now, EVERY, own_rate, messages[0][1], 0
        if (seconds := (messages[0][1] - self._first) / 1e9) >= _TELLS:
            self._own = max(self._own, self._count / seconds)
        rate = max(AT_FIRST + FASTER * (now - self._began), _LEAST * self._own)
        # Where the machine is busy, timers are late, and nodes take messages more slowly, too. But they have to keep up
        # with the topic's own rate anyway, or it would be late for ever.
        self._left = min(self._left, 1.0)
        self._left += max(rate * min(since, EVERY), _LEAST_BUSY * self._own * min(since, _LATEST))
        turns = (self._began + within - now) / max(EVERY, min(since, _LATEST))
        # What comes after that time is published at once.
        least = len(messages) if turns <= 1.0 else math.ceil(len(messages) / turns)
        if turns > 1.0 and since < EVERY - _ROUNDED:
            least = 0  # they come one by one at the same moment: all but the first wait for the next turn
        allowed = min(len(messages), max(least, int(self._left + _ROUNDED)))
        self._left = max(0.0, self._left - allowed)
        self._count += allowed
        return allowed
