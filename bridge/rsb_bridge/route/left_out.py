"""Tells operators of commands that were left out, as they came late or a newer one followed: one line a gap.

Both sides say the same, as both have the sender's ledger.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.route.ledger import OUTAGE, REPLACED

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.snapshot import Ledger

# Round figures.
_SETTLED = 3.0  # s without a further one: what was in transit is reported a second after the link is back
_LONGEST = 60.0  # s after which a link that goes on carrying too little is told, too


class LeftOut:
    """Counts a topic's messages that were left out because they may not move a robot late.

    Attributes:
        is_on: whether its messages may not be late.
    """

    is_on = False
    _told = _count = 0
    _since = _grew_at = 0.0

    @property
    def is_due(self) -> bool:
        """Whether there are some that nobody was told of."""
        return self._count > self._told

    def judge(
        self,
        ledger: Ledger,
        now: float,
        log: Callable[[Level, EventCode, str], None],
        *,
        counts: bool,
        linked: bool,
    ) -> None:
        """Look at a ledger, once a second.

        Args:
            log: logs an event about its route.
            counts: whether the topic's messages may not be late.
            linked: whether the link carries: until then, more may be left out.
        """
        count = ledger.expired + ledger.dropped.get(OUTAGE, 0) + ledger.dropped.get(REPLACED, 0)
        was_on, self.is_on = self.is_on, counts
        if not (was_on and counts) or count < self._count:  # or another process has begun to count
            self._told = self._count = count
            return
        if count > self._count:
            if not self.is_due:
                self._since = now
            self._count, self._grew_at = count, now
        if not self.is_due or not linked or (now - self._grew_at < _SETTLED and now - self._since < _LONGEST):
            return
        left_out, self._told = count - self._told, count
        log(
            Level.WARNING,
            EventCode.ROUTE_COMMANDS_LEFT_OUT,
            f"{left_out:,} late commands left out; max_age: none would have them followed",
        )
