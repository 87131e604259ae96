"""The messages of two recordings side by side, in a database on disk: which are the same, and which are missing.

A message of the other side's recording is known by its head, one of this side's by its content. No content is kept, so
memory does not grow with the recordings.
"""

from __future__ import annotations

import heapq
import itertools
import sqlite3
from collections import Counter, deque
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from rsb_extras.courier.completed_recording import MOST_GAPS, ClockSource, CompletedClock
from rsb_extras.courier.courier_records import LATEST, MOST_SPANS, WantedSpan
from rsb_extras.courier.picking import HeadError, read_head
from rsb_extras.courier.pieces import PieceError, PieceProblem
from rsb_extras.recording.reading.recorded_qos import LATCHED, parsed_profiles, policy
from rsb_extras.recording.reading.stored_message import content_key

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from rsb_extras.courier.completed_recording import CompletedName
    from rsb_extras.courier.courier_records import Wanted
    from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

MOST_MESSAGES = 20_000_000
"""Of each side. A round figure: 2 GB on disk."""
_CACHE = 16 << 10  # KiB of memory
_HELD = 10_000  # rows before they are written, and equal messages that wait for each other
_LATE = 600_000_000_000
"""ns that one of several equal messages may be on its way. A round figure, above what outboxes hold in practice."""
_ON_TIME, _SPREADS = 20_000_000, 4
"""ns by which messages on time may differ anyway, and how many times the spread of the fastest. Round figures."""
_ALL_PROFILES = 1 << 20
"""Characters of QoS of all channels that are parsed, which takes 0.1 s for 20,000. A round figure."""
_NEVER = 1 << 100  # ns
_LOOK_EVERY = 10_000  # instructions of SQLite, below 1 ms, after which it looks whether it is interrupted
_MOST = 1 << 45
"""Bytes of a topic, and ns (10 hours) of the spread, that are told at most: a robot may say more than crosses."""
_PUBLISHERS = 16  # of a topic that are told apart by their numbers. A round figure
_MOST_LOST = 100_000
"""Messages in a gap of a publisher's numbers, above which it is another publisher. A round figure."""
_GAPS = 4 * MOST_GAPS
_EARLY, _LEAST_EARLY = 500_000_000, 1_000_000
"""ns at most and at least that a message may be faster than the offset says."""
_TENTH, _QUARTER = 10, 4
"""Parts of the matched messages by their time on the way: the offset is that of the fastest tenth, as an outage delays
any number of the others."""
_SCHEMA = """
CREATE TABLE there (id INTEGER PRIMARY KEY, topic INT, channel INT, key INT, time INT, published INT, number INT,
    size INT, live INT, came INT, same INT, UNIQUE (topic, key, same, number));
CREATE TABLE live (id INTEGER PRIMARY KEY, topic INT, key INT, time INT, there INT, repeats INT, same INT, copy INT,
    UNIQUE (topic, key, same, copy));
CREATE TABLE span (topic INT, begin INT, end INT);
"""


class TooManyMessagesError(Exception):
    """There are more messages than can be compared at once."""


class _Row(NamedTuple):
    topic: int
    key: int
    part: int
    id: int
    is_sink: int
    place: int


class Placed(NamedTuple):
    """Where a message has its place in the file.

    Attributes:
        id: of the row of the other side's recording, or 0 if it has none.
        time, published: ns since the epoch on this side's clock.
        channel: the number of the other side's channel, or -1.
    """

    id: int
    channel: int
    time: int
    published: int
    number: int


class AbsentMessages(NamedTuple):
    """Messages that are missing between two times (ns since the epoch on the other side's clock)."""

    messages: int
    begin: int
    end: int


class TopicFigures(NamedTuple):
    """What became of a topic's messages.

    Attributes:
        live: that came live; of these, `only_live` are not in the other side's recording.
        size: bytes of those that were fetched.
        whole: bytes of all in the other side's recording.
        absent: those that were not given.
    """

    live: int
    only_live: int
    fetched: int
    size: int
    whole: int
    absent: AbsentMessages | None


class MessageIndex:
    """Compares what a peer's recording has with what came live.

    Args:
        path: of the database, which must not be there; nothing of it is used again.
        topics: in the order of their numbers.
        check_room: raises OSError if the disk has no room for more.

    Attributes:
        channels: of the other side, by their numbers.
        clock: how its times become times of this side, after `compare`.
    """

    def __init__(self, path: Path, topics: Sequence[CompletedName], check_room: Callable[[], None]) -> None:
        self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        for pragma in ("journal_mode = OFF", "synchronous = OFF", "temp_store = FILE", f"cache_size = -{_CACHE}"):
            self._database.execute(f"PRAGMA {pragma}")
        self._database.executescript(_SCHEMA)
        self._database.execute("BEGIN")
        self._is_interrupted = False
        self._database.set_progress_handler(lambda: self._is_interrupted, _LOOK_EVERY)
        self._topics, self._check_room = topics, check_room
        self._count = Counter[str]()
        self._profiles = 0
        self._there = {each.there: number for number, each in enumerate(topics)}
        # What came live by a name that a carried topic has here is not of a topic of that name over there.
        named = sorted(enumerate(topics), key=lambda each: each[1].here != each[1].there)
        self._here = {each.here: number for number, each in named}
        self.latched: set[int] = set()
        self.channels: list[StoredChannel] = []
        self._numbers: dict[StoredChannel, int] = {}
        self.clock = CompletedClock(ClockSource.NONE)

    def interrupt(self) -> None:
        """End what another thread has begun, and what it begins from now on."""
        self._is_interrupted = True

    def close(self) -> None:
        self._database.close()

    # --- filling it

    def add_there(self, heads: Iterable[StoredMessage]) -> None:
        """Take the heads of the other side's messages, in their order.

        Raises:
            PieceError: one is no head.
            TooManyMessagesError: there are too many.
        """

        def rows() -> Iterator[tuple[int | None, ...]]:
            for at, message in enumerate(heads, 1):
                try:
                    key, size = read_head(message)
                except HeadError:
                    raise PieceError(PieceProblem.INVALID()) from None
                topic, published = self._there[message.channel.topic], min(message.published, LATEST)
                channel = self._channel(topic, message.channel)
                # The ring writes a latched message at the begin of each segment again.
                same = published if topic in self.latched else None
                yield at, topic, channel, key, message.time, published, message.number, size, same

        self._insert("there (id, topic, channel, key, time, published, number, size, same)", 9, rows())

    def _channel(self, topic: int, channel: StoredChannel) -> int:
        number = self._numbers.get(channel)
        if number is None:
            number = self._numbers[channel] = len(self.channels)
            self.channels.append(channel)
            self._note_latched(topic, channel)
        return number

    def _note_latched(self, topic: int, channel: StoredChannel) -> None:
        self._profiles += len(channel.profiles)
        if self._profiles <= _ALL_PROFILES and any(
            policy(LATCHED, each.get("durability")) for each in parsed_profiles(channel.profiles)
        ):
            self.latched.add(topic)

    def add_live(self, messages: Iterable[tuple[int, StoredMessage]]) -> None:
        """Take messages of one recording of this side, in its order, with their numbers; other topics are left out."""
        channels: dict[StoredChannel, tuple[int, bool]] = {}
        copies: Counter[tuple[int, int]] = Counter()
        time = -1

        def rows() -> Iterator[tuple[int | None, ...]]:
            nonlocal time
            for at, message in messages:
                known = channels.get(message.channel)
                if known is None:
                    topic = self._here.get(message.channel.topic, -1)
                    if topic >= 0:
                        self._note_latched(topic, message.channel)
                    known = channels[message.channel] = topic, message.channel.encoding == "cdr"
                topic, is_cdr = known
                if topic < 0:
                    continue
                if message.time != time:
                    copies.clear()
                    time = message.time
                key = content_key(message.content, is_cdr=is_cdr)
                logged, published = min(message.time, LATEST), min(message.published, LATEST)
                copies[topic, key] += 1
                # Several recordings may have it, and each segment of the ring a latched one.
                same, copy = (published, 0) if topic in self.latched else (logged, copies[topic, key])
                yield at, topic, key, logged, same, copy

        self._insert("live (id, topic, key, time, same, copy)", 6, rows())

    def _insert(self, columns: str, count: int, rows: Iterator[tuple[int | None, ...]]) -> None:
        query = f"INSERT OR IGNORE INTO {columns} VALUES ({','.join('?' * count)})"  # noqa: S608 -- names of our own
        while batch := list(itertools.islice(rows, _HELD)):
            self._check_room()
            self._count[columns] += len(batch)
            if self._count[columns] > MOST_MESSAGES:
                raise TooManyMessagesError
            self._database.executemany(query, batch)

    # --- comparing

    def compare(self, ahead: float | None) -> None:
        """Find the offset of the clocks, the messages that both have, and the spans of those that are missing here.

        Args:
            ahead: s by which the other side's clock is ahead, by the link, or None.
        """
        execute = self._database.execute
        execute("CREATE INDEX there_times ON there (topic, time)")
        early = self._find_offset(ahead)
        execute("CREATE TEMP TABLE pair (there INT, live INT)")
        self._match_latched()
        for comes in (True, False):
            chosen = [at for at, each in enumerate(self._topics) if each.comes == comes and at not in self.latched]
            if chosen:
                self._match_once(chosen, early, comes=comes)
                self._match_others(chosen, early, comes=comes)
        execute(
            "INSERT INTO span WITH"
            " each AS"
            " (SELECT topic, time, live, ROW_NUMBER() OVER (PARTITION BY topic ORDER BY id) AS place FROM there),"
            " gone AS (SELECT topic, time, place - ROW_NUMBER() OVER (PARTITION BY topic ORDER BY place) AS part"
            " FROM each WHERE live IS NULL)"
            " SELECT topic, MIN(time), MAX(time) FROM gone GROUP BY topic, part ORDER BY MIN(time), topic"
        )
        # Only those that have not come: of equal ones of one time, each would else be looked for behind all before it.
        execute("CREATE INDEX missing ON there (topic, time, key) WHERE live IS NULL AND came IS NULL")
        execute("CREATE INDEX only_live ON live (topic, time) WHERE there IS NULL AND repeats IS NULL")

    def _find_offset(self, ahead: float | None) -> int:
        """Set the clock, and return how much faster than that a message may be (ns)."""
        execute = self._database.execute
        chosen = [at for at, each in enumerate(self._topics) if each.comes and at not in self.latched]
        there, live = self._once(chosen)
        delays = f"SELECT live.time - there.time AS ns FROM {there} JOIN {live} USING (topic, key) ORDER BY ns"  # noqa: S608
        execute(f"CREATE TEMP TABLE delay AS {delays}")
        (count,) = execute("SELECT COUNT(*) FROM delay").fetchone()
        if not count:
            source = ClockSource.NONE if ahead is None else ClockSource.LINK
            self.clock = CompletedClock(source, 0 if ahead is None else round(-ahead * 1e9))
            return _EARLY
        query = "SELECT ns FROM delay ORDER BY ns LIMIT 1 OFFSET ?"
        places = 0, count // _TENTH, count // _QUARTER
        fastest, tenth, quarter = (int(execute(query, (at,)).fetchone()[0]) for at in places)
        self.clock = CompletedClock(ClockSource.MESSAGES, tenth, count, min(quarter - tenth, _MOST))
        return min(max(tenth - fastest, 0), _EARLY) + _LEAST_EARLY

    @property
    def _on_time(self) -> int:
        """How much later than the fastest ones a message is that nothing has delayed (ns)."""
        return min(max(_SPREADS * self.clock.spread, _ON_TIME), _EARLY)

    def _match_latched(self) -> None:
        """Match equal latched messages in their order, whatever their times are: they come again later."""
        if not self.latched:
            return
        names = ",".join(map(str, self.latched))
        there, live = (
            f"(SELECT topic, key, id, ROW_NUMBER() OVER (PARTITION BY topic, key ORDER BY time, id) AS place"  # noqa: S608
            f" FROM {table} WHERE topic IN ({names})) AS {table}"
            for table in ("there", "live")
        )
        same = f"SELECT there.id, live.id FROM {there} JOIN {live} USING (topic, key, place)"  # noqa: S608
        self._database.execute(f"INSERT INTO pair {same}")
        self._take_pairs()
        self._database.execute(
            f"UPDATE live SET repeats = 1 WHERE there IS NULL AND topic IN ({names}) AND EXISTS"  # noqa: S608
            " (SELECT 1 FROM there WHERE there.topic = live.topic AND there.key = live.key)"
        )

    def _take_pairs(self) -> None:
        for query in (
            "UPDATE there SET live = pair.live FROM pair WHERE pair.there = there.id",
            "UPDATE live SET there = pair.there FROM pair WHERE pair.live = live.id",
            "DELETE FROM pair",
        ):
            self._database.execute(query)

    def _match_once(self, topics: list[int], early: int, *, comes: bool) -> None:
        """Match messages whose content each side has once, if they are on time."""
        there, live = self._once(topics)
        ahead = f"live.time - there.time - {self.clock.offset}"
        delay = ahead if comes else f"-({ahead})"
        same = f"SELECT there.id, live.id FROM {there} JOIN {live} USING (topic, key)"  # noqa: S608
        self._database.execute(f"INSERT INTO pair {same} WHERE {delay} BETWEEN ? AND ?", (-early, self._on_time))
        self._take_pairs()

    def _once(self, topics: list[int]) -> tuple[str, str]:
        """Return queries for the messages of both sides whose content a side has once."""
        names = ",".join(map(str, topics))
        there, live = (
            f"(SELECT topic, key, MIN(id) AS id, MIN(time) AS time FROM {table} WHERE topic IN ({names})"  # noqa: S608
            f" GROUP BY topic, key HAVING COUNT(*) = 1) AS {table}"
            for table in ("there", "live")
        )
        return there, live

    def _match_others(self, topics: list[int], early: int, *, comes: bool) -> None:
        """Match the other messages of topics that come from there, or go there.

        No two messages of a topic overtake each other: those that are matched part the others.
        """
        names = ",".join(map(str, topics))
        sides = ("there", "live", self.clock.offset, not comes), ("live", "there", 0, comes)
        parts = " UNION ALL ".join(
            "SELECT topic, key, part, id, sinks, place FROM (SELECT topic, key, id,"  # noqa: S608
            f" SUM({other} IS NOT NULL) OVER (PARTITION BY topic ORDER BY time, id) AS part,"
            f" {int(is_sink)} AS sinks, time + {shift + (early if is_sink else 0)} AS place, {other} AS other"
            f" FROM {table} WHERE topic IN ({names})) WHERE other IS NULL"
            for table, other, shift, is_sink in sides
        )
        query = f"{parts} ORDER BY topic, key, part, place DESC, sinks DESC"
        rows = map(_Row._make, self._database.execute(query))
        on_time = early + self._on_time
        pairs = (
            pair if comes else pair[::-1]
            for _, equal in itertools.groupby(rows, key=lambda row: (row.topic, row.key, row.part))
            for pair in _pairs(equal, on_time)
        )
        self._database.cursor().executemany("INSERT INTO pair VALUES (?, ?)", pairs)
        self._take_pairs()

    # --- what follows from it

    @property
    def orders(self) -> int:
        """The number of orders that get all that is missing here."""
        count: int = self._database.execute("SELECT COUNT(*) FROM span").fetchone()[0]
        return -(-count // MOST_SPANS)

    def order(self, number: int, heads: Wanted) -> Wanted:
        """Return an order's spans, by its number from 0.

        Args:
            heads: the order of the heads.
        """
        query = "SELECT topic, begin, end FROM span ORDER BY rowid LIMIT ? OFFSET ?"
        rows: list[tuple[int, int, int]] = self._database.execute(query, (MOST_SPANS, number * MOST_SPANS)).fetchall()
        begins = [rows[0][1], *(begin for _, begin, _ in rows)]
        topics = sorted({topic for topic, _, _ in rows})  # this side may not read others
        spans = tuple(
            WantedSpan(topics.index(topic), begin - before, end - begin)
            for (topic, begin, end), before in zip(rows, begins, strict=False)
        )
        names = tuple(self._topics[topic].there for topic in topics)
        end = max(end for _, _, end in rows)
        return replace(heads, topics=names, begin=begins[0], end=end, heads=False, spans=spans)

    def here(self, time: int) -> int:
        """Return a time of the other side on this side's clock (ns since the epoch)."""
        return min(max(0, time + self.clock.offset), LATEST)

    def live_span(self) -> tuple[int, int]:
        """Return the times of the first and the last live message (ns since the epoch)."""
        begin, end = self._database.execute("SELECT MIN(time), MAX(time) FROM live").fetchone()
        return begin or 0, end or 0

    def live_places(self, begin: int, end: int) -> Iterator[tuple[int, Placed]]:
        """Yield the numbers of the live messages that have a place, in their order, with it.

        Args:
            begin, end: ns since the epoch on this side's clock, of those that the other side has not.
        """
        query = (
            "SELECT live.id, COALESCE(there.id, 0), COALESCE(channel, -1), there.time, published, number, live.time"
            " FROM live LEFT JOIN there ON there.id = live.there WHERE repeats IS NULL AND (live.there IS NOT NULL OR"
            " live.time BETWEEN ? AND ?) ORDER BY live.id"
        )
        for at, row, channel, time, published, number, came in self._database.execute(query, (begin, end)):
            if row:
                yield at, Placed(row, channel, self.here(time), self.here(published), number)
            else:
                yield at, Placed(0, -1, came, -1, 0)

    def begin_fetched(self) -> None:
        """Have all missing messages get their places anew."""
        self._database.execute("UPDATE there SET came = NULL WHERE came IS NOT NULL")

    def fetched_place(self, message: StoredMessage) -> Placed | None:
        """Return the place of a message that was fetched, or None if it is not missing (any more)."""
        topic = self._there.get(message.channel.topic, -1)
        key = content_key(message.content, is_cdr=message.channel.encoding == "cdr")
        query = (
            "SELECT id, channel, time, published, number FROM there INDEXED BY missing WHERE topic = ? AND time = ?"
            " AND key = ? AND live IS NULL AND came IS NULL ORDER BY id LIMIT 1"
        )
        found = self._database.execute(query, (topic, message.time, key)).fetchone()
        if found is None:
            return None
        self._database.execute("UPDATE there SET came = 1 WHERE id = ?", found[:1])
        row, channel, time, published, number = found
        return Placed(row, channel, self.here(time), self.here(published), number)

    def figures(self, begin: int, end: int) -> Iterator[TopicFigures]:
        """Yield the figures of all topics, once all that was fetched has its place.

        Args:
            begin, end: as for `live_places`.
        """
        for topic in range(len(self._topics)):
            both, fetched, size, whole = self._database.execute(
                "SELECT COUNT(live), COUNT(came), TOTAL(size * came), TOTAL(size) FROM there WHERE topic = ?", (topic,)
            ).fetchone()
            query = "SELECT COUNT(*), MIN(time), MAX(time) FROM there WHERE topic = ? AND live IS NULL AND came IS NULL"
            absent = self._database.execute(query, (topic,)).fetchone()
            only = self._only_live(topic, begin, end)
            size, whole = (min(int(each), _MOST) for each in (size, whole))
            yield TopicFigures(both + only, only, fetched, size, whole, AbsentMessages(*absent) if absent[0] else None)

    def _only_live(self, topic: int, begin: int, end: int) -> int:
        query = (
            "SELECT COUNT(*) FROM live WHERE topic = ? AND there IS NULL AND repeats IS NULL AND time BETWEEN ? AND ?"
        )
        count: int = self._database.execute(query, (topic, begin, end)).fetchone()[0]
        return count

    def lost(self, topic: int) -> tuple[int, list[AbsentMessages]]:
        """Return how many messages of a topic neither side has by their numbers, and the largest gaps."""
        streams: dict[int, _Streams] = {}
        total = 0
        largest: list[tuple[int, int, int]] = []
        query = "SELECT channel, number, time FROM there WHERE topic = ? AND number > 0 ORDER BY id"
        for channel, number, time in self._database.execute(query, (topic,)):
            before, count = streams.setdefault(channel, _Streams()).gap(number, time)
            if count:
                total += count
                heapq.heappush(largest, (count, before, time))
                if len(largest) > _GAPS:
                    heapq.heappop(largest)
        found = []
        for count, begin, end in sorted(largest, key=lambda gap: gap[1]):
            came = self._only_live(topic, self.here(begin), self.here(end))
            total -= min(count, came)
            if count > came:
                found.append(AbsentMessages(count - came, begin, end))
        return total, found


class _Streams:
    """The numbers of messages of some publishers, whom the recording does not tell apart."""

    def __init__(self) -> None:
        self._last: list[tuple[int, int]] = []  # number and time of each, the newest last

    def gap(self, number: int, time: int) -> tuple[int, int]:
        """Return the time of the message before, and how many are missing between it and this one."""
        before = max((each for each in self._last if each[0] < number), default=None, key=lambda each: each[0])
        if before is None or number - before[0] > _MOST_LOST:
            before = (number - 1, time)
            del self._last[: len(self._last) - _PUBLISHERS + 1]
        else:
            self._last.remove(before)
        self._last.append((number, time))
        return before[1], number - before[0] - 1


def _pairs(equal: Iterator[_Row], on_time: int) -> Iterator[tuple[int, int]]:
    """Yield the ids of equal messages that are the same: of the side where they come from, and of the other one.

    The last one that came is the last one that was sent before it, and so on, as outboxes let the oldest go. Those that
    are alone and on time part the others, as no message overtakes another one.

    Args:
        equal: the newest first.
        on_time: ns.
    """
    sources: deque[_Row] = deque(maxlen=_HELD)
    sinks: deque[_Row] = deque(maxlen=_HELD)
    rows = list(itertools.islice(equal, 3))
    if len(rows) == 2 and rows[0].is_sink and not rows[1].is_sink:
        yield rows[1].id, rows[0].id
        return
    source_before = sink_before = last_sink = _NEVER
    for row, following in itertools.pairwise(itertools.chain(rows, equal, (None,))):
        assert row is not None
        if row.is_sink:
            sinks.append(row)
            sink_before, last_sink = last_sink, row.place
            continue
        is_alone = (
            source_before - row.place > on_time
            and (following is None or following.is_sink or row.place - following.place > on_time)
            and sink_before - last_sink > 2 * on_time
        )
        source_before = row.place
        if is_alone and sinks and last_sink - row.place <= on_time:
            sink = sinks.pop()
            yield from _late_pairs(sources, sinks)
            sources.clear()
            sinks.clear()
            yield row.id, sink.id
        else:
            sources.append(row)
    yield from _late_pairs(sources, sinks)


def _late_pairs(sources: deque[_Row], sinks: deque[_Row]) -> Iterator[tuple[int, int]]:
    for source in sources:
        while sinks and sinks[0].place - source.place > _LATE:
            sinks.popleft()
        if sinks and sinks[0].place >= source.place:
            yield source.id, sinks.popleft().id
