"""What is said when a route's channel breaks while its link stays up."""

from __future__ import annotations

import errno
import os
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

_LINK_OUTLIVES = 1.0
"""s by which a link has to outlive a channel before the channel's loss is reported. A link that ends (with a goodbye, a
crash or a cut) takes its channels with it, and they may be seen to end first."""
_AGAIN_AND_AGAIN = 2
"""Channels that end before a message arrives. One may be bad luck, unless the kernel has tried for long. A channel over
which messages have arrived does not count: its link may be full, or the network was down."""
_TIMED_OUT = os.strerror(errno.ETIMEDOUT)


def timed_out(reason: str) -> bool:
    """Whether the kernel has tried for long to get something through before it gave a channel up."""
    return _TIMED_OUT in reason


class ChannelLosses:
    """Of one route, since a message was last known to have arrived."""

    def __init__(self) -> None:
        self._reasons: deque[str] = deque(maxlen=_AGAIN_AND_AGAIN)
        self._worked = False  # messages have arrived over the present channel
        self._report: asyncio.TimerHandle | None = None

    def add(self, reason: str, loop: asyncio.AbstractEventLoop, report: Callable[[], None]) -> None:
        """The channel was lost; `report` is called once the link should have ended, if it does with the channel."""
        if not self._worked:
            self._reasons.append(reason)
        self._worked = False
        self.forget_report()
        self._report = loop.call_later(_LINK_OUTLIVES, report)

    def arrived(self) -> None:
        """Messages arrive."""
        self._worked = True
        self._reasons.clear()

    def forget_report(self) -> None:
        """Call no report any more."""
        if self._report is not None:
            self._report.cancel()

    @property
    def repeated(self) -> str:
        """Why channels end again and again, before a message arrives; empty: they do not."""
        if len(self._reasons) == _AGAIN_AND_AGAIN or any(map(timed_out, self._reasons)):
            return self._reasons[-1]
        return ""
