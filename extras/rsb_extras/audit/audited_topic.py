"""The counts of one topic in two recordings, and what QoS promises of them.

Times are in ns, in *common time*: that of NEAR's clock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import msgspec

from rsb_extras.audit.directions import SECOND, Way, WayBy
from rsb_extras.audit.matching import match_messages
from rsb_extras.audit.recorded import view

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Iterator

    from rsb_extras.audit.directions import Clocks, Direction
    from rsb_extras.audit.recorded import ReadRecording
    from rsb_extras.audit.topic_pairs import TopicPair

IN_FLIGHT = SECOND
"""ns before the end in which a message may still be on its way, beside the p99 of its topic's ages. A round figure."""
OPENING = 10 * SECOND
"""ns from a topic's first message in which nothing has to cross yet. A round figure: discovery takes 1 to 3 s."""
GAPS_KEPT = 100  # gaps of a topic on a side that are listed; the others are counted
_TOLERANCE = 2_000_000
"""ns that clocks may be off, beside their uncertainty. A round figure, above the jitter of time synchronisation."""
_FEWEST = 3  # intervals of which a usual one can be told
_USUAL_INTERVALS = 3
"""Usual intervals that a silence lasts at least, as a topic of 1 Hz has no message for 1.0 s all the time. A round
figure: two messages that are lost are none."""
_NEVER = -1 << 62

LatchedValue = Literal["same", "old", "absent", "undecided"]


class SilentTime(msgspec.Struct, frozen=True):
    """A silence of a topic that usually is not silent for so long.

    Attributes:
        start, end: s since the epoch on the clock of its side.
        other: messages on the other side meanwhile, one that belongs to its end left out; 0 if that side was silent for
            most of it, too.
        open: it lasts until the recording's end.
    """

    start: float
    end: float
    other: int
    open: bool = False


class AuditedTopic(msgspec.Struct):
    """What two recordings say of one topic. Ages are in s.

    Attributes:
        by_order: messages that are equal to others, so that their order decided.
        early: messages from before the first that crossed, for `OPENING` at most.
        undecided: messages that may have been on their way at the end.
        outside: messages that only their sender's recording covers, and that did not arrive.
        elsewhere: messages that only the receiving side has.
        latched_value: of a latched topic, or None.
        gaps, more_gaps: by side, `near` and `far`: the first ones, and how many more there are.
        nothing_common: both sides have messages, and none is the same.
        described: both recordings describe the type, so that padding inside messages does not count.
    """

    topic: str
    far_topic: str
    type: str
    paired_by: str
    way: Way
    way_by: WayBy
    reliable: bool | None
    latched: bool | None
    near: int
    far: int
    matched: int = 0
    by_order: int = 0
    lost: int = 0
    doubled: int = 0
    disordered: int | None = 0
    early: int = 0
    undecided: int = 0
    outside: int = 0
    elsewhere: int = 0
    age_p50: float | None = None
    age_p99: float | None = None
    latched_value: LatchedValue | None = None
    nothing_common: bool = False
    described: bool = True
    gaps: dict[str, list[SilentTime]] = msgspec.field(default_factory=lambda: {"near": [], "far": []})
    more_gaps: dict[str, int] = msgspec.field(default_factory=lambda: {"near": 0, "far": 0})

    def breaches(self) -> Iterator[tuple[str, int]]:
        """Yield what QoS promises and did not happen, and how often."""
        if self.nothing_common:
            return
        if self.reliable:
            counts = {"lost": self.lost, "doubled": self.doubled, "disordered": self.disordered or 0}
            yield from ((kind, count) for kind, count in counts.items() if count)
        if self.latched_value in ("old", "absent"):
            yield f"latched_{self.latched_value}", 1


class Audit:
    """Compares topics of two recordings, one after the other.

    Attributes:
        begin, end: the time that both recordings cover, in common time.
    """

    def __init__(
        self, database: sqlite3.Connection, near: ReadRecording, far: ReadRecording, clocks: Clocks, gap: float
    ) -> None:
        self._database = database
        self._offset = {"near": 0, "far": clocks.offset}
        self._ends = {"near": near.last, "far": far.last - clocks.offset}
        self.begin = max(near.first, far.first - clocks.offset)
        self.end = min(self._ends.values())
        # The order of equal messages allows for an error of the clocks: none comes before it was sent.
        self._tolerance = _TOLERANCE + (clocks.uncertainty or 0)
        self._gap = round(min(gap, 1e9) * SECOND)

    def compare(self, pair: TopicPair, direction: Direction) -> AuditedTopic:
        """Return what the recordings say of a topic whose messages go to one side."""
        near, far = ((topic, self._offset[side]) for topic, side in ((pair.near, "near"), (pair.far, "far")))
        (source, _), (sink, _) = sent, came = (near, far) if direction.way == "to_far" else (far, near)
        view(self._database, near=near, far=far, source=sent, sink=came)
        result = AuditedTopic(
            pair.near.name, pair.far.name, pair.near.type_name, pair.by, *direction, source.offer.reliable,
            source.offer.latched, pair.near.messages, pair.far.messages,
        )  # fmt: skip
        result.matched, result.by_order = match_messages(
            self._database, self._tolerance, is_latched=source.offer.latched is True
        )
        result.described = source.described and sink.described
        result.nothing_common = bool(source.messages and sink.messages and not result.matched)
        self._count(result)
        if result.latched and not result.nothing_common:
            one_value = source.one_publisher_each and len(source.senders) == 1
            result.latched_value = self._latched_value(one_value=one_value)
        result.disordered = self._disordered() if source.one_publisher_each else None
        self._find_gaps(result)
        return result

    def _count(self, result: AuditedTopic) -> None:
        """Take numbers and ages from the tables of matches."""
        one = self._one
        if result.latched:
            # What a recorder got as a late joiner, and when, is no age of the bridge's.
            late = one("SELECT max(min(source), min(sink)) FROM pair") or 0
            after = late + SECOND
        else:
            after = _NEVER
        # Of equal messages, those that are matched in order tell ages, where there are no others.
        alike = 0 if one("SELECT count(*) FROM pair WHERE alike = 0") else 1
        count = one("SELECT count(*) FROM pair WHERE alike = ? AND source > ?", alike, after)
        settled = self.end - IN_FLIGHT
        if count:
            ages = self._database.execute(
                "SELECT age FROM (SELECT sink - source AS age, row_number() OVER (ORDER BY sink - source) AS rank"
                " FROM pair WHERE alike = ? AND source > ?) WHERE rank IN (?, ?) ORDER BY 1",
                (alike, after, *(1 + (count - 1) * share // 100 for share in (50, 99))),
            ).fetchall()
            (p50,), (p99,) = ages[0], ages[-1]
            result.age_p50, result.age_p99 = p50 / SECOND, p99 / SECOND
            settled -= min(max(p99, 0), OPENING)
        # What was sent a second before something that has come should have come, too, however late others were.
        settled = max(settled, (one("SELECT max(source) FROM pair") or 0) - IN_FLIGHT)
        # Before the first message crosses, a bridge or a recorder may not have found the topic yet. Of a topic that
        # has nothing on the receiving side, all are lost.
        first = one("SELECT min(source) FROM pair")
        begin = max(self.begin, one("SELECT min(time) FROM source") or 0)
        opened = begin if first is None else max(min(first, begin + OPENING), begin)
        if not result.nothing_common:
            # Which of equal messages were lost is not known, so that the first ones may be only named for others.
            arrived = one("SELECT min(sink) FROM pair")
            equal = opened if arrived is None else min(opened, max(self.begin, arrived - IN_FLIGHT))
            missing = (
                "SELECT count(*) FROM missing"
                " WHERE (time < CASE alike WHEN 0 THEN ? ELSE ? END) = ? AND time BETWEEN ? AND ?"
            )
            result.early = one(missing, opened, equal, True, self.begin, self.end)
            result.lost = one(missing, opened, equal, False, self.begin, settled)
            result.undecided = one(missing, opened, equal, False, settled + 1, self.end)
            result.outside = one("SELECT count(*) FROM missing WHERE NOT time BETWEEN ? AND ?", self.begin, self.end)
        # Equal messages that were in flight when the sender's recording began look like doubled ones.
        result.doubled = one(
            "SELECT count(*) FROM surplus WHERE sent AND time <= ? AND time >= CASE alike WHEN 0 THEN ? ELSE ? END",
            self.end, self.begin, self.begin + IN_FLIGHT,
        )  # fmt: skip
        result.elsewhere = one(
            "SELECT count(*) FROM surplus WHERE NOT sent AND time BETWEEN ? AND ?", self.begin + IN_FLIGHT, self.end
        )

    def _disordered(self) -> int:
        """Count the messages that came after one that their sender sent later. Equal ones have no order."""
        return self._one(
            "SELECT count(*) FROM (SELECT sent, max(sent) OVER (PARTITION BY sender ORDER BY came, sent"
            " ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING) AS latest FROM pair WHERE NOT alike)"
            " WHERE sent < latest"
        )

    def _latched_value(self, *, one_value: bool) -> LatchedValue:
        """Judge what a late joiner would get at the end.

        Args:
            one_value: one publisher is known to have sent all messages, so that each takes the last one's place.
        """
        one = self._one
        last = "SELECT key, time FROM {} WHERE time <= ? ORDER BY time DESC LIMIT 1"
        due = self._database.execute(last.format("source"), (self.end - IN_FLIGHT,)).fetchone()
        if due is None:
            return "undecided"
        shown = self._database.execute(last.format("sink"), (self.end,)).fetchone()
        if shown is None:
            return "absent"
        if one("SELECT count(*) FROM source WHERE key = ? AND time >= ?", shown[0], due[1]):
            return "same"
        was_sent = one("SELECT count(*) FROM source WHERE key = ?", shown[0]) > 0
        # The receiving side's own publishers, and several publishers of one topic, each keep a value.
        if not (was_sent and one_value) and one("SELECT count(*) FROM sink WHERE key = ?", due[0]):
            return "same"
        return "old" if was_sent else "absent"

    def _find_gaps(self, result: AuditedTopic) -> None:
        """Find silences on both sides, in one pass over all times."""
        source, sink = ("near", "far") if result.way == "to_far" else ("far", "near")
        intervals = self._one("SELECT count(*) FROM source") - 1
        if intervals < _FEWEST:
            return
        usual = self._one(
            "SELECT interval FROM (SELECT time - lag(time) OVER (ORDER BY time) AS interval FROM source)"
            " WHERE interval IS NOT NULL ORDER BY interval LIMIT 1 OFFSET ?",
            intervals // 2,
        )
        least = max(self._gap, _USUAL_INTERVALS * usual)
        # Both sides of a silence of the sender begin and end together, once the usual age is taken away.
        shift = {source: 0, sink: round((result.age_p50 or 0.0) * SECOND)}
        near, far = (_Silences(least, shift[side] + self._offset[side]) for side in ("near", "far"))
        sides = {"near": (near, far), "far": (far, near)}
        times = "SELECT time - ?, 'near' FROM near UNION ALL SELECT time - ?, 'far' FROM far ORDER BY 1, 2 DESC"
        for time, side in self._database.execute(times, (shift["near"], shift["far"])):
            own, other = sides[side]
            if time > self.begin and own.last < self.end:
                own.end(time, to_end=False)
            own.begin(time)
            other.hear_other(time)
        for side, (own, _) in sides.items():
            if own.last < self.end:
                own.end(self._ends[side] - shift[side], to_end=True)
            result.gaps[side], result.more_gaps[side] = own.found, own.more

    def _one(self, query: str, *values: object) -> int:
        found: int = self._database.execute(query, values).fetchone()[0]
        return found


class _Silences:
    """Finds the silences of one side of a topic, and tells those that are the other side's, too.

    Args:
        least: ns that a silence lasts at least.
        shift: ns to add for the time of the side's own clock.

    Attributes:
        last: ns, time of the newest message, or `_NEVER`.
        found, more: as `AuditedTopic.gaps` and `more_gaps`.
    """

    def __init__(self, least: int, shift: int) -> None:
        self.found: list[SilentTime] = []
        self.more = 0
        self.last = self._other = _NEVER
        self._others = self._longest = 0
        self._least = least
        self._shift = shift

    def begin(self, time: int) -> None:
        self.last = self._other = time
        self._others = self._longest = 0

    def hear_other(self, time: int) -> None:
        """Take in a message of the other side."""
        self._longest = max(self._longest, time - self._other)
        self._other = time
        self._others += 1

    def end(self, time: int, *, to_end: bool) -> None:
        """Add the silence that lasts until `time`, if it is one."""
        length = time - self.last
        if self.last == _NEVER or length <= self._least:
            return
        if len(self.found) == GAPS_KEPT:
            self.more += 1
            return
        longest = max(self._longest, time - self._other)
        if 2 * longest >= length and length - longest <= self._least:
            others = 0  # jitter has moved messages of the silence's ends into it
        elif to_end and self._others > 1:
            others = self._others
        else:
            others = max(self._others - 1, 0)  # a message at one of its ends has a counterpart, too
        start, end = (each + self._shift for each in (self.last, time))
        self.found.append(SilentTime(start / SECOND, end / SECOND, others, to_end))
