"""The traffic that a topic's sending half wants to send."""

from __future__ import annotations

from typing import NamedTuple

from rsb_bridge.telemetry.meters import Smoothed

PER_MESSAGE = 60
"""Bytes on the wire in addition to a message's content: header, seal, and a part of the packets' headers."""
_FADES = 0.8
"""The part of the messages so far that still counts a second later, for the size of the average one: it is of about
five seconds. Nothing was measured."""


class Traffic(NamedTuple):
    """The traffic of one topic since the last look.

    Attributes:
        bytes_per_second: that it wants to send.
        size: bytes of an average message on the wire.
        busy: s for which its channel has been busy, or 0 if it is idle.
    """

    bytes_per_second: float
    size: float
    busy: float


_IDLE = Traffic(0.0, 0.0, 0.0)


class TrafficMeter:
    """Measures what one sending half wants to send.

    Attributes:
        offered: messages that the topic wanted to send since the last look, within its own rate limit.
        busy_since: time (s) from which on the channel had more to send than it took, or None if it has not.
    """

    def __init__(self, now: float) -> None:
        self.offered = 0
        self.busy_since: float | None = None
        self._messages = self._bytes = 0.0  # packed lately
        self._size = 0.0
        self._wanted = Smoothed(now)

    def measure(self, now: float) -> Traffic:
        """Return the traffic since the last call. Called once a second."""
        # Most of hundreds of topics are idle, and each is asked once a second.
        if not self.offered and self._wanted.idle(now):
            return _IDLE
        if self._messages:
            self._size = PER_MESSAGE + self._bytes / self._messages
        self._wanted.add(self.offered, now)
        self._messages *= _FADES
        self._bytes *= _FADES
        self.offered = 0
        busy = 0.0 if self.busy_since is None else now - self.busy_since
        return Traffic(self._wanted.rate * self._size, self._size, busy)

    def packed(self, messages: int, size: int) -> None:
        """Count messages that are sent, of `size` bytes together."""
        self._messages += messages
        self._bytes += size

    def busy(self, busy: bool, now: float) -> None:
        """Note whether the channel has more to send than it takes at `now` (s)."""
        if not busy:
            self.busy_since = None
        elif self.busy_since is None:
            self.busy_since = now
