"""Shares a link among the routes that have something to send: one queue, one window.

The turns are start-time fair queueing (Goyal, Vin, Cheng 1996): each turn has the virtual time at which it would begin
if every route had an equal share, and the earliest goes first. So a route that uses less than its share, like a
joystick, goes ahead of a map at once; busier routes share equally; nothing starves. A route's share is weighted by its
topic's priority; calls and what moves robots have the highest. Control messages do not pass here: they have a
connection of their own, or go ahead of all turns.

A route is asked for its messages when its turn comes, and not before. What waits, waits in the routes' queues, where
depth and age count, and newer messages replace older ones.

The window (`rsb_bridge.channel.window`) bounds what is in transit on all streams of the link together. With a window
for each stream or route, the one with the most data would have the most in transit, with any priority. A stream on
which nothing gets through any more would keep the window full, so its bytes are written off.
"""

from __future__ import annotations

import asyncio
import heapq
import math
from abc import ABC, abstractmethod
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import DataChannel

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.window import ReceiptBook, Window
    from rsb_bridge.wire.framing import Message

_UNIT = 16  # virtual bytes of one byte with a weight of 1, so that all weights divide it

# Where these were measured: bench/README.md, *Constants of the scheduler*.
# Bytes of a message in one turn: a part of the window, so that on a slow link another route's turn comes soon, and on a
# fast one sealing and headers cost little. The least fills a packet.
LEAST_CHUNK, _MOST_CHUNK, _CHUNKS_PER_WINDOW = 1400, 128 * 1024, 32
_LEAST_WRITE, _WRITES_PER_WINDOW = 16 * 1024, 16  # bytes written together: small frames of many routes in one call
# s of the present rate that count as the window for chunks and writes while routes wait: where a kernel's short buffer
# holds them back (RFCOMM), the window itself is never full and grows to seconds.
_BUSY_WINDOW = 0.5
_A_PASS = 1024 * 1024  # bytes sealed in one pass of the I/O loop before other links have their turn
_STALLED = 1.5  # s without a receipt after which nothing gets through: the last bytes are acknowledged within 1 s
_BEHIND = 1.0  # s of turns without an end after which a route seems to get less than it asks for


class Carrier(ABC):
    """A stream or socket that takes the bytes of turns.

    Attributes:
        queue: its routes that wait for a turn: when it begins, in which order they came, and the route's end.
        time: virtual time of its last turn.
        behind: what its virtual time is behind the link's, because it was congested while other streams sent.
        moved_at: time (s) of its last receipt, or of its oldest unacknowledged byte if that came later.
        over: whether it is lost or closed: no route gets a turn on it any more.
        spare: bytes that it takes next without further questions, as it gathers messages and no turn is due.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.queue: list[tuple[int, int, SendingChannel]] = []
        self.time = self.behind = 0
        self.moved_at = -math.inf
        self.over = False
        self.spare = 0
        scheduler.add(self)

    @property
    @abstractmethod
    def in_transit(self) -> int:
        """Bytes that count in the window."""

    @property
    @abstractmethod
    def congested(self) -> bool:
        """Whether it takes nothing now."""

    @abstractmethod
    def write_off(self) -> None:
        """Count what is in transit no longer, and take little or nothing more until receipts come again."""

    @abstractmethod
    def write_gathered(self) -> None:
        """Send the messages of this moment that are gathered."""

    def is_stuck(self, now: float) -> bool:
        """Whether what is in transit gets no further, at `now` (s)."""
        return self.in_transit > 0 and now - self.moved_at > self.scheduler.stalls_after

    @property
    def moves(self) -> bool:
        """Whether what it sends delivers."""
        return not self.is_stuck(self.scheduler.now())

    def write(self, data: bytes | memoryview, now: float) -> None:
        """Send the joined bytes of turns at `now` (s). Datagrams do not come here: they are sent in their turns."""
        raise NotImplementedError

    def writable(self) -> None:
        """Give turns: it takes bytes again."""
        self.scheduler.choose_sizes()
        self.scheduler.run()


class Scheduler:
    """The queue and the window of one link's direction.

    Attributes:
        window: bounds what is in transit.
        sent: bytes sent so far, on all streams.
        gathered: bytes of messages that streams are about to send together.
        chunk: bytes of a message in one turn.
        acknowledged: bytes that have arrived, or were written off.
        arrived: bytes that have arrived.
        acknowledged_at: when (s) the last receipt of further bytes came.
        waits_since: since when (s) something has waited all the time, or infinity if nothing waits.
    """

    def __init__(self, book: ReceiptBook, window: Window) -> None:
        self.sent = self.gathered = self.acknowledged = self.arrived = 0
        self.acknowledged_at = -math.inf
        self.waits_since = math.inf
        self.chunk = LEAST_CHUNK
        self._write = _LEAST_WRITE
        self._book = book
        self.now = book.now
        self.window = window
        self._carriers: list[Carrier] = []
        self._waiting = 0  # routes that wait for a turn
        self._order = 0
        self._time = 0  # virtual: bytes
        self._passing = False
        self._next_pass: asyncio.Handle | None = None

    # --- streams

    def add(self, carrier: Carrier) -> None:
        carrier.time = self._time  # else what joins it while it is congested would begin in the past
        self._carriers.append(carrier)

    def remove(self, carrier: Carrier) -> None:
        """Forget a stream that is lost, and its bytes in transit, which no receipt will ever count."""
        self._carriers.remove(carrier)
        for _, _, end in carrier.queue:
            self.leave(end)
        carrier.queue.clear()
        self.written_off(carrier.in_transit)

    def written_off(self, size: int) -> None:
        """Count bytes as arrived that no receipt will count."""
        self.acknowledged += size
        self.window.write_off(self.acknowledged, self.sent)
        self.run()

    def close(self) -> None:
        self._carriers.clear()
        if self._next_pass is not None:
            self._next_pass.cancel()
            self._next_pass = None

    # --- turns

    @property
    def is_free(self) -> bool:
        """Whether a message may be sent at once, if its stream takes it: no turn is due, and the window takes it."""
        # In a pass, turns are sealed and not yet written: a later message of their route would overtake them.
        if self._passing or self.sent + self.gathered >= self.window.limit:
            return False
        if self._waiting:  # nearly always for a stream that takes nothing, as of images, which holds up no other one
            for each in self._carriers:
                if each.queue and not each.congested:
                    return False
        return True

    def join(self, end: SendingChannel) -> None:
        """Queue a route's end for a turn; one that had nothing to send does not make up for that.

        Nothing happens while what carries it is over: it joins when it resumes on something else.
        """
        if not end.queued and not end.via.over:
            # What waits on a congested stream is behind the link's time, and so is what joins it.
            via = end.via
            end.start = max(end.start, via.time if via.congested else self._time - via.behind)
            self._push(end)

    def _push(self, end: SendingChannel) -> None:
        end.queued = True
        self._waiting += 1
        if self.waits_since == math.inf:
            self.waits_since = self.now()
        if end.waits_since is None:
            end.waits_since, end.turned = self.now(), False
        # Ends that begin at the same time take turns as they came. Without a number, heapq would compare the ends.
        self._order += 1
        heapq.heappush(end.via.queue, (end.start, self._order, end))

    def leave(self, end: SendingChannel) -> None:
        if end.queued:
            end.queued = False  # its entry stays in the heap, which gives only its first one: `_next` drops it
            self._waiting -= 1

    def spare_of_one(self) -> int:
        """Return the bytes that the window takes, which are to spare for one stream (`Carrier.spare`) at a time."""
        for each in self._carriers:
            each.spare = 0
        return self.window.limit - self.sent - self.gathered

    def charge(self, via: Carrier, sent: Iterable[tuple[SendingChannel, int]]) -> None:
        """Move the starts of routes' next turns on `via` by bytes that they send without waiting, as no turn is due.

        The link's time moves, too: else the routes would pay for these bytes once others wait.
        """
        for end, size in sent:
            start = max(end.start, self._time - via.behind)
            via.time = start
            self._time = start + via.behind
            end.start = start + size * _UNIT // end.route.weight

    def write(self, carrier: Carrier, data: bytes | memoryview) -> None:
        carrier.write(data, self.count(len(data)))

    def count(self, size: int) -> float:
        """Count bytes that are sent next, and return the time (s)."""
        if not self.sent:
            self.window.expect(self._book.ping())  # known by now: when the connection began, it was not
        now = self.now()
        self.window.wrote(self.sent, now)
        self.sent += size
        return now

    def run(self) -> None:
        """Give turns while streams and window take bytes."""
        # A turn asks its route for messages, which leads back here. And where the next pass is due already, it has to
        # wait for the other links' work.
        if self._passing or self._next_pass is not None:
            return
        left = _A_PASS
        if self._waiting:
            if self.gathered:  # else turns of the same routes would be sealed before it
                for each in self._carriers:
                    each.write_gathered()
            self._passing = True
            try:
                while left > 0 and (found := self._next()) is not None:
                    left -= self._give_turns(*found)
            finally:
                self._passing = False
        if not self._waiting:  # and not whenever none is queued: a route alone leaves the queue in each of its turns
            self._emptied()
        elif left <= 0:
            self._next_pass = asyncio.get_running_loop().call_soon(self._continue)

    def _emptied(self) -> None:
        # Where nothing more could go, the next message waits, too.
        if self.waits_since == math.inf or self.sent >= self.window.limit:
            return
        if not any(each.congested for each in self._carriers):
            self.waits_since = math.inf
            self.choose_sizes()

    def _continue(self) -> None:
        self._next_pass = None
        self.run()

    def _next(self) -> tuple[Carrier, float] | None:
        """Return the stream with the earliest turn, and when another one's comes, in the first one's virtual time.

        Returns:
            None if no stream with turns takes bytes.
        """
        if not self._waiting or self.sent >= self.window.limit:
            return None
        found: Carrier | None = None
        first = second = math.inf
        for carrier in self._carriers:
            queue = carrier.queue
            while queue and not queue[0][2].queued:
                heapq.heappop(queue)  # it has left
            if queue and not carrier.congested:
                start = queue[0][0] + carrier.behind
                if start < self._time:  # it was congested, and does not make up for that
                    carrier.behind += self._time - start
                    start = self._time
                if start < first:
                    found, first, second = carrier, start, first
                else:
                    second = min(second, start)
        if found is None:
            return None
        self._time = int(first)
        return found, second - found.behind

    def _give_turns(self, carrier: Carrier, until: float) -> int:
        """Give turns on one stream until they are worth a write, or others come first; return the bytes, at least 1."""
        queue = carrier.queue
        most = min(self._write, self.window.limit - self.sent)
        parts: list[bytes] = []
        size = 0
        while queue and size < most and queue[0][0] <= until:
            start, _, end = heapq.heappop(queue)
            if not end.queued:
                continue
            carrier.time = start
            self.leave(end)
            data = end.take_turn(self.chunk)
            taken = data if isinstance(data, int) else len(data)
            size += taken
            end.start = start + taken * _UNIT // end.route.weight
            end.turned = True
            if end.waits and end.via is carrier:
                self._push(end)
            elif end.waits:
                end.start = 0  # another stream's time
                self.join(end)
            else:
                end.waits_since = None
            if isinstance(data, bytes):
                parts.append(data)
            elif isinstance(data, memoryview):  # memory that the next piece uses again
                if parts:
                    self.write(carrier, b"".join(parts))
                    parts.clear()
                self.write(carrier, data)
                break
            elif carrier.congested:
                break
        if parts:
            self.write(carrier, parts[0] if len(parts) == 1 else b"".join(parts))
        return max(1, size)  # turns without bytes have to end a pass, too

    # --- receipts

    def acknowledge(self, gained: int, lost: int = 0) -> int:
        """Adapt to a receipt of `gained` further bytes, of which some are lost on the way of datagrams.

        Returns:
            The bytes after which the next receipt is wanted.
        """
        now = self.now()
        self.acknowledged += gained
        self.arrived += gained - lost
        if gained:
            self.acknowledged_at = now
        window = self.window
        window.acknowledge(self.acknowledged, self.sent, now, self._book.way_back())
        self.choose_sizes()
        self.run()
        return window.every

    def choose_sizes(self) -> None:
        """Choose how much goes at once: after a receipt, when a congested stream takes bytes, once nothing waits."""
        size, least = self.window.size, _LEAST_WRITE
        # Not only while a route is queued: all of them may have given all they had to a stream that is congested now.
        if self.waits_since < math.inf:
            size, least = min(size, int(self.window.rate * _BUSY_WINDOW)), LEAST_CHUNK
        self.chunk = min(_MOST_CHUNK, max(LEAST_CHUNK, size // _CHUNKS_PER_WINDOW))
        self._write = max(least, size // _WRITES_PER_WINDOW)

    def tick(self) -> None:
        """Close the window while the path is stalled, and open it if only a stream is. Called once a second."""
        self.window.check(self.sent, self.now(), self._book.way_back())
        if not self._waiting or self.sent < self.window.limit:
            return
        now = self.now()
        stuck = [each for each in self._carriers if each.is_stuck(now)]
        others = (each for each in self._carriers if each not in stuck)
        # Another one waits for the window that they fill.
        if stuck and any(end.queued for each in others for _, _, end in each.queue):
            for each in stuck:
                size = each.in_transit
                each.write_off()
                self.written_off(size)

    # --- figures

    def waits_for(self, now: float) -> float:
        """Return for how long (s) something has waited all the time, and not only for a path that takes nothing."""
        moving = (each for each in self._carriers if each.moves)
        if self.sent < self.window.limit and not any(each.queue or each.congested for each in moving):
            return 0.0
        return max(0.0, now - self.waits_since)

    def moving(self) -> set[Carrier]:
        """Return the carriers that deliver what they send."""
        return {each for each in self._carriers if each.moves}

    @property
    def stalls_after(self) -> float:
        """Seconds without a receipt after which a stream or socket delivers nothing."""
        return _STALLED + self._book.ping() + self._book.way_back()

    @property
    def held_by_growing_window(self) -> bool:
        """Whether messages wait though the link may carry more: the window still grows."""
        return self.grows and self.sent >= self.window.limit

    @property
    def grows(self) -> bool:
        """Whether the window still grows: what waits is no sign that the link carries no more."""
        return not self.window.slow


class SendingChannel(DataChannel):
    """The sending end of a route's channel, as far as it does not depend on what carries the messages.

    Args:
        via: what carries them first.

    Attributes:
        start: virtual time at which its next turn begins.
        route: whose messages it sends.
        waits_since: since when (s) it has waited for turns all the time, or None.
        turned: whether it has had one meanwhile.
    """

    via: Carrier

    def __init__(self, route: RouteSink, via: Carrier) -> None:
        self.start = 0
        self.queued = False
        self.waits_since: float | None = None
        self.turned = False
        self.via = via
        self.route = route
        self._scheduler = via.scheduler
        self._messages: deque[Message] = deque()  # of the present turn, or of a large message's further ones
        self._asked = False  # more waits in the route's queue
        self._in_turn = False

    @property
    def congested(self) -> bool:
        """Whether messages have to wait now: then `ask`."""
        # In its turn a route gives one batch: the rest stays in its queue, where newer messages replace it.
        if self._in_turn:
            return bool(self._messages)
        return not self.takes(0)

    @property
    def free(self) -> bool:
        """Whether it accepts messages now or in a round trip or two."""
        # What waits in a window that grows is no sign of an overload; in the kernel, the path may have stalled.
        return not self.congested or (self._scheduler.grows and not self.via.congested)

    def takes(self, size: int) -> bool:
        """Whether messages of `size` bytes together may be sent now, past the queue."""
        scheduler = self._scheduler
        if size > scheduler.chunk or self.queued or self._messages:
            return False
        via = self.via
        return size < via.spare or (scheduler.is_free and not via.congested)

    @property
    def batch_bytes(self) -> int:
        """Bytes to send at once; a single message may be longer."""
        return self._scheduler.chunk

    def still(self, now: float) -> float:
        """Return for how long (s) no receipt has come on the link, at `now` (s)."""
        return now - self._scheduler.acknowledged_at

    def behind(self, now: float) -> bool:
        """Whether it has had turns, and something was left each time, for a second, at `now` (s)."""
        return self.turned and self.waits_since is not None and now - self.waits_since >= _BEHIND

    def datagrams(self, size: int) -> int:
        """Return how many datagrams a message of `size` bytes takes now, or 0 on a stream; only once it is ready."""
        return 0

    @property
    def unheard_for(self) -> float:
        """Seconds since a receipt told of further datagrams; infinite before the first, and on a stream."""
        return math.inf

    @abstractmethod
    def send(self, batch: Sequence[Message]) -> None:
        """Send messages, oldest first."""

    def ask(self) -> None:
        """Have `RouteSink.flush` called once messages may be sent. Calling it again while they wait changes nothing."""
        self._asked = True
        if not self._in_turn:
            self._scheduler.join(self)
            self._scheduler.run()

    # --- turns

    @property
    def waits(self) -> bool:
        """Whether it has more to send after a turn."""
        return self._asked or bool(self._messages)

    @abstractmethod
    def take_turn(self, limit: int) -> bytes | memoryview | int:
        """Return at most about `limit` bytes to send now, or nothing; or how many it has sent by itself."""

    def _wait(self, batch: Sequence[Message]) -> None:
        """Wait for a turn with messages that the queue has given already."""
        self._messages += batch
        self._scheduler.join(self)
        self._scheduler.run()

    def _fill(self) -> bool:
        """Take messages from the route's queue for this turn; return whether there are any."""
        self._asked, self._in_turn = False, True
        try:
            self.route.flush()
        finally:
            self._in_turn = False
        if self._messages:
            return True
        self._asked = False  # a route that asks and gives nothing would get turns without end
        return False

    def leave(self) -> None:
        self._messages.clear()
        self._asked = False
        self._scheduler.leave(self)
