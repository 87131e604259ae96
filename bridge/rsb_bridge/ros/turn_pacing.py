"""Keeps the ROS thread's turns apart while there are many, as network cards moderate their interrupts.

A turn costs as much for one message as for ten, on both sides of a link: the thread is woken, and the loop, the stream
and the other side after it. So after some turns in quick succession the next one waits for further messages.
"""

from __future__ import annotations

import math

from rsb_bridge.model.limits import APART

_OFTEN = 0.001
"""s beyond `longest` between two turns below which the next ones move apart, and stay apart."""
_GROWS, _SHRINKS = 0.0005, 0.001
"""s. The second is larger, so that they part from some 200 turns a second on, however irregular these are."""


class TurnPacing:
    """When the next turn may be.

    Attributes:
        longest: s between two turns at the most; 0 if none waits.
        apart: s between the last turn and the next one at least.
    """

    def __init__(self) -> None:
        self.longest = APART
        self.apart = 0.0
        self._last = -math.inf

    def turned(self, now: float) -> None:
        """Note a turn with messages at `now` (s)."""
        grows = now - self._last < self.longest + _OFTEN
        self.apart = min(self.apart + _GROWS, self.longest) if grows else max(self.apart - _SHRINKS, 0.0)
        self._last = now

    def rest(self, now: float) -> float:
        """Return for how long (s) the next turn waits at `now` (s)."""
        return max(0.0, self._last + self.apart - now)
