"""Ends of stream channels that keep to a window, and what they tell each other.

All channels of a link share one `ReceiptBook`, so that many routes take few messages. A channel whose other side knows
no receipts has no book, and no window.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from rsb_bridge.channel.window import FIRST_RECEIPT, Taken, Window
from rsb_bridge.wire.receipts import MOST_RECEIPTS, Receipts

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.channel.channel import RouteSink, SendingChannel

_APART = 0.005
"""s between two messages with receipts."""


class Pace(Enum):
    """How a channel takes messages.

    Attributes:
        FREE: at once, or within a round trip or two.
        SLOW: it takes less than it is given: what was sent arrives late.
        STOPPED: nothing moves.
    """

    FREE = "free"
    SLOW = "slow"
    STOPPED = "stopped"


class ReceiptBook:
    """Collects a link's receipts, and sends them together.

    Args:
        loop: tells the time and sets the timer.
        send: sends a control message.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, send: Callable[[Receipts], None]) -> None:
        self.now = loop.time
        self._loop = loop
        self._send = send
        self._taken: dict[int, int] = {}
        self._every: dict[int, int] = {}
        self._sent_at = float("-inf")
        self._timer: asyncio.TimerHandle | None = None

    def say(self, route_id: int, taken: int) -> None:
        """Say how many bytes of a route have been taken in."""
        self._taken[route_id] = taken
        self._soon()

    def ask(self, route_id: int, every: int) -> None:
        """Ask for a receipt after so many bytes of a route each."""
        self._every[route_id] = every
        self._soon()

    def forget(self, route_id: int) -> None:
        """A route's channel is closed."""
        self._taken.pop(route_id, None)
        self._every.pop(route_id, None)

    def close(self) -> None:
        """The connection is over."""
        self._taken.clear()
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
        taken, every = tuple(self._taken.items()), tuple(self._every.items())
        self._taken.clear()
        self._every.clear()
        for first in range(0, max(len(taken), len(every)), MOST_RECEIPTS):
            part = slice(first, first + MOST_RECEIPTS)
            self._send(Receipts(taken=taken[part], every=every[part]))


class WindowedSender:
    """A sending end."""

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
        """Whether it is better not to send now."""
        raise NotImplementedError

    def begin_window(self) -> None:
        """Keep to a window from now on, where the other side knows receipts."""
        if self._book is not None:
            self._window = Window(self.sent)

    def took(self, count: int) -> None:
        """The receiver says how many bytes it has taken in."""
        window, book = self._window, self._book
        if window is None or book is None:
            return
        window.took(count, self.sent, book.now())
        every = window.every
        if every >= 2 * self._asked or 2 * every <= self._asked:
            self._asked = every
            book.ask(self._route.id, every)
        if not self.congested:
            self._route.flush()

    def look(self) -> None:
        """Once a second: send no more where nothing arrives."""
        if self._window is not None and self._book is not None:
            self._window.look(self.sent, self._book.now())

    @property
    def pace(self) -> Pace:
        """How it takes messages now."""
        if not self.congested:
            return Pace.FREE
        window, book = self._window, self._book
        if window is None or book is None:
            return Pace.STOPPED
        if window.slow:
            return Pace.SLOW if window.moves(book.now()) else Pace.STOPPED
        return Pace.FREE if self.sent >= window.limit else Pace.STOPPED


class ReceiptGiver:
    """A receiving end."""

    _route: RouteSink
    _taken: Taken
    _book: ReceiptBook | None = None

    def begin_receipts(self) -> None:
        """Give receipts from now on, where the other side knows them."""
        self._taken = Taken() if self._book is not None else Taken(float("inf"))

    def note(self, size: int) -> None:
        """Note that so many bytes were taken in."""
        taken = self._taken
        taken.count += size
        if taken.count >= taken.due:
            self.say()

    def asked(self, every: int) -> None:
        """The sender wants a receipt after so many bytes each."""
        if self._book is not None:
            self._taken.ask(every)

    def say(self) -> None:
        """Give a receipt, if there is any news."""
        if self._book is not None and self._taken.news:
            self._book.say(self._route.id, self._taken.say())


def pace_of(channel: SendingChannel) -> Pace:
    """How a channel of any kind takes messages now."""
    if isinstance(channel, WindowedSender):
        return channel.pace
    return Pace.STOPPED if channel.congested else Pace.FREE
