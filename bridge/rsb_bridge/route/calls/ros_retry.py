"""New attempts after ROS has refused an endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.calls_end import Trouble

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import LaneEntry

_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s between attempts, at first and at most. Round figures: nothing announces that ROS would take an endpoint now."""
_HEALED_AFTER = 60.0
"""s without a failure after which the first delay applies again: twice the longest delay."""


class RosRetry:
    """Delays new attempts of a route after ROS has refused an endpoint.

    Attributes:
        trouble: the last failure, or None once an attempt has succeeded.
    """

    def __init__(self, route: Route) -> None:
        self.trouble: Trouble | None = None
        self._route = route
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._failed_at = float("-inf")
        self._entries: Sequence[LaneEntry] = ()
        self._timer: asyncio.TimerHandle | None = None

    def waits(self, entries: Sequence[LaneEntry]) -> bool:
        """Return whether endpoints of these types failed so lately that it is too early for a new attempt."""
        return self._timer is not None and entries == self._entries

    def failed(self, text: str, entries: Sequence[LaneEntry]) -> None:
        """Report that endpoints of these types could not be made, or closed themselves, for a reason in words.

        They are tried again later, others at once.
        """
        now = self._route.context.now()
        if now - self._failed_at >= _HEALED_AFTER:
            self._backoff.reset()
        self._failed_at, self._entries = now, entries
        self.trouble = Trouble(Cause.OFFER_FAILED, f"{text}; trying again")
        self._stop()
        self._timer = self._route.context.loop.call_later(self._backoff.next(), self._due)
        self._route.notices.error(EventCode.ROUTE_OFFER_FAILED, text)
        self._route.judge_again()

    def clear(self) -> None:
        """Note that all endpoints that are wanted exist."""
        self.trouble = None
        self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        if self._route.id:
            self._route.advance()
