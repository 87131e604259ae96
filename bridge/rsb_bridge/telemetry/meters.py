"""Rates, usual rates, throughput, latencies and clock offsets. Nothing here reads a clock: callers pass the time in."""

from __future__ import annotations

from collections import deque
from math import ceil, inf, sqrt

from rsb_bridge.model.capacity import Capacity, CapacitySource, newer

HISTORY = 120  # s that a route keeps, and the console plots

# Of rates.
_WINDOWS = (3, 10, 30)  # s that a rate is taken over; ascending
_SHORTEST_TICK = 0.5  # s; a shorter tick is left to the next one: one message in it says nothing about a rate
_LEAST = 1e-3  # a second; a smaller smoothed rate is 0, which halving alone would never reach
_JUDGED_OVER = 3.0  # messages, and s: a rate is judged over the longer of both (`rsb_bridge.telemetry.watches`)

# Of usual rates.
_SAMPLES, _ENOUGH = 20, 15  # that are judged, at most and at least: 15 s of a busy topic, 15 messages of a slow one
_RHYTHM_SAMPLES, _RHYTHM_STEADY = 5, 0.1  # that show a rhythm, as an operator's clicks do not, and how steady they are
_STEADY = 0.15  # of the rate over so long: the standard deviation that it may have; watches call less than 0.7 slow
_CHANGED = 0.15  # share of the rate beyond which a change is no noise: no more than `_STEADY` allows
_LOWER_FOR = 600.0  # s that a lower rate lasts until it is the usual one
_NO_SAMPLES = 0, 0.0, 0.0  # sums over no samples: of gaps, of s, and of the squares of s by their gaps
_AT_ONE_MOMENT = 1e-9  # s from one message to the next, up to which all came at once, with what rounding adds
_MOST_NUMBERS = 16  # of publishers, of which the rates are remembered: a round figure
_LONGEST_GAP = 60.0  # s; a topic with longer ones has no usual rate: to learn it would take a quarter of an hour
_QUIET_PERIODS, _QUIET = 5.0, 3.0  # periods, and s, without a message after which an outage has begun

# Of latencies.
_LATENCIES = 512  # samples that percentiles are taken of: the 99th rests on the five largest
_EARLIEST, _LATEST = -1.0, 3600.0  # s, with the error of comparing clocks; on a slow radio, messages wait for minutes
_LARGEST_FIGURE = 1e9  # s; a peer may report any number, and screens and JSON show it
_NO_FIGURES = None, None

# Of clocks.
_PINGS = 16  # exchanges, one a second: the shortest is hardly held up, and a clock that drifts is followed
_DRIFT_RATE, _DRIFT = 1e-4, 2e-3  # s by which two clocks drift apart in a second, and over as many pings, at 100 ppm

# s that a shortest time counts, about, and of the parts that are forgotten at once. Round figures: a link may be full
# for many minutes, and a path that became longer must not seem full for days.
_SHORTEST_COUNTS, _PART = 3600.0, 600.0

_WINDOW, _ENOUGH_ARRIVALS = 4, 3  # looks, about 1 s each, of a throughput, and that say what a link carries


class Smoothed:
    """A rate that is smoothed over about two seconds."""

    __slots__ = ("_at", "rate")

    def __init__(self, now: float) -> None:
        self.rate = 0.0
        self._at = now

    def add(self, amount: float, now: float) -> None:
        """Take what has come since the last call, at `now` (s)."""
        elapsed = now - self._at
        if elapsed > 0:
            self._at = now
            rate = self.rate + (1 - 0.5**elapsed) * (amount / elapsed - self.rate)
            self.rate = rate if rate >= _LEAST else 0.0


class RateMeter:
    """Counts messages and bytes; `tick`, called about once a second, makes rates of them.

    Attributes:
        last: s, when the last message came, or None before the first.
        rate: Hz, over the shortest of 3, 10 and 30 s that holds at least three messages, and never above one message in
            the seconds since the last one.
        usual_rate: Hz (`UsualRate`), or None if it is unknown yet or messages have none.
        publishers: number of publishers that the usual rate is learned of.
        history: messages in each of the last seconds, oldest first.
    """

    __slots__ = (
        "_at_tick", "_bytes_at_tick", "_marks", "_quiet", "_smoothed", "_ticked", "_usual", "bytes", "count", "history",
        "last", "publishers", "rate",
    )  # fmt: skip

    def __init__(self, now: float) -> None:
        self.count = 0
        self.bytes = 0
        self.last: float | None = None
        self.rate = 0.0
        self.publishers = 1
        self.history: deque[int] = deque(maxlen=HISTORY)
        self._ticked = now
        self._at_tick = 0
        self._bytes_at_tick = 0
        self._smoothed = Smoothed(now)
        # Messages, and s, until the end of each of the last seconds; the first one is where the longest window begins.
        self._marks: deque[tuple[int, float]] = deque([(0, 0.0)], maxlen=_WINDOWS[-1] + 1)
        self._quiet = HISTORY  # entries of the history since the last one with messages
        self._usual = UsualRate()

    @property
    def usual_rate(self) -> float | None:
        return self._usual.rate

    @property
    def regular(self) -> bool:
        """Whether messages came at a rhythm, so that silence is a fault."""
        return self._usual.regular

    @property
    def bytes_per_second(self) -> float:
        """Smoothed over about two seconds."""
        return self._smoothed.rate

    def add(self, messages: int, size: int, now: float) -> None:
        """Count messages of `size` bytes together, at `now` (s)."""
        self.count += messages
        self.bytes += size
        self.last = now

    def tick(self, now: float, *, learns: bool = True) -> None:
        """Add what has come since the last tick to the history, as the seconds that it took.

        Args:
            learns: whether the usual rate is learned from it.
        """
        elapsed = now - self._ticked
        if elapsed < _SHORTEST_TICK:
            return
        messages, self._at_tick = self.count - self._at_tick, self.count
        if messages:
            self._usual.published_by(self.publishers)
        if learns:
            self._usual.add(messages, self.last, now)
        else:
            self._usual.skip(now)
        self._add_seconds(messages, now)
        self._smoothed.add(self.bytes - self._bytes_at_tick, now)
        self._bytes_at_tick = self.bytes
        if messages or self.rate:
            self.rate = self._rate()

    def goes_on(self, now: float) -> bool:
        """Whether messages have come at their usual rate since the last tick, until `now` (s)."""
        usual, last = self._usual.rate, self.last
        if usual is None or last is None or now - last > max(1.0, 2 / usual):
            return False
        due = usual * (now - self._ticked)
        return abs(self.count - self._at_tick - due) <= _CHANGED * due + 1  # one more may be about to come

    @property
    def still(self) -> bool:
        """Whether both rates are 0, as they are while nothing comes."""
        return not (self.rate or self._smoothed.rate)

    def rested(self, until: float) -> None:
        """Take over that nothing came until `until` (s), instead of a tick in each second since the last one.

        Only while it is `still`; then it gives the same figures.
        """
        self._smoothed.add(0.0, until)
        if until - self._ticked >= _SHORTEST_TICK:
            self._usual.rested(until)
            self._add_seconds(0, until)

    def is_blank(self, now: float) -> bool:
        """Whether the history is full, and has no message, at `now` (s), if none has come since the last tick."""
        return min(self._quiet, len(self.history)) + now - self._ticked >= HISTORY

    def history_at(self, now: float) -> tuple[int, ...]:
        """Return the history, to which nothing has come since the last tick until `now` (s)."""
        quiet = min(HISTORY, max(0, int(now - self._ticked)))
        return *[*self.history][max(0, len(self.history) + quiet - HISTORY) :], *[0] * quiet

    def _add_seconds(self, messages: int, now: float) -> None:
        """Add messages to the history, as the seconds that they took."""
        elapsed, self._ticked = now - self._ticked, now
        if not messages and self._quiet >= HISTORY == len(self.history):
            return  # one quiet second more makes no difference
        seconds = max(1, round(elapsed))
        length = elapsed / seconds
        # A process may have been stopped for hours, which make one tick.
        for number in range(max(0, seconds - HISTORY), seconds):
            share = messages * (number + 1) // seconds - messages * number // seconds
            count, end = self._marks[-1]
            self._marks.append((count + share, end + length))
            self.history.append(round(share / length))
            self._quiet = 0 if self.history[-1] else self._quiet + 1

    def _rate(self) -> float:
        """Return the rate, or 0 once an expected message is missing; a silent second makes it no higher."""
        usual = self._usual.rate
        missed = max(_WINDOWS[0], 3 / usual) if usual else _WINDOWS[-1]
        if self._quiet >= int(missed):
            return 0.0
        count, end = self._marks[-1]
        messages, seconds = 0, 0.0
        for window in _WINDOWS:
            count_before, begin = self._marks[max(0, len(self._marks) - 1 - window)]
            messages, seconds = count - count_before, end - begin
            if messages >= 3:
                break
        rate = messages / seconds if seconds else 0.0
        return min(rate, 1 / self._quiet) if self._quiet else rate


class LatencyMeter:
    """One-way latency of a route and its jitter (RFC 3550 section 6.4.1), in seconds.

    Args:
        lasts: s for which a sample counts, or 0 if it counts until enough others have come.

    Attributes:
        newest: the last sample, or None without one.
        jitter: or None without a figure.
        recent: median of the samples of the second before the last tick, or None without one.
    """

    __slots__ = (
        "_counts", "_fresh", "_lasts", "_reported", "_reported_until", "_samples", "_ticked", "jitter", "newest",
        "recent",
    )  # fmt: skip

    def __init__(self, lasts: float = 0.0) -> None:
        self._samples: deque[float] = deque(maxlen=_LATENCIES)
        self._lasts = lasts
        self._counts: deque[tuple[float, int]] = deque()  # the last ticks (s), and samples in each
        self._fresh = 0  # samples since the last tick
        self._ticked: float | None = None  # s
        self._reported: tuple[float | None, float | None] = _NO_FIGURES  # by the other side
        self._reported_until = 0.0  # s
        self.newest: float | None = None
        self.recent: float | None = None
        self.jitter: float | None = None

    def add(self, transit: float) -> None:
        """Take one message's transit time (s): arrival on our clock minus departure on the peer's.

        An implausible time means that a clock was set: the samples are dropped.
        """
        if not _EARLIEST < transit <= _LATEST:
            self._samples.clear()
            self._counts.clear()
            self.newest = self.jitter = None
            self._fresh = 0
            return
        if self.newest is not None:
            jitter = self.jitter or 0.0
            self.jitter = jitter + (abs(transit - self.newest) - jitter) / 16
        self.newest = transit
        self._samples.append(transit)
        self._fresh += 1

    def take_reported(self, p50: float | None, p99: float | None, jitter: float | None, now: float) -> None:
        """Take the figures of the other side, as far as they can be right. They, too, count for a while."""
        self._reported, self._reported_until = (_possible(p50), _possible(p99)), now + self._lasts
        self.jitter = _possible(jitter)

    def tick(self, now: float) -> None:
        """Drop the samples and the reported figures that no longer count at `now` (s)."""
        if now >= self._reported_until:
            self._reported = _NO_FIGURES
        fresh, self._fresh, self.recent = self._fresh, 0, None
        seconds = 1 if self._ticked is None else max(1, round(now - self._ticked))
        self._ticked = now
        if fresh:
            newest = sorted([*self._samples][-ceil(fresh / seconds) :])
            self.recent = newest[len(newest) // 2]
        counts, samples = self._counts, self._samples
        if self._lasts and (fresh or counts):
            counts.append((now, fresh))
            while now - counts[0][0] >= self._lasts:
                counts.popleft()
            count = sum([each for _, each in counts])
            while len(samples) > count:
                samples.popleft()

    def percentiles(self) -> tuple[float | None, float | None]:
        """Return the 50th and the 99th over the samples that count, or those of the other side; sorted each time."""
        if not self._samples:
            return self._reported
        ordered = sorted(self._samples)
        return ordered[len(ordered) // 2], ordered[min(len(ordered) - 1, len(ordered) * 99 // 100)]

    @property
    def is_blank(self) -> bool:
        """Whether there are no samples, and the other side's figures no longer count."""
        return not self._samples and self._reported == _NO_FIGURES


def _possible(figure: float | None) -> float | None:
    """Return a figure that a peer reports, or None if it has none or an impossible one."""
    # NaN compares as false.
    return figure if figure is not None and -_LARGEST_FIGURE <= figure <= _LARGEST_FIGURE else None


class ClockOffset:
    """The peer's clock minus ours, from pings (RFC 5905 section 8: offset and delay from four timestamps).

    Attributes:
        rtt: s, of the last exchange, or None before the first.
        offset: s, of the exchange with the least uncertainty among the last ones and the best earlier one, or None
            before the first.
        uncertainty: s: half the round trip, which bounds the error on asymmetric paths, too, plus the clocks' possible
            drift since. So a long delay on the path is not taken for an offset.
    """

    __slots__ = ("_best", "_samples", "offset", "rtt", "uncertainty")

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float, int]] = deque(maxlen=_PINGS)  # round trip, offset, when it came back
        self._best: tuple[float, float, int] | None = None
        self.rtt: float | None = None
        self.offset: float | None = None
        self.uncertainty: float | None = None

    def add(self, sent: int, received: int, answered: int, back: int) -> None:
        """Take one exchange. All in ns: sent and back on our clock, received and answered on the peer's."""
        # It is negative where a clock was set meanwhile, and would be the shortest of all.
        self.rtt = max(0, (back - sent) - (answered - received)) / 1e9
        offset = ((received - sent) + (answered - back)) / 2e9
        if self._stepped(offset, self.rtt / 2):
            self._samples.clear()
            self._best = None
        self._samples.append((self.rtt, offset, back))
        shortest = min(self._samples)  # by the round trip, which comes first
        self.uncertainty = shortest[0] / 2
        # A path that holds up all pings of the window must not move the clock: the best one from before counts on,
        # until the drift since then may be larger.
        if self._best is not None and self._best not in self._samples:
            rtt, _, at = self._best
            older = rtt / 2 + _DRIFT_RATE * abs(back - at) / 1e9
            if older < self.uncertainty:
                self.uncertainty, shortest = older, self._best
        self._best = shortest
        self.offset = shortest[1]

    def _stepped(self, offset: float, uncertainty: float) -> bool:
        """Whether one of the clocks was set: two exchanges contradict each other, each within its bounds."""
        if self.offset is None or self.uncertainty is None:
            return False
        return abs(offset - self.offset) > uncertainty + self.uncertainty + _DRIFT


class Shortest:
    """The shortest of the times that something took in the last hour, in which a path may become longer."""

    __slots__ = ("_parts",)

    def __init__(self) -> None:
        self._parts: deque[tuple[float, float]] = deque()  # beginnings (s), and the shortest times since

    def add(self, seconds: float, now: float) -> float:
        """Take a time, and return the shortest one."""
        parts = self._parts
        if not parts or now - parts[-1][0] >= _PART:
            parts.append((now, seconds))
        elif seconds < parts[-1][1]:
            parts[-1] = parts[-1][0], seconds
        while now - parts[0][0] > _SHORTEST_COUNTS:
            parts.popleft()
        return min([shortest for _, shortest in parts])


class StaleWatch:
    """The thesis's stale warning: after every `after` s without a message, `times` times, then silence.

    Attributes:
        warned: warnings since the last message.
        quiet_since: time (s) of the last message, or when counting began again.
    """

    __slots__ = ("after", "quiet_since", "times", "warned")

    def __init__(self, after: float, times: int, now: float) -> None:
        self.after = after
        self.times = times
        self.warned = 0
        self.quiet_since = now

    def seen(self, now: float) -> float | None:
        """Note a message at `now`; return the length of the silence (s) if it had been warned of, else None."""
        quiet = now - self.quiet_since if self.warned else None
        self.warned = 0
        self.quiet_since = now
        return quiet

    def rearm(self, now: float) -> None:
        """Restart the clock: a route that was just opened or resumed is not late yet."""
        self.warned = 0
        self.quiet_since = now

    def check(self, now: float) -> int:
        """Return the number of the warning that is due at `now`, or 0."""
        if self.after and self.warned < self.times and now - self.quiet_since >= self.after * (self.warned + 1):
            self.warned += 1
            return self.warned
        return 0

    @property
    def next_warning(self) -> float:
        """Time (s) of the next warning, or infinite after the last one."""
        return self.quiet_since + self.after * (self.warned + 1) if self.after and self.warned < self.times else inf

    def stale(self, now: float) -> bool:
        """Whether it has been quiet for too long."""
        return bool(self.after) and now - self.quiet_since >= self.after


class UsualRate:
    """Learns a rate from messages that come regularly. An outage teaches nothing.

    A sample is the number of messages in one tick, and the time that they and the gaps before them took. The spread of
    the samples yields the coefficient of variation of a single gap, and that tells how steady the rate is over the time
    that it is judged by. Messages that come at random or in bursts have no usual rate: their silence means nothing.

    A higher rate is learned within seconds. A lower one counts as slow first, and is learned after ten minutes. Each
    number of publishers has its own usual rate.

    Attributes:
        rate: Hz, or None if it is unknown yet or messages are not regular.
        regular: whether messages came at a rhythm, even if its rate is not known yet.
    """

    __slots__ = (
        "_irregular", "_known", "_last", "_lower_for", "_publishers", "_samples", "_sums", "_ticked", "rate", "regular",
    )  # fmt: skip

    def __init__(self) -> None:
        self.rate: float | None = None
        self.regular = False
        self._samples: deque[tuple[int, float]] = deque()  # gaps, and the s they took together
        self._sums = _NO_SAMPLES
        self._last: float | None = None
        self._ticked = 0.0
        self._irregular = 0
        self._lower_for = 0.0
        self._publishers = 0  # of the last messages
        self._known: dict[int, float] = {}  # rates of other numbers of publishers

    def published_by(self, publishers: int) -> None:
        """Take how many publishers the topic has now that messages come; while none come, the rate stays.

        The rate that fewer had is the least that more have, until theirs is learned.
        """
        before = self._publishers
        if publishers in (before, 0):
            return
        self._publishers = publishers
        if self.rate is not None:
            if len(self._known) >= _MOST_NUMBERS:
                self._known.clear()
            self._known[before] = self.rate
        self.rate = self._known.get(publishers, self.rate if publishers > before else None)
        self._forget()
        self._irregular = 0

    def add(self, messages: int, last: float | None, now: float) -> None:
        """Take the messages since the last call.

        Args:
            last: s, when the last message came, or None before the first.
        """
        began, self._ticked = self._ticked, now
        if not messages or last is None:
            return
        previous, self._last = self._last, last
        if previous is None or began - previous > self._longest_gap():
            return  # the first messages, or the first after an outage
        gaps, seconds = messages, last - previous
        quiet = began - previous
        if gaps > 1 and quiet > 1.0:  # a long gap, and short ones after it: their mean would hide the burst
            self._sample(1, quiet)
            gaps, seconds = gaps - 1, seconds - quiet
        self._sample(gaps, seconds)
        self._learn(last - previous)
        if self.rate is not None or len(self._samples) >= _RHYTHM_SAMPLES:
            self.regular = self.rate is not None or self._regular_rate(_RHYTHM_SAMPLES, _RHYTHM_STEADY) is not None

    def rested(self, until: float) -> None:
        """Take over that nothing came until `until` (s)."""
        self._ticked = until

    def skip(self, now: float) -> None:
        """Ignore the messages since the last call, at `now` (s), and keep the rate.

        The samples before are dropped: trouble begins a little before it is noticed.
        """
        self._ticked = now
        self._forget()

    def _forget(self) -> None:
        self._last = None
        self._samples.clear()
        self._sums = _NO_SAMPLES
        self._lower_for = 0.0

    def _sample(self, gaps: int, seconds: float) -> None:
        """Add a sample, and drop the oldest if there are too many.

        Sums of all are kept up to date, as to add them up again takes longer than all else that is learned.
        """
        all_gaps, all_seconds, squares = self._sums
        self._samples.append((gaps, seconds))
        if len(self._samples) > _SAMPLES:
            old_gaps, old = self._samples.popleft()
            all_gaps, all_seconds, squares = all_gaps - old_gaps, all_seconds - old, squares - old * old / old_gaps
        self._sums = all_gaps + gaps, all_seconds + seconds, squares + seconds * seconds / gaps

    def _longest_gap(self) -> float:
        return _LONGEST_GAP if self.rate is None else max(_QUIET, _QUIET_PERIODS / self.rate)

    def _learn(self, seconds: float) -> None:
        rate = self._regular_rate(_ENOUGH, _STEADY)
        if rate is None:
            self._irregular += 1
            if self._irregular > _SAMPLES:  # and not for one outlier among the samples
                self.rate = None
            return
        self._irregular = 0
        if self.rate is None or rate > self.rate * (1 + _CHANGED):
            self.rate = rate
        elif rate >= self.rate * (1 - _CHANGED):
            # So a rate that drifts is followed, and never far enough away to count as slow or stopped.
            self.rate += 0.1 * (rate - self.rate)
        else:
            self._lower_for += seconds
            if self._lower_for >= _LOWER_FOR:
                self.rate = rate
            else:
                return  # any other outcome ends the time for which it was lower
        self._lower_for = 0.0

    def _regular_rate(self, enough: int, steady: float) -> float | None:
        """Return the rate of the last samples, or None if they are fewer than `enough` or not as `steady`."""
        if len(self._samples) < enough:
            return None
        gaps, seconds, squares = self._sums
        period = seconds / gaps
        if period <= _AT_ONE_MOMENT:
            return None
        # The sum of (s - n * period) ** 2 / n over all samples of n gaps in s; rounding may make it less than 0.
        variance = max(0.0, squares - seconds * period)
        variation = sqrt(variance / (len(self._samples) - 1)) / period  # of a single gap
        spread = variation / sqrt(max(_JUDGED_OVER, _JUDGED_OVER / period))
        return 1 / period if spread <= steady else None


class Throughput:
    """Measures a link's capacity in one direction by the bytes that have arrived.

    Attributes:
        capacity: the measured capacity, or None before the first measurement.
    """

    def __init__(self) -> None:
        self.capacity: Capacity | None = None
        self._looked: float | None = None
        self._full = False
        self._window: deque[tuple[float, float]] = deque(maxlen=_WINDOW)

    def measure(self, arrived: float, now: float, at: float, *, full: bool) -> float:
        """Take what has arrived since the last look, about a second ago.

        Args:
            at: s since the epoch, now.
            full: more waited to be sent all the time.

        Returns:
            Bytes/s, over the last seconds for which that is as it is now.
        """
        began, self._looked = self._looked, now
        if began is None or now <= began:
            return 0.0
        if full != self._full:
            self._full = full
            self._window.clear()
        # It is negative if a connection was closed: its bytes are no longer in the caller's sum.
        self._window.append((max(0.0, arrived), now - began))
        sizes, times = zip(*self._window, strict=True)
        rate: float = sum(sizes) / sum(times)
        if len(self._window) >= _ENOUGH_ARRIVALS and rate:
            source = CapacitySource.FULL if full else CapacitySource.SEEN
            self.capacity = newer(self.capacity, Capacity(rate, source, at))
        return rate

    def disconnected(self) -> None:
        """Start over: later bytes arrive over another connection."""
        self._looked, self._full = None, False
        self._window.clear()
