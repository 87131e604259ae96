"""Ends of stream channels that limit the data in transit by receipts (`rsb_bridge.channel.window`).

All channels of a link share one `ReceiptBook`, which puts the receipts of many routes into few messages. If the peer
lacks the feature, a channel has neither book nor window.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from rsb_bridge.channel.window import FIRST_RECEIPT, ReceiptCounter, Window
from rsb_bridge.wire.messages import MOST_RECEIPTS, Receipts

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.channel.channel import RouteSink, SendingChannel

_OF_FIRST = 2.5
"""`Window.patience` of routes with a high priority: they wait behind others' data, and the others yield first."""
_APART = 0.005
"""s between two messages with receipts."""


class Pace(Enum):
    """State of a sending channel, as its route's queue needs it.

    Attributes:
        FREE: it accepts messages now or in a round trip or two.
        SLOW: it delivers messages more slowly than they are published.
        STOPPED: it delivers none.
    """

    FREE = "free"
    SLOW = "slow"
    STOPPED = "stopped"


class ReceiptBook:
    """Collects a link's receipts, and sends them together.

    Args:
        loop: tells the time and sets the timer.
        send: sends a control message.
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
        self._received: dict[int, int] = {}
        self._every: dict[int, int] = {}
        self._sent_at = float("-inf")
        self._timer: asyncio.TimerHandle | None = None

    def acknowledge(self, route_id: int, received: int) -> None:
        """Acknowledge the bytes received of a route so far."""
        self._received[route_id] = received
        self._soon()

    def ask(self, route_id: int, every: int) -> None:
        """Ask for a receipt after every `every` bytes of a route."""
        self._every[route_id] = every
        self._soon()

    def forget(self, route_id: int) -> None:
        """Drop the entries of a route whose channel is closed."""
        self._received.pop(route_id, None)
        self._every.pop(route_id, None)

    def close(self) -> None:
        """Drop all entries at the end of the connection."""
        self._received.clear()
        self._every.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _soon(self) -> None:
        if self._timer is None:
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


class WindowedSender:
    """Sending end with a window."""

    _route: RouteSink
    _window: Window | None = None
    _book: ReceiptBook | None = None
    _asked = FIRST_RECEIPT

    @property
    def sent(self) -> int:
        """Bytes that the window counts."""
        raise NotImplementedError

    @property
    def congested(self) -> bool:
        """Whether new messages should wait in the queue."""
        raise NotImplementedError

    def begin_window(self) -> None:
        """Create the window, if the peer sends receipts."""
        if self._book is not None:
            self._window = Window(self.sent, self._book.ping())

    def acknowledge(self, count: int) -> None:
        """Adapt the window to a receipt, and send from the queue."""
        window, book = self._window, self._book
        if window is None or book is None:
            return
        window.patience = _OF_FIRST if self._route.rank > 0 else 1.0
        window.back = book.way_back()
        window.acknowledge(count, self.sent, book.now())
        every = window.every
        if every >= 2 * self._asked or 2 * every <= self._asked:
            self._asked = every
            book.ask(self._route.id, every)
        if not self.congested:
            self._route.flush()

    def check_window(self) -> None:
        """Close the window while the path is stalled. Called once a second."""
        window, book = self._window, self._book
        if window is not None and window.awaits_receipts and book is not None:
            window.back = book.way_back()
            window.check(self.sent, book.now())

    @property
    def grows(self) -> bool:
        """Whether the window still grows, as nothing waits on the path: it is no measure of what the link carries."""
        return self._window is not None and not self._window.slow

    @property
    def pace(self) -> Pace:
        """State of the channel now."""
        if not self.congested:
            return Pace.FREE
        window, book = self._window, self._book
        if window is None or book is None:
            return Pace.STOPPED
        if window.slow:
            return Pace.SLOW if window.moves(book.now()) else Pace.STOPPED
        return Pace.FREE if self.sent >= window.limit else Pace.STOPPED


class ReceiptSender:
    """Receiving end that sends receipts."""

    _route: RouteSink
    _counter: ReceiptCounter
    _book: ReceiptBook | None = None

    def begin_receipts(self) -> None:
        """Create the counter; no receipt is ever due if the peer does not support them."""
        self._counter = ReceiptCounter() if self._book is not None else ReceiptCounter(float("inf"))

    def count_bytes(self, size: int) -> None:
        """Count received bytes, and send a receipt if one is due."""
        counter = self._counter
        counter.count += size
        if counter.count >= counter.due:
            self.send_receipt()

    def set_interval(self, every: int) -> None:
        """Send a receipt after every `every` bytes from now on."""
        if self._book is not None:
            self._counter.set_interval(every)

    def send_receipt(self) -> None:
        """Send a receipt, if bytes came since the last one."""
        if self._book is not None and self._counter.has_news:
            self._book.acknowledge(self._route.id, self._counter.next_receipt())


def pace_of(channel: SendingChannel) -> Pace:
    """Return the state of a channel of any kind."""
    if isinstance(channel, WindowedSender):
        return channel.pace
    return Pace.STOPPED if channel.congested else Pace.FREE
