"""The traffic that a topic's sending half wants to send."""

from __future__ import annotations

from rsb_bridge.telemetry.meters import Smoothed

PER_MESSAGE = 60
"""Bytes on the wire in addition to a message's content: header, seal, and a part of the packets' headers."""
_FADES = 0.8
"""The part of the messages so far that still counts a second later, for the size of the average one: it is of about
five seconds. Nothing was measured."""


class TrafficMeter:
    """Measures what one sending half wants to send.

    Attributes:
        offered: messages that the topic wanted to send since the last look, within its own rate limit.
    """

    def __init__(self, now: float) -> None:
        self.offered = 0
        self._messages = self._bytes = 0.0  # packed lately
        self._size = 0.0
        self._wanted = Smoothed(now)

    def measure(self, now: float) -> float:
        """Return the bytes/s that the topic has wanted to send since the last call. Called once a second."""
        # Most of hundreds of topics are idle, and each is asked once a second.
        if not self.offered and self._wanted.idle(now):
            return 0.0
        if self._messages:
            self._size = PER_MESSAGE + self._bytes / self._messages
        self._wanted.add(self.offered, now)
        self._messages *= _FADES
        self._bytes *= _FADES
        self.offered = 0
        return self._wanted.rate * self._size

    def packed(self, messages: int, size: int) -> None:
        """Count messages that are sent, of `size` bytes together."""
        self._messages += messages
        self._bytes += size
