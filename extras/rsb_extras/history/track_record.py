"""One link or topic: how long it was fine, its outages, and its figures of each minute."""

from __future__ import annotations

import math
import re
from array import array
from collections import deque
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, TypeAlias

from msgspec import Meta

from rsb_bridge.feature_api import State, sanitize_text
from rsb_bridge.model.limits import TIME
from rsb_extras.history.history_data import KEPT_FOR, Outage, Track

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Kind

Time: TypeAlias = Annotated[float, Meta(ge=TIME.low, le=TIME.high)]
"""A time or a duration in a file. The bounds refuse infinity and NaN, which JSON cannot express."""
MINUTE = 60.0
MINUTES = round(KEPT_FOR / MINUTE)
_TRIMMED_AT = MINUTES + 60
"""Minutes that are kept before the oldest go: not each minute, because that moves all of them."""
_STEPS = 4
"""Parts of a second in which a minute's times are kept: 0.25 s fits 60 s into a byte."""
_UNKNOWN = math.nan
UP = (State.OK, State.UNHEARD)
"""Messages cross as they should; that nobody hears them is no outage."""
CROSSES = (*UP, State.LATE)
"""States in which messages cross. The times in which a topic is late are listed, but count as up."""
_CROSSES_BADLY = (State.LATE, State.SLOW)
FINE = (*UP, *(state for state in State if state.is_wanted))
"""A pause is wanted, and so is what nobody has armed or hears; it counts neither as up nor as out."""
OUTAGES_OF_ONE = 100
"""Outages kept of each, so that one that flaps displaces nobody else's: 100 that flap fill
`timeline.OUTAGES`."""
_OPENS_WITHIN = 30.0
"""s in which a new topic or link may open, and one that was out may open again; only then is it an outage, or waits.
A round figure: of 200 robots that start, the last topic flows after 9.4 s (bench/README, A fleet)."""
_FOLLOWS_WITHIN = 15.0
"""s after a link's outage in which its topics may open again. A round figure."""
_CAUSE_LENGTH = 250
"""Characters of a cause, so that the first and the last one have the length of one reason (`REASON_LENGTH`)."""
_WORST_FIRST = tuple(State)
_figures = re.compile(r"\d+(\.\d+)?")


class MinuteSeries:
    """Rates, and how long it was fine, not fine, or waiting, minute by minute.

    A minute's number is its time divided by 60 s.

    Attributes:
        first: number of the first minute kept.
    """

    def __init__(self) -> None:
        self.first = 0
        self._rates = array("f")
        self._up = bytearray()
        self._out = bytearray()
        self._waiting = bytearray()

    def __len__(self) -> int:
        return len(self._rates)

    @property
    def end(self) -> int:
        """Number of the minute after the last one."""
        return self.first + len(self)

    def add(self, minute: int, rate: float, up: float, out: float, waiting: float) -> None:
        """Append a minute's figures, or add to the last minute's if it is the same minute.

        Args:
            minute: its number, not less than the last one.
            rate: mean over the recorded part of the minute.
            up: s in which the track was fine.
            out: s in which it was not.
            waiting: s in which it waited for its first message.
        """
        if len(self) and minute == self.end - 1:  # the machine slept, or the clock was set, within it
            self._rates[-1] = rate if math.isnan(self._rates[-1]) else (self._rates[-1] + rate) / 2
            for kept, seconds in zip(self._times, (up, out, waiting), strict=True):
                kept[-1] = min(255, kept[-1] + round(seconds * _STEPS))
            return
        # A clock that jumps by years would make millions of minutes without figures, only to be cut again.
        if not len(self) or minute - self.end >= MINUTES:
            self._cut(len(self))
            self.first = minute
        self._insert(len(self), minute - self.end)
        self._rates.append(rate)
        for kept, seconds in zip(self._times, (up, out, waiting), strict=True):
            kept.append(min(255, round(seconds * _STEPS)))
        if len(self) > _TRIMMED_AT:
            self._cut(len(self) - MINUTES)

    @property
    def _times(self) -> tuple[bytearray, bytearray, bytearray]:
        return self._up, self._out, self._waiting

    def times(self, start: int, end: int) -> tuple[float, float, float]:
        """Return the seconds up, out, and waiting, in the minutes from `start` to before `end`."""
        begin, stop = max(0, start - self.first), max(0, end - self.first)
        up, out, waiting = (sum(kept[begin:stop]) / _STEPS for kept in self._times)
        return up, out, waiting

    def rates(self, start: int, end: int, parts: int) -> Iterator[float | None]:
        """Yield the mean rate in each of `parts` parts of the minutes from `start` to `end`, or None if unknown."""
        for part in range(parts):
            begin = start + (end - start) * part // parts - self.first
            stop = start + (end - start) * (part + 1) // parts - self.first
            known = [rate for rate in self._rates[max(0, begin) : max(0, stop)] if not math.isnan(rate)]
            yield round(math.fsum(known) / len(known), 3) if known else None

    def move(self, since: int, minutes: int) -> None:
        """Move the figures from minute `since` on, because the clock was set.

        Args:
            since: number of a minute.
            minutes: how far. A negative distance moves them to the past, where they replace older figures.
        """
        at = max(0, min(len(self), since - self.first))
        if at == 0:
            self.first += minutes
        elif minutes > 0:
            if minutes >= MINUTES:
                self._cut(at)
                self.first = since + minutes
            else:
                self._insert(at, minutes)
                self._cut(max(0, len(self) - MINUTES))
        else:
            for figures in (self._rates, *self._times):
                del figures[max(0, at + minutes) : at]
            self.first += min(0, at + minutes)

    def dump(self) -> tuple[int, bytes, bytes, bytes, bytes]:
        """Return the contents, for `load`."""
        return self.first, self._rates.tobytes(), bytes(self._up), bytes(self._out), bytes(self._waiting)

    @classmethod
    def load(cls, first: int, rates: bytes, up: bytes, out: bytes, waiting: bytes) -> MinuteSeries:
        """Restore what `dump` has returned.

        Raises:
            ValueError: the parts do not belong together, there are too many minutes, or a rate is infinite.
        """
        series = cls()
        series.first = first
        series._rates.frombytes(rates)
        series._up, series._out, series._waiting = bytearray(up), bytearray(out), bytearray(waiting)
        if not len(series) == len(up) == len(out) == len(waiting) <= _TRIMMED_AT:
            raise ValueError(f"{len(series)} rates, {len(up)}, {len(out)} and {len(waiting)} times")
        if any(map(math.isinf, series._rates)):
            raise ValueError("an infinite rate")
        return series

    def _insert(self, at: int, minutes: int) -> None:
        """Insert minutes without figures."""
        self._rates[at:at] = array("f", [_UNKNOWN]) * minutes
        for kept in self._times:
            kept[at:at] = bytes(minutes)

    def _cut(self, minutes: int) -> None:
        """Forget the oldest minutes."""
        for figures in (self._rates, *self._times):
            del figures[:minutes]
        self.first += minutes


class Ended(NamedTuple):
    """An outage that is over; for its fields see `Outage`."""

    start: Time
    seconds: Time
    state: str
    cause: str
    cut_off: bool
    with_link: bool


class _Open:
    """An outage that goes on."""

    def __init__(self, start: float, state: State, cause: str, *, with_link: bool) -> None:
        self.start = start
        self.state = state
        self.with_link = with_link
        self._first = self._last = cause[:_CAUSE_LENGTH]

    def go_on(self, state: State, cause: str) -> None:
        """Keep the worst state, the first words and the last ones."""
        if _WORST_FIRST.index(state) < _WORST_FIRST.index(self.state):
            self.state = state
        self._first = self._first or cause[:_CAUSE_LENGTH]
        self._last = cause[:_CAUSE_LENGTH] or self._last

    @property
    def cause(self) -> str:
        if _figures.sub("#", self._first) == _figures.sub("#", self._last):
            return sanitize_text(self._first)
        return sanitize_text(f"{self._first}; then: {self._last}", 2 * _CAUSE_LENGTH + 10)


class TrackRecord:
    """A link, or what it carries in one direction: a topic, a service, an action, or parameters of a node.

    All times are s on the axis of `rsb_extras.history.recorder.ClockAxis`.

    Args:
        kind: `rsb_extras.history.history_data.LINK`, or a `rsb_bridge.model.session.Kind`.
        topic: its name on this side, or empty for the link itself.
        outgoing: whether this side sends it.

    Attributes:
        live: whether it exists at present.
        dropped: number of outages dropped because there was no room; 0 again a day after `dropped_at`.
        dropped_at: the time when the newest of them was dropped.
        outages: past ones, oldest first.
    """

    def __init__(self, link: str, kind: Kind | Literal["link"], topic: str, outgoing: bool) -> None:
        self.link, self.kind, self.topic, self.outgoing = link, kind, topic, outgoing
        self.live = False
        self.turn = 0
        self.dropped = 0
        self.dropped_at = 0.0
        self.outages: deque[Ended] = deque()
        self.series = MinuteSeries()
        self._state = State.OK
        self._seen = self._born = 0.0
        self._opening = False
        self._waits_since: float | None = None
        self._waits_for = ""
        self._open: _Open | None = None
        self._minute = 0
        self._known = self._up = self._out = self._waiting = self._amount = 0.0
        self._count = 0
        self._rate = 0.0

    @property
    def is_out(self) -> bool:
        return self._open is not None

    # --- as time goes by

    def observe(
        self, now: float, state: State, reason: str, link: TrackRecord | None, rate: float, *, is_open: bool = False
    ) -> None:
        """Record the present state, which counts until the next call.

        Args:
            rate: of a link, bytes/s; what is counted by `count` comes on top.
            is_open: whether a waiting topic could carry messages.
        """
        if not self.live:
            self.live, self._opening = True, True
            self._born = self._seen = now
            self._minute = int(now // MINUTE)
            self._state = State.OK
            self._amount = 0.0
        else:
            self._pass(now)
        self._state, self._rate = state, rate
        if state is not State.WAITING:
            self._waits_since = None
        elif self._waits_since is None:
            self._waits_since = now
        if state in FINE:
            self._opening = False
            self._end(now, link)
        elif self._waits(now, is_open=is_open):
            self._born = now
            self._waits_for = reason
            self._end(now, link)
        elif self._open is not None:
            if self._is_cut(self._open, state, link):
                self._end(now, link)
                self._open = _Open(now, state, reason, with_link=True)
            elif state is not State.WAITING:  # it opens again: what it waits for is not why it was out
                self._open.go_on(state, reason)
        elif not self._opening:
            self._open = _Open(now, state, reason, with_link=_follows(link, now))
        elif now - self._born >= _OPENS_WITHIN:
            self._opening = False
            # `_pass` has not counted these seconds, as it might have opened in time.
            self._out += now - self._born
            self._open = _Open(self._born, state, reason, with_link=link is not None and link.is_out)

    @staticmethod
    def _is_cut(outage: _Open, state: State, link: TrackRecord | None) -> bool:
        """Whether the link's outage ends one in which messages crossed, if slowly: that was no part of it."""
        crossed = outage.state in _CROSSES_BADLY and state not in _CROSSES_BADLY
        return crossed and link is not None and link.is_out

    def goes_on(self, now: float) -> bool:
        """Whether `observe` need not be told that the last state lasts, and nothing was counted.

        Until the minute is over, or a question needs them (`catch_up`), its seconds are added up later.
        """
        lasts = self._state in FINE or self._waits_on
        return lasts and self.live and int(now // MINUTE) == self._minute

    def lasted(self, until: float) -> None:
        """Note that it went on like that until the last look: it opens from then on."""
        if self.live and self._waits_on:
            self._born = until

    @property
    def _waits_on(self) -> bool:
        return self._state is State.WAITING and self._open is None

    def catch_up(self, now: float) -> None:
        """Add up the seconds in which it went on."""
        if self.live:
            self._pass(now)

    def _waits(self, now: float, *, is_open: bool = False) -> bool:
        """Whether it waits for its first message. After an outage it is out until it is open again."""
        if self._waits_since is None:
            return False
        return self._open is None or is_open or now - self._waits_since >= _OPENS_WITHIN

    def count(self, total: int) -> None:
        """Record the number of messages or calls so far; a lower number than before means that counting has restarted.

        Call it before `observe`, which may end a minute.
        """
        self._amount += total - (self._count if total >= self._count else 0)
        self._count = total

    def cut(self, now: float, link: TrackRecord | None, *, cut_off: bool) -> None:
        """End the record at `now`, because the link or topic was removed or nobody watches it any more.

        Args:
            cut_off: whether an outage may go on after the record ends.
        """
        if self.live:
            self._pass(now)
            self._end(now, link, cut_off=cut_off)
            self._close_minute()
            self.live = False

    def _pass(self, now: float) -> None:
        passed = now - self._seen
        self._seen = now
        self._known += passed
        self._amount += self._rate * passed
        if self._state in CROSSES:
            self._up += passed
        elif self._state is State.WAITING and self._open is None:
            self._waiting += passed
        elif not self._state.is_wanted and not self._opening:
            self._out += passed
        if int(now // MINUTE) != self._minute:
            self._close_minute()
            self._minute = int(now // MINUTE)

    def _close_minute(self) -> None:
        if self._known:
            self.series.add(self._minute, self._amount / self._known, self._up, self._out, self._waiting)
        self._known = self._up = self._out = self._waiting = self._amount = 0.0

    def _end(self, now: float, link: TrackRecord | None, *, cut_off: bool = False) -> None:
        if self._open is not None:
            self._keep(self._ended(self._open, now, link, cut_off=cut_off), now)
            self._open = None

    def _ended(self, outage: _Open, now: float, link: TrackRecord | None, *, cut_off: bool) -> Ended:
        with_link = outage.with_link and _follows(link, now)
        return Ended(outage.start, now - outage.start, outage.state, outage.cause, cut_off, with_link)

    def _keep(self, outage: Ended, now: float) -> None:
        self.outages.append(outage)
        if len(self.outages) > OUTAGES_OF_ONE:
            self.drop(now)

    def drop(self, now: float) -> None:
        """Forget the oldest outage, because there is no room."""
        self.outages.popleft()
        self.dropped += 1
        self.dropped_at = now

    def forget(self, before: float) -> bool:
        """Forget the outages that ended before a time. Whether there is anything left to know."""
        while self.outages and self.outages[0].start + self.outages[0].seconds < before:
            self.outages.popleft()
        if self.dropped_at < before:
            self.dropped = 0
        return self.live or bool(self.outages) or self.series.end > before // MINUTE

    def move(self, since: float, seconds: float) -> None:
        """Shift everything from `since` on by some seconds, because the clock was set."""
        self.series.move(int(since // MINUTE), round(seconds / MINUTE))
        self.outages = deque(
            outage._replace(start=outage.start + seconds) if outage.start >= since else outage
            for outage in self.outages
        )
        self._seen += seconds
        self._born += seconds
        if self._waits_since is not None:
            self._waits_since += seconds
        self._minute = int(self._seen // MINUTE)
        if self._open is not None:
            self._open.start += seconds

    # --- questions

    def outages_in(self, start: float, now: float, link: TrackRecord | None) -> Iterator[Outage]:
        """The outages that had not ended before `start`, oldest first."""
        for ended in self.outages:
            if ended.start + ended.seconds >= start:
                yield self._outage(ended)
        if self._open is not None:
            yield self._outage(self._ended(self._open, now, link, cut_off=False), ongoing=True)

    def dropped_in(self, start: float) -> int:
        """Return how many outages since `start` there was no room for; some of them may be older."""
        return self.dropped if self.dropped_at >= start else 0

    def present(self, now: float, link: TrackRecord | None) -> Iterator[Ended]:
        """The outages as they are to be kept on disk: the one that goes on ends where the file does."""
        yield from self.outages
        if self._open is not None:
            yield self._ended(self._open, now, link, cut_off=True)

    def track(self, start: float, now: float, outages: int, parts: int) -> Track:
        """Summarize the time from `start` to `now`, to the minute.

        Args:
            parts: the number of rates.
        """
        begin, end = int(start // MINUTE), int(now // MINUTE)
        up, out, waiting = self.series.times(begin, end + 1)
        waits_for = ""
        if self.live:
            # The series does not have the present minute yet.
            up, out, waiting = up + self._up, out + self._out, waiting + self._waiting
            if self._waits(now):
                waits_for = sanitize_text(self._waits_for[:_CAUSE_LENGTH])
        return Track(
            self.link, self.topic, self.outgoing, up, out, outages + self.dropped_in(start),
            tuple(self.series.rates(begin, end, parts)), waiting, waits_for, self.kind,
        )  # fmt: skip

    def _outage(self, ended: Ended, *, ongoing: bool = False) -> Outage:
        return Outage(
            ended.start, ended.seconds, self.link, self.topic, self.outgoing, ended.state, ended.cause,
            ongoing, ended.cut_off, ended.with_link, self.kind,
        )  # fmt: skip


def _follows(link: TrackRecord | None, now: float) -> bool:
    """Whether what a topic does now comes of its link's outage, which shows first."""
    if link is None:
        return False
    if link.is_out or link._opening:
        return True
    return bool(link.outages) and now - (link.outages[-1].start + link.outages[-1].seconds) <= _FOLLOWS_WITHIN
