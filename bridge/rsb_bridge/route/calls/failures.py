"""Why ROS refuses the servers or clients of a route of calls on this side, and when they are tried again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.backoff import Backoff
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.verdict import Trouble

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.context import Context

_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s."""
_HEALED_AFTER = 60.0
"""s without a failure after which the delays begin anew."""


class Failures:
    """One half's. Whoever makes its endpoints asks first whether to wait.

    Args:
        context: has the clock and the timers.
        try_again: called when a delay is over.

    Attributes:
        trouble: the last failure, until an attempt succeeds; None: there was none.
    """

    def __init__(self, context: Context, try_again: Callable[[], None]) -> None:
        self.trouble: Trouble | None = None
        self._context = context
        self._try_again = try_again
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._failed_at = float("-inf")
        self._about: object = None
        self._timer: asyncio.TimerHandle | None = None

    def waits(self, about: object) -> bool:
        """Whether the same has failed so lately that it is not tried again yet.

        Args:
            about: what the endpoints are made of; if that has changed, they are tried at once.
        """
        return self._timer is not None and about == self._about

    def failed(self, text: str, about: object) -> None:
        """An attempt has failed, or what it made; `text` says why."""
        now = self._context.now()
        if now - self._failed_at >= _HEALED_AFTER:
            self._backoff.reset()
        self._failed_at, self._about = now, about
        self.trouble = Trouble(Cause.OFFER_FAILED, f"{text}; it is tried again by itself")
        self.close()
        self._timer = self._context.loop.call_later(self._backoff.next(), self._due)

    def clear(self) -> None:
        """Nothing fails: all endpoints are there, or none is wanted."""
        self.trouble = None
        self.close()

    def close(self) -> None:
        """Try no more by itself."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._try_again()
