"""Measures the rate of a path by arriving datagrams, and keeps the pace at which no queue fills up.

Nothing repairs datagrams, so their arrivals in a span of time are the rate of the path. Loss and delay tell less: a
radio loses packets at any pace, and a short queue overflows before the link's window takes a byte for late. At 20
Mbit/s, with a queue of 0.16 s and 2 % lost, messages of 4 kB arrived to 58 % while the window alone limited them
(`bench.robot`). The idea and its gains are from Cardwell et al. 2016, "BBR: Congestion-Based Congestion Control".
"""

from __future__ import annotations

from collections import deque

_FIRST_PACE = 128e6
"""Bytes/s before anything has arrived, about 1 Gbit/s; the link's window grows from little meanwhile."""
LEAST_ON_PATH = 32 * 1024
"""Bytes that may be on any path: a slow one is left to the link's window, and a receipt for less costs too much.
A round figure: nothing was measured."""
_GROWING, _PROBING, _DRAINING = 2.9, 1.25, 0.75
"""Paces in ratio to the path's rate: until it grows no more; in the first of `_SPANS` spans; and in the second. They
are BBR's (2 / ln 2, 5/4, 3/4). On the simulated radio of 20 Mbit/s in tests/channel/test_pacing.py, probing at 1.05
finds 64 % of the rate, and 1.25 all. Without draining, its queue holds 0.03 to 0.06 s at the median instead of 0.02."""
_SPANS, _GROWS, _FULL_AFTER, _OVERFLOWS = 8, 1.25, 3, 0.8
"""It grows no more after so many spans in which it has grown by less, or once less than this part arrives. All but the
last are BBR's. Without the last, a simulated switch of 40 MB/s lost 41 % in the second quarter of a second instead of
12 %; from 0.5 to 0.95 it made no difference."""
_SPAN, _ROUND_TRIPS = 0.005, 2.0
"""A span takes so many s and round trips, at least: radios deliver in lumps. On the simulated radio, 0.5 to 50 ms and 1
or 2 round trips make no difference; with 4, its queue of 0.16 s was nearly full in one of two runs."""
_REMEMBERED, _REMEMBERED_SPANS = 1.0, 10
"""The greatest rate counts for so many s and spans, at least. Ten are BBR's; 0.1 to 10 s, and 3 to 30 spans, make no
difference on the simulated radio."""
_QUEUE = 0.05
"""The path may hold what crosses in so many s and in two of its shortest round trips, since a radio's vary. At p99 the
simulated radio's queue of 0.16 s then holds 0.07 s, and with 0.2 it is full."""
_SHORTEST_COUNTS = 10.0
"""s for which the shortest round trip counts, as in BBR: a path may change to a longer one."""
_ENOUGH = 20
"""Datagrams of a span that tell how many get lost by chance: of fewer, a single one is more than 5 %."""


class PathRate:
    """The rate of a path. Times are in s, on one clock.

    Attributes:
        pace: bytes/s at which datagrams may be sent.
        crossing: bytes that are on the path while nothing waits there.
        most: bytes that may be on the path.
    """

    def __init__(self) -> None:
        self.pace = _FIRST_PACE
        self.crossing, self.most = 0, LEAST_ON_PATH
        self._rates: deque[tuple[float, float]] = deque()  # ends of spans (s) with their rates (bytes/s)
        self._round_trips: deque[tuple[float, float]] = deque()  # when (s), and how long (s): later ones are longer
        self._began: float | None = None
        self._bytes = 0.0
        self._passed = self._opened = 0
        self._sent_at = 0.0
        self._shares: deque[float] = deque((1.0,), maxlen=_SPANS)  # of the datagrams of a span, that have arrived
        self._full = self._span = 0
        self._gain = _GROWING

    @property
    def known(self) -> bool:
        """Whether the rate has stopped growing, so that waiting datagrams show an overload."""
        return self._gain != _GROWING

    def passed(self, size: float, datagrams: int, opened: int, sent_at: float, now: float, *, limited: bool) -> bool:
        """Count datagrams of which a receipt tells.

        Args:
            size: bytes of the datagrams, lost ones included.
            opened: how many of the datagrams have arrived.
            sent_at: when the last one was sent.
            limited: whether pace or path have held any back in this span.

        Returns:
            whether a span ends here.
        """
        round_trip = now - sent_at
        while self._round_trips and self._round_trips[-1][1] >= round_trip:
            self._round_trips.pop()
        self._round_trips.append((now, round_trip))
        while self._round_trips[0][0] < now - _SHORTEST_COUNTS:
            self._round_trips.popleft()
        if self._began is None:  # these datagrams were sent before the span begins
            self._begin(sent_at, now)
            return False
        if limited and self._gain == _GROWING and round_trip < _QUEUE + 2 * self._round_trips[0][1]:
            # It doubles in a round trip, as TCP's window does in slow start, until a queue shows.
            self.most += int(size)
        self._bytes += size * opened / datagrams
        self._passed += datagrams
        self._opened += opened
        lasted = now - self._began
        # Not by the present round trip alone: in a full queue it is long, and the pace would shrink late.
        if lasted < max(_SPAN, _ROUND_TRIPS * min(round_trip, self._round_trips[0][1] + _QUEUE)):
            return False
        # What a radio holds back, and then delivers at once, did not cross faster than it was sent.
        self._note(self._bytes / max(lasted, sent_at - self._sent_at), now, limited=limited)
        self._begin(sent_at, now)
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

    def _begin(self, sent_at: float, now: float) -> None:
        self._began, self._sent_at = now, sent_at
        self._bytes = 0.0
        self._passed = self._opened = 0

    def _note(self, rate: float, now: float, *, limited: bool) -> None:
        rates = self._rates
        before = max((each for _, each in rates), default=0.0)
        if rate <= 0.0 or (not limited and rate <= before):
            return  # the routes had nothing more to send, or receipts of several routes do not add up yet
        rates.append((now, rate))
        while len(rates) > _REMEMBERED_SPANS and rates[0][0] < now - _REMEMBERED:
            rates.popleft()
        greatest = max(each for _, each in rates)
        if self._passed >= _ENOUGH and self._gain != _GROWING:
            self._shares.append(self._opened / self._passed)
        if self._gain != _GROWING:
            # As long as probing finds more, it goes on.
            self._span = 0 if self._span == 0 and greatest > before else (self._span + 1) % _SPANS
        elif limited:  # the routes wanted more: else a rate that does not grow shows no full path
            overflows = self._passed >= _ENOUGH and self._opened < _OVERFLOWS * self._passed
            grows = greatest > _GROWS * before
            self._full = _FULL_AFTER if overflows else 0 if grows else self._full + 1
            self._span = int(self._full >= _FULL_AFTER)  # the queue is full now
        if self._gain != _GROWING or self._span:
            self._gain = {0: _PROBING, 1: _DRAINING}.get(self._span, 1.0)
        self._set()

    def _set(self) -> None:
        if not self._rates:
            return
        # What is lost in the best span is lost at any pace, and has crossed the narrowest part of the path, or would.
        carries = max(rate for _, rate in self._rates) / max(self._shares)
        self.pace = self._gain * carries
        self.crossing = int(carries * self._round_trips[0][1])
        least = self.most if self._gain == _GROWING else LEAST_ON_PATH
        self.most = max(least, int(carries * _QUEUE) + 2 * self.crossing)
