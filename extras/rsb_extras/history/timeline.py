"""The history of a bridge's links and topics in the last 24 hours, without clock, thread or file."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import msgspec

from rsb_bridge.feature_api import Cause, Event
from rsb_bridge.model.session import Kind
from rsb_extras.history import history_data
from rsb_extras.history.history_data import KEPT_FOR, LINK, Gap, HistoryReport
from rsb_extras.history.track_record import MINUTE, OUTAGES_OF_ONE, Ended, MinuteSeries, Time, TrackRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.feature_api import RouteSnapshot, Snapshot, State
    from rsb_extras.history.history_data import Outage, Track

MOST_TRACKS = 2000
"""The most links and topics kept, including removed ones. A round figure, twice `model.limits.ROUTES_PER_LINK`."""

Key = tuple[str, Kind | Literal["link"], str, bool]
"""Of a track: link, kind, topic, outgoing."""
VERSION = 1
FROM_THE_FUTURE = "it is from the future: the clock was wrong then, or it is now"
OUTAGES = 10_000
"""Outages kept, of all of them: with 500 topics over 24 h, 10 MB of memory (bench/README)."""
_ACTIONS = 500
"""Events kept of each of two kinds: what operators did, and what concerns the whole bridge."""
_RUNS = 200
"""Times in which the bridge ran; a service that restarts each 7 min has as many in 24 h."""
_TIDIED_EVERY = 60.0
"""s; what is too old may stay for so long beyond 24 h."""
_SHORT_GAP = 5.0
"""s between two runs that are not worth a word. A round figure."""


class TrackRecords(dict[Key, TrackRecord]):
    """Links and topics that a timeline remembers, by key; where there are too many, some give way.

    What the timeline looks up for each route, every second, takes no walk over all of them.
    """

    def __init__(self) -> None:
        super().__init__()
        self._topics: Counter[str] = Counter()  # by link
        self._gone: list[Key] = []
        self._gone_in = -1

    def __setitem__(self, key: Key, record: TrackRecord) -> None:
        self._topics[key[0]] += key[1] != LINK and key not in self
        super().__setitem__(key, record)

    def __delitem__(self, key: Key) -> None:
        super().__delitem__(key)
        self._topics[key[0]] -= key[1] != LINK
        if not self._topics[key[0]]:
            del self._topics[key[0]]

    def make_room(self, key: Key, turn: int) -> bool:
        """Make room for a new track, and return whether there is room.

        A link may have as many topics as it leaves room for the others. Beyond that, a removed track makes room:
        one of the link with the most topics, unless the new track's link has more.

        Args:
            turn: number of the present `observe`.
        """
        topics, own = self._topics, self._topics[key[0]]
        if key[1] == LINK or own <= MOST_TRACKS - len(self):
            return True
        if turn != self._gone_in:
            self._gone_in, self._gone = turn, [each for each, record in self.items() if not record.live]
        # Since that walk, one may have come back, or given way.
        gone = [each for each in self._gone if each in self and not self[each].live and topics[each[0]] >= own]
        if not gone:
            return False
        del self[min(gone, key=lambda each: (-topics[each[0]], self[each].series.end))]
        return True


class SavedTrack(msgspec.Struct, frozen=True, array_like=True):
    """A `TrackRecord` as it is kept on disk: its name, its series, its outages."""

    link: str
    topic: str
    outgoing: bool
    first: int
    rates: bytes
    up: bytes
    out: bytes
    waiting: bytes
    outages: tuple[Ended, ...]
    kind: Kind | Literal["link"]


class Saved(msgspec.Struct, frozen=True):
    """A `Timeline` as it is kept on disk.

    Attributes:
        time: when it was saved, s since the epoch.
        runs: beginning and end of each time in which the bridge ran.
        subjects: the links and topics.
    """

    version: int
    name: str
    role: str
    time: Time
    runs: tuple[tuple[Time, Time], ...]
    subjects: tuple[SavedTrack, ...]
    actions: tuple[Event, ...]


def is_from_the_future(saved: Saved, wall: float) -> bool:
    """Whether a clock (s since the epoch) is days behind the saved time, so that one of the two is wrong."""
    return saved.time - wall > KEPT_FOR


class Timeline:
    """Remembers outages, rates and operators' actions. All times are on one `ClockAxis`.

    Attributes:
        changes: grows with each outage that begins or ends.
    """

    def __init__(self, name: str, role: str) -> None:
        self.changes = 0
        self._name, self._role = name, role
        self._records = TrackRecords()
        self._runs: deque[tuple[float, float]] = deque(maxlen=_RUNS)
        self._run: tuple[float, float] | None = None
        self._did: deque[Event] = deque(maxlen=_ACTIONS)
        self._happened: deque[Event] = deque(maxlen=_ACTIONS)
        self._turn = 0
        self._tidied = 0.0
        self._shown: dict[int, TrackRecord] = {}  # of the last snapshot's routes, by their ids
        self._holds: Snapshot | None = None
        self._all_go_on = False

    # --- as time goes by

    def observe(self, snapshot: Snapshot, now: float) -> None:
        """Record the present state of everything, which counts until the next call."""
        last = self._run[1] if self._run else now
        self._run = (self._run[0] if self._run else now, now)
        self._turn += 1
        for link in snapshot.links:
            traffic = link.rx_bytes_per_second + link.tx_bytes_per_second
            self._observe(_key_of(link.name), now, last, link.state, link.reason, rate=traffic)
        before, holds, self._holds = self._shown, self._holds, snapshot  # so that no other object gets the id of one
        same = holds is not None and holds.routes is snapshot.routes and len(holds.links) == len(snapshot.links)
        if same and self._all_go_on and int(now // MINUTE) == int(last // MINUTE):
            return  # nearly always, on a robot where hundreds of topics are quiet
        self._shown, self._all_go_on = {}, True
        for route in snapshot.routes:
            # A quiet topic's snapshot stays the same object, and there are hundreds.
            record = before.get(id(route))
            if record is not None and record.goes_on(now):
                record.turn, self._shown[id(route)] = self._turn, record
                continue
            key = (route.link, route.spec.kind, route.topic, route.outgoing)
            total = route.ledger.delivered if route.calls is None else route.calls.asked
            reason = route.reason or route.last_error
            record = self._observe(key, now, last, route.state, reason, total=total, is_open=_is_open(route))
            self._all_go_on &= record is not None and record.goes_on(now)
            if record is not None:
                self._shown[id(route)] = record
        for record in [each for each in self._records.values() if each.live and each.turn != self._turn]:
            self.changes += record.is_out
            record.cut(now, self._link_of(record), cut_off=False)
        # Before the clock was set back, it may have been years ahead.
        if not 0.0 <= now - self._tidied < _TIDIED_EVERY:
            self._tidy(now)

    def _observe(
        self,
        key: Key,
        now: float,
        last: float,
        state: State,
        reason: str,
        *,
        rate: float = 0.0,
        total: int = 0,
        is_open: bool = False,
    ) -> TrackRecord | None:
        record = self._records.get(key)
        if record is None:
            if not self._records.make_room(key, self._turn):
                return None
            record = self._records[key] = TrackRecord(*key)
        record.turn = self._turn
        record.lasted(last)
        was_out = record.is_out
        record.count(total)
        record.observe(now, state, reason, self._link_of(record), rate, is_open=is_open)
        self.changes += was_out != record.is_out
        return record

    def _catch_up(self) -> None:
        if self._run is not None:
            for record in self._records.values():
                record.catch_up(self._run[1])

    def did(self, event: Event, now: float) -> bool:
        """Remember an event, if an operator caused it or it concerns the whole bridge; whether it is so."""
        if event.who or event.source == "operator":
            kept = self._did
        elif event.source == "engine":
            kept = self._happened
        else:
            return False
        kept.append(replace(event, time=now))
        return True

    def go_on(self, events: Iterable[Event]) -> None:
        """Take in the last events of a process that was killed before it could save: it ran until then."""
        for event in events:
            self.did(event, event.time)
            if self._runs and self._runs[-1][1] < event.time:
                self._runs[-1] = (self._runs[-1][0], event.time)

    def cut(self) -> None:
        """End the run: the bridge stops, or the machine has slept since the last `observe`."""
        if self._run is None:
            return
        _, now = self._run
        for record in self._records.values():
            record.cut(now, self._link_of(record), cut_off=True)
        self._runs.append(self._run)
        self._run = None

    @property
    def last(self) -> float:
        """The end of the last run, or 0 before the first."""
        return self._runs[-1][1] if self._runs else 0.0

    def move(self, seconds: float) -> None:
        """Shift this run by some seconds, because the clock was set."""
        if self._run is None:
            return
        self._catch_up()
        since, until = self._run
        self._move_from(since, seconds)
        self._run = (since + seconds, until + seconds)

    def move_back(self, seconds: float) -> None:
        """Shift the end of the past, and this run, because the clock of an earlier process was ahead.

        These are the runs that end less than `seconds` before this one began, and those that would be run over.
        """
        self._catch_up()
        runs = [*self._runs, *((self._run,) if self._run else ())]
        first = len(runs) - 1
        while first > 0 and runs[first - 1][1] > runs[first][0] - seconds:
            first -= 1
        if first < 0:
            return
        self._move_from(runs[first][0], -seconds)
        moved = [(since - seconds, until - seconds) for since, until in runs[first:]]
        if self._run is not None:
            self._run = moved.pop()
        runs[first:] = moved
        self._runs = deque(runs[: first + len(moved)], maxlen=_RUNS)

    def _move_from(self, since: float, seconds: float) -> None:
        for record in self._records.values():
            record.move(since, seconds)
        for events in (self._did, self._happened):
            moved = [replace(each, time=each.time + seconds) if each.time >= since else each for each in events]
            events.clear()
            events.extend(moved)

    def earliest(self, now: float) -> float:
        """Return the earliest time that may count as now, so that this run does not begin before the last one ended."""
        return now + self.last - self._run[0] if self._run else self.last

    def _link_of(self, record: TrackRecord) -> TrackRecord | None:
        return self._records.get(_key_of(record.link)) if record.topic else None

    def _tidy(self, now: float) -> None:
        """Drop what is too old, and outages beyond the limit, first of the tracks with the most outages."""
        self._tidied = now
        for key, record in list(self._records.items()):
            if not record.forget(now - KEPT_FOR):
                del self._records[key]
        excess = sum(len(each.outages) for each in self._records.values()) - OUTAGES
        while excess > 0:
            most = max(self._records.values(), key=lambda each: len(each.outages))
            # A quarter at once: a walk over all tracks for each outage would be thousands of walks.
            for _ in range(min(excess, max(1, len(most.outages) // 4))):
                most.drop(now)
                excess -= 1
        for events in (self._did, self._happened):
            while events and events[0].time < now - KEPT_FOR:
                events.popleft()

    # --- questions

    def report(self, now: float, span: float, *, running: bool) -> HistoryReport:
        """Report on the last `span` s."""
        self._catch_up()
        start = now - span
        tracks: list[Track] = []
        outages: list[Outage] = []
        records = self._records.values()
        for record in sorted(records, key=lambda each: (each.link, each.topic, each.kind, each.outgoing)):
            found = list(record.outages_in(start, now, self._link_of(record)))
            outages += found
            track = record.track(start, now, len(found), history_data.RATES_AT_ONCE)
            if record.live or found or track.up or track.out or track.waiting:
                tracks.append(track)
        dropped = sum(each.dropped_in(start) for each in self._records.values())
        outages.sort(key=lambda each: each.start)
        actions = sorted(
            (each for each in (*self._did, *self._happened) if each.time >= start), key=lambda each: each.time
        )
        return HistoryReport(
            self._name, self._role, now, span, running, tuple(tracks),
            tuple(outages[-history_data.OUTAGES_AT_ONCE :]), tuple(actions[-history_data.ACTIONS_AT_ONCE :]),
            tuple(self._gaps(start, now)),
            dropped + max(0, len(outages) - history_data.OUTAGES_AT_ONCE),
            max(0, len(actions) - history_data.ACTIONS_AT_ONCE),
        )  # fmt: skip

    def _gaps(self, start: float, now: float) -> Iterator[Gap]:
        known = start
        for begin, end in (*self._runs, *((self._run,) if self._run else ())):
            if begin - known > _SHORT_GAP:
                yield Gap(known, begin - known)
            known = max(known, end)
        if now - known > _SHORT_GAP:
            yield Gap(known, now - known)

    # --- on disk

    def save(self, now: float) -> Saved:
        """All of it as it is now, for `restore`."""
        self._catch_up()
        tracks = tuple(
            SavedTrack(
                each.link, each.topic, each.outgoing, *each.series.dump(),
                tuple(each.present(now, self._link_of(each))), each.kind,
            )
            for each in self._records.values()
        )  # fmt: skip
        runs = (*self._runs, *((self._run,) if self._run else ()))
        return Saved(VERSION, self._name, self._role, now, runs, tracks, (*self._did, *self._happened))

    @classmethod
    def restore(cls, saved: Saved, name: str, role: str) -> Timeline:
        """Restore what `save` has returned, for a session of this name and role.

        Raises:
            ValueError: it contradicts itself.
        """
        timeline = cls(name, role)
        for each in saved.subjects[:MOST_TRACKS]:
            key: Key = (each.link, each.kind, each.topic, each.outgoing) if each.topic else _key_of(each.link)
            record = TrackRecord(*key)
            record.series = MinuteSeries.load(each.first, each.rates, each.up, each.out, each.waiting)
            record.outages.extend(each.outages[-OUTAGES_OF_ONE:])
            timeline._records[key] = record
        timeline._runs.extend(saved.runs)
        for event in saved.actions:
            timeline.did(event, event.time)
        return timeline


def _key_of(link: str) -> Key:
    """Return the link's own key."""
    return link, LINK, "", False


def _is_open(route: RouteSnapshot) -> bool:
    """Whether messages or calls could cross, though none has since the route was opened."""
    if route.calls is None:
        return route.cause in (Cause.PUBLISHER_SILENT, Cause.PUBLISHER_UNHEARD)
    return any(stage.name == "offered" and stage.done for stage in route.stages)
