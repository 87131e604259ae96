"""Limits the data in transit on a link's data streams by receipts, so that messages wait there for a second at most.

A stream accepts as much as the buffers of the kernel and of a tunnel behind it hold. On a link of 5 kB/s that
is data for several minutes. So the receiver acknowledges bytes by receipts, and the sender keeps no more than a window
of them in transit. The rest waits in the routes' queues, which drop the oldest messages first.

The window follows the age of the oldest unacknowledged byte. While the age is low, the window grows by the bytes that
are acknowledged, so it doubles in a round trip, as TCP's does in slow start. Once the age exceeds `Ages.late`, the
window shrinks to the bytes that cross in `Ages.aim`. So the sender needs no initial rate, and a fast link never fills
the window.

`Window`, the sender's side, uses neither sockets nor clocks, and counts the bytes of all streams together.
`ReceiptBook` is the receiver's.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.transport_traits import QUEUES_LITTLE, Ages
from rsb_bridge.wire.messages import MOST_RECEIPTS, Receipts

if TYPE_CHECKING:
    import asyncio

# Where these were measured: bench/README.md, *Constants of the window*.
FIRST = 4 * 1024  # bytes in transit at the beginning, plus one turn: 0.8 s of 5 kB/s, as `Ages.late`
LEAST = 2 * 1024  # bytes of the smallest window: four receipts of `FIRST_RECEIPT`
_PARTS = 4  # the sender asks for a receipt after each such part of the window
FIRST_RECEIPT = 512  # bytes after which a receiver reports at first: few, to know the round trip before a queue grows
_RECEIPTS_APART = 0.005  # s between messages with receipts: far below the ages that the window tells apart (0.1 s)

# Of the way there and back (s); more counts as waiting.
_FARTHEST, _FARTHEST_PINGED = 2.0, 4.0  # without a queue: by itself, and if pings took as long
_FIRST_LASTS = 0.8  # that the first bytes may take; where pings take longer, more bytes take no longer than these
_LONGEST_BACK = 5.0  # a peer that claims more gains nothing by it
_LONGEST_OTHER = 1.2  # accepted as somebody else's: more may be queues of this link's other topics
_NOT_SHORTER = 0.75  # part of the time that data takes after the window has shrunk, if the queue is not the link's

_SILENT = 2.0  # s without a receipt after which the path has stalled: the last bytes are acknowledged within a second
_MEASURED_OVER = 1.0  # s over which the rate counts: a receiver sends a receipt at least once in it
_MARKS_PER_WINDOW, _MARK_EVERY = 64, 0.02  # a mark after each such part, or so many s: ages are as exact
_MOST_MARKS, _LAST_RECEIPTS = 1024, 64  # most that are kept, even if a peer acknowledges nothing


class Window:
    """The limit of one direction of a link.

    Attributes:
        limit: count of sent bytes at which the link is congested.
        size: bytes that may be in transit.
        rate: bytes/s that were acknowledged during the last second.
        slow: whether messages wait on the path.
    """

    def __init__(self, ages: Ages = QUEUES_LITTLE) -> None:
        self.slow = False
        self.rate = 0.0
        self._ages = ages
        self._acknowledged = 0
        self._marks: deque[tuple[int, float]] = deque()  # how many bytes were sent when (s)
        self._last_mark, self._last_mark_at = 0, float("-inf")
        self._receipts: deque[tuple[int, float]] = deque(maxlen=_LAST_RECEIPTS)
        self._before_shrinking: tuple[int, float] | None = None  # bytes sent until then, and s that data took
        self._back = 0.0  # s that receipts take to come back, as far as that is trusted
        self.expect(0.0)

    def expect(self, ping: float) -> None:
        """Begin on a path with that shortest ping (s), or 0 if it is unknown. Call it before anything is written."""
        self._ping = min(ping, _FARTHEST_PINGED)
        self._shortest = max(_FARTHEST, self._ping)  # s, the shortest round trip so far, less `_back`
        self.size = self.limit = int(FIRST * max(1.0, self._ping / _FIRST_LASTS))

    def wrote(self, before: int, now: float) -> None:
        """Record that data is written at `now` (s), after `before` bytes."""
        marks = self._marks
        if not marks:
            # After a pause the rate begins again: the time in which nothing was sent is not the path's.
            if not self._receipts or now - self._receipts[-1][1] > 2 * _MEASURED_OVER:
                self._receipts.clear()
                self._receipts.append((self._acknowledged, now))  # the rate counts from here
        elif now - self._last_mark_at < _MARK_EVERY and before - self._last_mark < self.size // _MARKS_PER_WINDOW:
            return
        if len(marks) < _MOST_MARKS:  # else a byte seems older than it is
            marks.append((before, now))
            self._last_mark, self._last_mark_at = before, now

    def acknowledge(self, count: int, sent: int, now: float, back: float = 0.0) -> None:
        """Adapt to a receipt.

        Args:
            count: bytes of the channel that the peer claims to have received.
            back: s that a receipt takes to come back now: what waits in the other direction does not count in this one.
        """
        self._back = min(back, _LONGEST_BACK)
        acknowledged = min(count, sent)
        gained = acknowledged - self._acknowledged
        if gained <= 0:
            return
        # A small topic that never fills half of the window says nothing about what the path carries. If the window
        # grew all the same, all would pass when the path becomes slow, until receipts are late.
        limited = 2 * (sent - self._acknowledged) >= self.size
        written_at = self._pass_marks(acknowledged, sent)
        if written_at is not None:
            took = max(0.0, now - written_at - self._back)
            self._shortest = min(self._shortest, took)
            self._accept_delay(took, acknowledged)
        self._acknowledged = acknowledged
        rate = self.rate = self._rate(acknowledged, now)
        waits = self._waits(now)
        if waits > self._ages.late:
            self.slow = True
            if self._before_shrinking is None:
                self._before_shrinking = sent, self._age(now) - self._back
            crosses = self._ages.aim + min(self._ping, self._shortest + self._back)
            # After a stall the rate is nearly 0. So half of what is in transit stays, as TCP halves its window.
            self.size = max(LEAST, int(rate * crosses), min(self.size, (sent - acknowledged) // 2))
        elif waits < self._ages.fresh:
            self.slow = self.slow and limited
            if limited or self.size < rate * self._ages.room:
                self.size += gained
        elif limited:
            self.slow = True
        self.limit = acknowledged + self.size

    def write_off(self, acknowledged: int, sent: int) -> None:
        """Count bytes as acknowledged that no receipt will count, since their stream is lost; they tell nothing."""
        self._pass_marks(acknowledged, sent)
        self._acknowledged = acknowledged
        self.limit = acknowledged + self.size

    def _pass_marks(self, acknowledged: int, sent: int) -> float | None:
        """Drop the marks of acknowledged bytes; return when (s) the last of these bytes was written, if a mark says."""
        marks = self._marks
        written_at = None
        while marks and marks[0][0] < acknowledged:
            written_at = marks.popleft()[1]
        # The rest of a write keeps its age, or a message of 100 kB would never seem late.
        if written_at is not None and acknowledged < sent and (not marks or marks[0][0] > acknowledged):
            marks.appendleft((acknowledged, written_at))
        return written_at

    def _accept_delay(self, took: float, acknowledged: int) -> None:
        """Accept a delay as that of the path if it stays although less is in transit."""
        if self._before_shrinking is None or acknowledged <= self._before_shrinking[0]:
            return
        _, before = self._before_shrinking
        self._before_shrinking = None
        if took >= _NOT_SHORTER * before:
            self._shortest = max(self._shortest, min(took, _LONGEST_OTHER))

    def check(self, sent: int, now: float, back: float = 0.0) -> None:
        """Close the window while the path is stalled. Called once a second, with `back` as for `acknowledge`."""
        self._back = min(back, _LONGEST_BACK)
        if self._waits(now) > _SILENT:
            self.slow = True
            self.limit = min(self.limit, max(sent, self._acknowledged + LEAST))

    @property
    def every(self) -> int:
        """Bytes between two receipts."""
        return max(FIRST_RECEIPT, self.size // _PARTS)

    def _waits(self, now: float) -> float:
        """Return how long (s) the oldest unacknowledged byte has waited, beyond the way there and back."""
        return self._age(now) - self._shortest - self._back

    def _age(self, now: float) -> float:
        """Return the age (s) of the oldest unacknowledged byte, or 0 if all are acknowledged."""
        return now - self._marks[0][1] if self._marks else 0.0

    def _rate(self, acknowledged: int, now: float) -> float:
        """Return the bytes/s that were acknowledged during the last second."""
        receipts = self._receipts
        while len(receipts) > 1 and receipts[1][1] <= now - _MEASURED_OVER:
            receipts.popleft()
        first, at = receipts[0] if receipts else (acknowledged, now)
        receipts.append((acknowledged, now))
        # The first receipts may come in the moment in which the first bytes were written.
        return (acknowledged - first) / max(now - at, 0.05)


class ReceiptCounter:
    """Counts the bytes of a receiving channel, to send a receipt after every few of them.

    Attributes:
        count: bytes received so far.
        due: count at which the next receipt is due.
    """

    def __init__(self, every: int = FIRST_RECEIPT) -> None:
        self.count = self._told = 0
        self._every = self.due = every

    def set_interval(self, every: int) -> None:
        """Have a receipt sent after every `every` bytes from now on."""
        self._every = max(1, every)  # a peer may ask for 0
        self.due = self._told + self._every

    def next_receipt(self) -> int:
        """Return the count for a receipt that is sent now."""
        self._told = self.count
        self.due = self.count + self._every
        return self.count

    @property
    def has_news(self) -> bool:
        return self.count != self._told


class ReceiptsOwner(Protocol):
    """The connection that sends receipts, and measures how long its messages take."""

    def send_receipts(self, receipts: Receipts) -> object: ...

    def ping(self) -> float:
        """Return the shortest ping, or 0 if it is unknown."""

    def way_back(self) -> float:
        """Return how long a message of the peer takes to get here."""


class ReceiptBook:
    """Collects a link's receipts, and sends them together: if one is due, all other streams' receipts go with it.

    The window cannot tell bytes that nobody has acknowledged yet from bytes that wait on the way. On a slow link, a
    stream with few bytes would keep them unacknowledged for a second.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: ReceiptsOwner) -> None:
        self.now = loop.time
        self.way_back, self.ping = owner.way_back, owner.ping
        self._loop = loop
        self._send = owner.send_receipts
        self._counters: dict[int, ReceiptCounter] = {}
        self._received: dict[int, int] = {}
        self._every: dict[int, int] = {}
        self._given_up: list[int] = []
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

    def give_up(self, stream: int) -> None:
        """Tell the other side that a stream is over here. A stream that passes nothing does not pass its end."""
        self._given_up.append(stream)
        self._soon()

    def forget(self, stream: int) -> None:
        self._counters.pop(stream, None)
        self._received.pop(stream, None)
        self._every.pop(stream, None)

    def close(self) -> None:
        """Send nothing more. All streams are forgotten already."""
        self._given_up.clear()
        if self._timer is not None:
            self._timer.cancel()

    def _soon(self) -> None:
        if self._timer is not None:
            return
        # The first one goes at once: what it waits would count as the path's round trip.
        wait = self._sent_at + _RECEIPTS_APART - self.now()
        if wait <= 0:
            self._flush()
        else:
            self._timer = self._loop.call_later(wait, self._flush)

    def _flush(self) -> None:
        self._timer = None
        self._sent_at = self.now()
        received, every, given_up = tuple(self._received.items()), tuple(self._every.items()), tuple(self._given_up)
        self._received.clear()
        self._every.clear()
        self._given_up.clear()
        for first in range(0, max(len(received), len(every), len(given_up)), MOST_RECEIPTS):
            part = slice(first, first + MOST_RECEIPTS)
            self._send(Receipts(received=received[part], every=every[part], given_up=given_up[part]))
