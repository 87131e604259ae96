"""Leaves a route idle while nothing happens to it, so that hundreds of quiet routes cost next to nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.telemetry.meters import HISTORY

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context

Signs: TypeAlias = tuple[object, ...]
"""What a route's verdict and its figures follow from; they are equal while nothing happens."""

IDLE_AFTER = float(HISTORY)
"""s without any change after which a route is idle. By then its rate is 0 and its plot is empty."""
LONGEST = 15.0
"""s that a route is idle at most: its signs may not show everything, and its figures should not be older."""
_AWAKE = 0.9
"""s after a tick before it is idle again, so that it is also reported and shown."""


class Idling:
    """Whether a route is idle. An idle route is not ticked or reported, and is shown again only for somebody who looks.

    The rule: its signs have been the same for `IDLE_AFTER`, and time alone changes nothing before its next tick.
    Messages do not have to tell of themselves: their count is one of the signs.
    """

    def __init__(self, context: Context) -> None:
        self._random = context.random
        self._signs: Signs = ()
        self._since = self._from = self._until = context.now()

    def ticked(self, signs: Signs, now: float, changes_at: float) -> None:
        """Decide after a tick how long it is idle.

        Args:
            changes_at: time (s) at which time alone changes the verdict, `now` if it may at any moment, or infinite.
        """
        if signs != self._signs:
            self._signs, self._since = signs, now
        self._from = self._until = now
        if now - self._since >= IDLE_AFTER:
            self._from += _AWAKE
            # Routes that came together do not wake together.
            self._until = min(now + self._random.uniform(LONGEST / 2, LONGEST), changes_at)

    def lasts(self, signs: Callable[[], Signs], now: float) -> bool:
        """Whether the route is idle at `now` (s)."""
        return self._from <= now < self._until and signs() == self._signs
