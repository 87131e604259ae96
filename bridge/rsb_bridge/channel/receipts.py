"""Receipts, by which a side tells how many bytes of each data stream have come (`rsb_bridge.channel.window`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.wire.messages import MOST_RECEIPTS, Receipts

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.channel.window import ReceiptCounter

_APART = 0.005
"""s between two messages with receipts: at most 200 a second, however many streams have news. A round figure, far below
the ages that the window tells apart (0.1 s and more)."""


class ReceiptBook:
    """Collects a link's receipts, and sends them together: if one is due, all other streams' receipts go with it.

    The window cannot tell bytes that nobody has acknowledged yet from bytes that wait on the way. On a slow link, a
    stream with few bytes would keep them unacknowledged for a second.

    Args:
        way_back: gives the s that a message of the peer takes to get here.
        ping: gives the s of the connection's shortest ping, or 0 if it is unknown.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        send: Callable[[Receipts], None],
        way_back: Callable[[], float] = float,
        ping: Callable[[], float] = float,
    ) -> None:
        self.now = loop.time
        self.way_back = way_back
        self.ping = ping
        self._loop = loop
        self._send = send
        self._counters: dict[int, ReceiptCounter] = {}
        self._received: dict[int, int] = {}
        self._every: dict[int, int] = {}
        self._sent_at = float("-inf")
        self._timer: asyncio.TimerHandle | None = None

    def add(self, stream: int, counter: ReceiptCounter) -> None:
        """Acknowledge the bytes of a stream from now on."""
        self._counters[stream] = counter

    def report(self) -> None:
        """Send a receipt for all streams on which bytes came since their last one."""
        # A count that still waits for its message is replaced: the newer one covers it.
        self._received.update((stream, each.next_receipt()) for stream, each in self._counters.items() if each.has_news)
        self._soon()

    def ask(self, stream: int, every: int) -> None:
        """Ask for a receipt after every `every` bytes of a stream."""
        self._every[stream] = every
        self._soon()

    def forget(self, stream: int) -> None:
        """Drop the entries of a stream that is over."""
        self._counters.pop(stream, None)
        self._received.pop(stream, None)
        self._every.pop(stream, None)

    def close(self) -> None:
        """Drop all entries at the end of the connection."""
        self._counters.clear()
        self._received.clear()
        self._every.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _soon(self) -> None:
        if self._timer is None:
            # The first one goes at once: what it waits would count as the path's round trip.
            wait = self._sent_at + _APART - self.now()
            if wait <= 0:
                self._flush()
            else:
                self._timer = self._loop.call_later(wait, self._flush)

    def _flush(self) -> None:
        self._timer = None
        self._sent_at = self.now()
        received, every = tuple(self._received.items()), tuple(self._every.items())
        self._received.clear()
        self._every.clear()
        for first in range(0, max(len(received), len(every)), MOST_RECEIPTS):
            part = slice(first, first + MOST_RECEIPTS)
            self._send(Receipts(received=received[part], every=every[part]))
