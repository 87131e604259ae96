"""Tickets: proofs that a console has heard from its bridge a moment ago, so that no command is carried out late.

A command may wait in a frozen program, a hung tunnel or a full buffer. Answers and states bring tickets, a request
brings the newest one back, and the bridge refuses what moves a robot if the ticket is old. Only the bridge's clock
counts.
"""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from rsb_bridge.model.clock import Clock

if TYPE_CHECKING:
    from collections.abc import Callable


class TicketClock:
    """Issues the tickets of one connection. Another connection's tickets are void.

    Args:
        steady: gives s on a clock that is never set.
    """

    def __init__(self, steady: Callable[[], float] = Clock.steady) -> None:
        self._steady = steady
        # 40 bits of ms are 35 years: a ticket of another connection is far too old, or not issued yet.
        self._first = secrets.randbits(40) - int(steady() * 1e3)

    def issue(self) -> int:
        """Return a ticket."""
        return self._first + int(self._steady() * 1e3)

    def age(self, ticket: int) -> float:
        """Return the age of a ticket in s. It is negative for one that was never issued."""
        return (self.issue() - ticket) / 1e3
