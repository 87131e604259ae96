"""The pace of datagrams: the rate of their path, and how much may be sent now. Uses neither sockets nor clocks."""

from __future__ import annotations

import math
from collections import deque

# Where these were measured: bench/README.md, *Constants of datagrams*.
# Of the path's rate (`PathRate`). Those with a star are BBR's.
_FIRST_PACE = 128e6  # bytes/s before anything has arrived; the link's window grows from little meanwhile
_GROWING, _PROBING, _DRAINING = 2.9, 1.25, 0.75  # * paces in ratio to the rate: at first; in the first span; the second
_SPANS = 8  # * of one round of probing and draining
_GROWS, _FULL_AFTER = 1.25, 3  # * it grows no more after so many spans in which it has grown by less
_OVERFLOWS = 0.8  # nor once less than this part arrives
_SPAN, _ROUND_TRIPS = 0.005, 2.0  # s and round trips of a span, at least: radios deliver in lumps
_REMEMBERED, _REMEMBERED_SPANS = 1.0, 10  # * s and spans, at least, for which the greatest rate counts
_SHORTEST_COUNTS = 10.0  # * s for which the shortest round trip counts: a path may change to a longer one
_QUEUE = 0.05  # s: what crosses in it may wait on the path, besides two round trips
LEAST_ON_PATH = 32 * 1024  # bytes that may be on any path: a slow one is left to the link's window
_ENOUGH = 20  # datagrams of a span that tell how many get lost by chance: of fewer, a single one is more than 5 %
_SLOWER = 0.9  # part of the sent rate below which arrivals show the path's rate, and not only that it carries as much

# Of the pace (`Pacer`)
_PAUSE = 0.001  # s that the I/O loop's timers resolve
_NO_PAUSE = 0.005  # s in which a busy I/O loop may not come to send although something waits
_LEAST_BURST, _BURST_LASTS = 16 * 1024, 0.005  # bytes at once after a pause: so many, or what crosses in so many s
WINDOW = 2  # the part of the receiver's buffer that one route may fill: its routes share it, small datagrams cost more
_PATIENCE = 0.25  # s without a receipt, or two round trips if they take longer


class PathRate:
    """The rate of a path by arriving datagrams, and the pace at which no queue fills up. Times are in s.

    Nothing repairs datagrams, so their arrivals in a span of time are the rate of the path. Loss and delay tell less: a
    radio loses packets at any pace, and a short queue overflows before the link's window takes a byte for late. At 20
    Mbit/s, with a queue of 0.16 s and 2 % lost, messages of 4 kB arrived to 58 % while the window alone limited them
    (`bench.robot`). The idea and its gains are from Cardwell et al. 2016, "BBR: Congestion-Based Congestion Control".

    The receiver's kernel says when datagrams arrive, so that a process that gets no processor changes no rate. A span
    lowers the rate only if it shows the path's limit: the path was slower than the sender, or its queue is long.

    Attributes:
        pace: bytes/s at which datagrams may be sent.
        crossing: bytes that are on the path while nothing waits there.
        most: bytes that may be on the path.
    """

    def __init__(self) -> None:
        self.pace = _FIRST_PACE
        self.crossing, self.most = 0, LEAST_ON_PATH
        self._rates: deque[tuple[float, float]] = deque()  # ends of spans (s) with their rates (bytes/s)
        self._round_trips = _Least()
        self._delays = _Least()  # from this clock to the receiver's
        self._began: float | None = None  # on the receiver's clock
        self._bytes = 0.0
        self._passed = self._opened = 0
        self._sent_at = 0.0
        self._shares: deque[float] = deque((1.0,), maxlen=_SPANS)  # of the datagrams of a span, that have arrived
        self._full = self._span = 0
        self._was_full = False  # in any span
        self._gain = _GROWING

    @property
    def known(self) -> bool:
        """Whether the rate has stopped growing, so that waiting datagrams show an overload."""
        return self._gain != _GROWING

    def passed(
        self, size: float, datagrams: int, opened: int, sent_at: float, arrived_at: float, now: float, *, limited: bool
    ) -> bool:
        """Count datagrams of which a receipt tells.

        Args:
            size: bytes of the datagrams, lost ones included.
            opened: how many of the datagrams have arrived.
            sent_at: when the last one was sent.
            arrived_at: when it arrived, on the receiver's clock.
            limited: whether pace or path have held any back in this span.

        Returns:
            whether a span ends here.
        """
        round_trip, delay = now - sent_at, arrived_at - sent_at
        shortest = self._round_trips.note(round_trip, now)
        queue = delay - self._delays.note(delay, now)
        if self._began is None:  # these datagrams were sent before the span begins
            self._begin(sent_at, arrived_at)
            return False
        if limited and not self.known and queue < _QUEUE + shortest:
            # It doubles in a round trip, as TCP's window does in slow start, until a queue shows.
            self.most += int(size)
        self._bytes += size * opened / datagrams
        self._passed += datagrams
        self._opened += opened
        lasted = arrived_at - self._began
        # Not by the present round trip alone: in a full queue it is long, and the pace would shrink late.
        if lasted < max(_SPAN, _ROUND_TRIPS * min(round_trip, shortest + _QUEUE)):
            return False
        # What a radio holds back, and then delivers at once, did not cross faster than it was sent.
        took = sent_at - self._sent_at
        rate = self._bytes / max(lasted, took)
        slower = self._opened * took < _SLOWER * max(self._shares) * self._passed * lasted
        self._note(rate, now, limited=limited, full=limited and (slower or queue > _QUEUE / 2))
        self._begin(sent_at, arrived_at)
        return True

    def interrupted(self) -> None:
        """Begin a new span with the next receipt."""
        self._began = None

    def silent(self, *, full: bool) -> None:
        """Note that receipts stay away; a path that is `full` may carry far less than it did."""
        self._began = None
        if full:
            self._rates = deque((when, rate / 2) for when, rate in self._rates)
            self._set()

    def _begin(self, sent_at: float, arrived_at: float) -> None:
        self._began, self._sent_at = arrived_at, sent_at
        self._bytes = 0.0
        self._passed = self._opened = 0

    def _note(self, rate: float, now: float, *, limited: bool, full: bool) -> None:
        """Take the rate of a span in which the routes wanted more, if `limited`, and the path was `full`."""
        rates = self._rates
        before = max((each for _, each in rates), default=0.0)
        if rate <= 0.0:
            return  # receipts of several routes do not add up yet
        if full or rate > before:
            rates.append((now, rate))
            while len(rates) > _REMEMBERED_SPANS and rates[0][0] < now - _REMEMBERED:
                rates.popleft()
        self._was_full |= full
        if limited:
            self._choose_gain(before, full=full)
        self._set()

    def _choose_gain(self, before: float, *, full: bool) -> None:
        """Grow, or go on with probing and draining, after a span; `before` is the greatest rate before it."""
        greatest = max(rate for _, rate in self._rates)
        enough = self._passed >= _ENOUGH
        if self.known:
            if enough:
                self._shares.append(self._opened / self._passed)
            # As long as probing finds more, it goes on.
            self._span = 0 if self._span == 0 and greatest > before else (self._span + 1) % _SPANS
        elif full:
            overflows = enough and self._opened < _OVERFLOWS * self._passed
            grows = greatest > _GROWS * before
            self._full = _FULL_AFTER if overflows else 0 if grows else self._full + 1
            self._span = int(self._full >= _FULL_AFTER)  # the queue is full now
        if self.known or self._span:
            self._gain = {0: _PROBING, 1: _DRAINING}.get(self._span, 1.0)

    def _set(self) -> None:
        if not self._rates:
            return
        # What is lost in the best span is lost at any pace, and has crossed the narrowest part of the path, or would.
        carries = max(rate for _, rate in self._rates) / max(self._shares)
        self.pace = self._gain * carries
        if not self._was_full:  # little was sent until then; the path was not slow
            self.pace = max(_FIRST_PACE, self.pace)
        self.crossing = int(carries * self._round_trips.least)
        least = LEAST_ON_PATH if self.known else self.most
        self.most = max(least, int(carries * _QUEUE) + 2 * self.crossing)


class _Least:
    """The least of the values that came in the last `_SHORTEST_COUNTS` s."""

    def __init__(self) -> None:
        self._values: deque[tuple[float, float]] = deque()  # when (s), and the value: later ones are greater

    @property
    def least(self) -> float:
        return self._values[0][1]

    def note(self, value: float, now: float) -> float:
        """Take a value, and return the least."""
        values = self._values
        while values and values[-1][1] >= value:
            values.pop()
        values.append((now, value))
        while values[0][0] < now - _SHORTEST_COUNTS:
            values.popleft()
        return values[0][1]


class Pacer:
    """The pace of a socket's datagrams. It sends nothing itself; times are in s, on one clock.

    Attributes:
        window: bytes that may be in the receiver's buffer, or 0 if unknown.
        round_trip: s from a datagram to its receipt, the last time; 0 before the first.
    """

    def __init__(self) -> None:
        self.window = 0
        self.path = PathRate()
        self._tokens = self._burst = self.path.pace * _BURST_LASTS
        self._filled_at = 0.0
        self._limited = self._is_held = self._was_idle = False
        self._sent, self._sent_at = 0, 0.0
        self._arrived = 0
        self._under_way: deque[tuple[int, int, float]] = deque()  # last sequence number, bytes sent with it, when
        self._passed = (-1, 0)  # the last receipted sequence number, and bytes sent up to it
        self._heard_at = 0.0
        self._newest, self._opened = -1, 0
        self.round_trip = 0.0

    def room(self, now: float, waits_since: float = math.inf) -> int:
        """Return the bytes that may be sent now; none if it is 0 or less.

        Args:
            waits_since: since when something has waited for the link, or infinity if nothing waits.
        """
        tokens = self._tokens = min(self._tokens + (now - self._filled_at) * self.path.pace, self._burst)
        self._filled_at = now
        if self.window:
            tokens = min(tokens, self.limit - self.in_transit)
        if tokens < 1:
            self._limited = self._is_held = True
        elif not self._is_held and now - self._sent_at > _NO_PAUSE and waits_since > self._sent_at:
            self._was_idle = True
        return int(tokens)

    @property
    def limit(self) -> int:
        """Bytes that may be in transit: on the path and in the receiver's buffer."""
        return min(self.window + self.path.crossing, self.path.most)

    @property
    def in_transit(self) -> int:
        """Bytes that are neither receipted nor written off."""
        return self._sent - self._arrived

    def gives_up(self, now: float) -> bool:
        """Whether no more may be in transit, but only because receipts were lost."""
        if not self.window or not self._under_way or self.limit > self.in_transit:
            return False
        return now - max(self._under_way[-1][2], self._heard_at) >= self.patience

    @property
    def patience(self) -> float:
        """The time (s) without a receipt after which a full path seems to carry nothing."""
        return max(_PATIENCE, 2 * self.round_trip)

    def write_off(self) -> None:
        """Count all bytes as arrived or lost."""
        if self._under_way:
            self.path.silent(full=self.in_transit >= self.limit)
            self._arrived = self._sent
            self._passed = self._under_way[-1][:2]
            self._under_way.clear()

    def pause(self) -> float:
        """Time (s) until it is worth asking for room again, where no receipt comes before."""
        if self._tokens >= 1 and self.window:
            return self.patience
        # Half of a burst is worth waking up for.
        return min(_BURST_LASTS, max(_PAUSE, (self._burst / 2 - self._tokens) / self.path.pace))

    def sent(self, size: int, sequence: int, now: float) -> None:
        """Note that `size` bytes were sent; the last datagram had this sequence number."""
        if self._was_idle:
            # A pause says nothing about the path: images at 30 Hz would each be spread over 33 ms.
            self._was_idle = self._limited = False
            self.path.interrupted()
        self._is_held = False
        self._sent_at = now
        self._tokens -= size
        self._sent += size
        self._under_way.append((sequence, self._sent, now))

    def receipt(self, newest: int, opened: int, buffer: int, arrived_at: float, now: float) -> None:
        """Take a receipt.

        Args:
            newest: the highest sequence number opened.
            opened: datagrams opened so far.
            buffer: bytes of the receiver's buffer.
            arrived_at: when the newest datagram arrived, on the receiver's clock.
        """
        if newest <= self._newest:
            return  # another one has overtaken it
        self.window = max(buffer // WINDOW, 1)  # 0 would mean that it is unknown
        self._heard_at = now
        before, sent_at = self._arrived, None
        while self._under_way and self._under_way[0][0] <= newest:
            last, self._arrived, sent_at = self._under_way.popleft()
            self._passed = last, self._arrived
        if self._under_way:  # a part of the last burst has arrived
            (begin, reached), (last, after, at) = self._passed, self._under_way[0]
            part = (newest - begin) / (last - begin)
            self._arrived = max(self._arrived, reached + int(part * (after - reached)))
            if newest > begin:  # else it is a late receipt of datagrams that are written off
                sent_at = at if sent_at is None else sent_at
        # A peer may claim that more have arrived than were sent.
        datagrams, arrived = newest - self._newest, min(max(0, opened - self._opened), newest - self._newest)
        self._newest, self._opened = newest, max(opened, self._opened)
        if sent_at is None:
            return
        self.round_trip = now - sent_at
        size = self._arrived - before
        if self.path.passed(size, datagrams, arrived, sent_at, arrived_at, now, limited=self._limited):
            self._limited = False
            self._burst = max(_LEAST_BURST, self.path.pace * _BURST_LASTS)
