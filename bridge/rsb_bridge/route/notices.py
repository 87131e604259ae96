"""A route's errors and warnings for operators, each reported once, and the losses of its channels."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.model.reason import Reason

_LINK_OUTLIVES = 1.0
"""s by which a link has to outlive a channel before the channel's loss is reported. A link that ends (with a goodbye, a
crash or a cut) takes its channels with it, and they may be seen to end first."""
_AGAIN_AND_AGAIN = 2
"""Channels that end before a message arrives. One may be bad luck, unless the kernel has tried for long. A channel over
which messages have arrived does not count: its link may be full, or the network was down."""
_IDLE_FOR = 5.0
"""s that a channel must be open and owe nothing before the losses of earlier ones are no fault any more. A round
figure: nothing was measured."""


class Notices:
    """Reports the errors and warnings of one route.

    Args:
        wall: gives the time in s since the epoch.

    Attributes:
        loop: the reason why the open route would close a loop of bridges and carries nothing, or empty.
        warning: a warning although messages flow, or empty.
        last_error: the last error, or empty.
        last_error_at: its time, s since the epoch.
        undelivered: the reason why the last message of this opening was not carried, or empty.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None], wall: Callable[[], float]) -> None:
        self.loop = ""
        self.warning = ""
        self.last_error = ""
        self.last_error_at = 0.0
        self.undelivered = ""
        self._log = log
        self._wall = wall
        self._reported = ""
        self._doubted = ""

    def error(self, code: EventCode, reason: str, level: Level = Level.ERROR) -> None:
        """Report that the route has failed; until messages flow, the same reason is not repeated."""
        self.record(reason)
        if reason != self._reported:
            self._reported = reason
            self._log(level, code, reason)

    def record(self, reason: str) -> None:
        """Set the last error, without a report."""
        self.last_error, self.last_error_at = reason, self._wall()

    def flowing(self) -> None:
        """Note that messages flow, so that every later failure is reported."""
        self._reported = self.undelivered = ""

    def message_error(self, code: EventCode, reason: str) -> None:
        """Report that a message could not be carried, although others can."""
        self.undelivered = reason
        is_new = reason != self.last_error
        self.record(reason)
        if is_new:
            self._log(Level.ERROR, code, reason)

    def set_loop(self, reason: str) -> None:
        """Set the reason why the open route would close a loop, or an empty string if it would not."""
        if reason and not self.loop:
            self.error(EventCode.ROUTE_LOOP, reason)
        elif self.loop and not reason:
            # A loop that comes again is reported again.
            self._reported = ""
            self._log(Level.INFO, EventCode.ROUTE_LOOP_GONE, "messages would no longer loop")
        self.loop = reason

    def set_warning(self, warning: str) -> None:
        """Set a warning that applies although messages flow, or an empty string."""
        if warning and warning != self.warning:
            self._log(Level.WARNING, EventCode.ROUTE_TYPE_CHANGED, warning)
        self.warning = warning

    def doubt(self, instance: str, remedy: str) -> None:
        """Report wrong counts of the peer and the remedy, once for each process of the peer."""
        if self._doubted != instance:
            self._doubted = instance
            text = f"the other side reports counts that cannot be right; {remedy}"
            self._log(Level.WARNING, EventCode.ROUTE_IMPLAUSIBLE_REPORT, text)

    def closed(self) -> None:
        """Drop the notices that apply only while the route is open."""
        self.loop = self.warning = self.undelivered = ""


class ChannelLosses:
    """Losses of a route's channel while its link stays up, since a message was last known to have arrived.

    A channel that owes nothing and ends shows nothing about messages: an outage ends the idle ones as well.

    Attributes:
        reasons: of the last losses.
    """

    def __init__(self) -> None:
        self.reasons: deque[Reason] = deque(maxlen=_AGAIN_AND_AGAIN)
        self._idle_since: float | None = None
        self._worked = False  # messages have arrived over the present channel
        self._report: asyncio.TimerHandle | None = None

    def add(self, reason: Reason, loop: asyncio.AbstractEventLoop, report: Callable[[], None], *, owing: bool) -> None:
        """Record the loss of the channel, and call `report` later, by when a link that was lost with it has ended.

        Args:
            owing: whether messages or answers were on their way, or waited for the channel.
        """
        if owing and not self._worked:
            self.reasons.append(reason)
        self._worked, self._idle_since = False, None
        self.forget_report()
        self._report = loop.call_later(_LINK_OUTLIVES, report)

    def arrived(self) -> None:
        """Note that messages arrive."""
        self._worked = True
        self.reasons.clear()

    def tick(self, now: float, *, idle: bool) -> None:
        """Forget the losses once a channel has been idle for a while: open, and owing nothing."""
        if not idle:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = now
        elif now - self._idle_since >= _IDLE_FOR:
            self.reasons.clear()

    def forget_report(self) -> None:
        """Cancel the report that is due."""
        if self._report is not None:
            self._report.cancel()

    @property
    def repeated(self) -> str:
        """The reason why channels repeatedly end before a message arrives, or empty."""
        if len(self.reasons) == _AGAIN_AND_AGAIN or (self.reasons and any(each.timed_out for each in self.reasons)):
            return self.reasons[-1].text
        return ""
