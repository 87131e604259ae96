"""Matches of messages between two recordings.

Numbers of messages do not cross every bridge, so messages are matched by content. Equal ones are matched in order if
both sides have as many. Otherwise each that came takes the newest one that waits: so a loss, or a recording that begins
earlier, moves no later match. This is wrong for as many messages at most as are in flight where a recording begins or
ends.

All times are in ns, in *common time*: that of NEAR's clock.
"""

from __future__ import annotations

from itertools import chain, groupby, islice
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

from rsb_extras.audit.recorded import ROWS_HELD, insert

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Iterable, Iterator

_PIECE = 200_000  # equal messages that are compared at once: some 40 MB
_TABLES = {"pair": "sender, source, sink, alike, sent, came", "missing": "time, alike", "surplus": "time, sent, alike"}
"""Tables of one topic's matches: messages that crossed, those that did not come, and those that came without one that
was sent. `sent` and `came` are the turns of `rsb_extras.audit.recorded.view`, in `surplus` `sent` is whether an equal
message was. `alike` is 0 for a message that no other equals, `_IN_ORDER` or `_NEWEST` for others."""
_IN_ORDER, _NEWEST = 1, 2
_BEFORE = 1_000_000_000
"""ns by which a message may come before it was sent, by clocks that were set meanwhile. A round figure."""
_EQUAL_BEFORE = 20_000_000  # the same for one of several equal messages, of which another may be meant
_Row: TypeAlias = tuple[int, int, int, int, int, int]
"""Key, time, sender, whether it is of the receiving side, its place among equal ones, and its turn."""


def match_messages(database: sqlite3.Connection, tolerance: int, *, is_latched: bool) -> tuple[int, int]:
    """Match the messages of the views `source` and `sink`, and fill the tables `pair`, `missing` and `surplus`.

    Args:
        tolerance: ns by which a message may come before it was sent, by the two clocks.
        is_latched: a recorder may get a message late, and more than once.

    Returns:
        How many have a match, and how many of these are equal to others, so that their order decided.
    """
    for table, columns in _TABLES.items():
        database.execute(f"DROP TABLE IF EXISTS {table}")
        database.execute(f"CREATE TABLE {table} ({columns})")
    rows = database.execute(
        "SELECT key, time, sender, 0 AS came, time AS place, turn FROM source"
        " UNION ALL SELECT key, time, sender, 1, time + ?, turn FROM sink ORDER BY key, place, came",
        (tolerance,),
    )
    matches = _Matches(database, is_latched=is_latched)
    for _, equal in groupby(rows, key=itemgetter(0)):
        matches.add(equal)
    matches.write()
    return matches.matched, matches.by_order


class _Matches:
    """Writes the matches of one topic to their tables."""

    def __init__(self, database: sqlite3.Connection, *, is_latched: bool) -> None:
        self.matched = 0
        self.by_order = 0
        self._database = database
        self._is_latched = is_latched
        self._pair: list[tuple[int, int, int, int, int, int]] = []
        self._missing: list[tuple[int, int]] = []
        self._surplus: list[tuple[int, bool, int]] = []

    def add(self, equal: Iterator[_Row]) -> None:
        """Match equal messages of both sides, which come in the order of their times."""
        rows = list(islice(equal, _PIECE))
        sources = [row for row in rows if not row[3]]
        sinks = [row for row in rows if row[3]]
        if len(rows) == _PIECE:
            self._match_newest(chain(rows, equal))
        elif not sinks:
            self._missing += [(row[1], _IN_ORDER if len(sources) > 1 else 0) for row in sources]
        elif not sources:
            self._surplus += [(row[1], False, 0) for row in sinks]
        elif self._is_latched:
            self._cross(zip(sources, sinks, strict=False), alike=_IN_ORDER if len(rows) > 2 else 0)
            self._surplus += [(row[1], True, 0) for row in sinks[len(sources) :]]
        else:
            # What came before all that were sent was sent before its sender's recording began.
            begin = sources[0][1] - (_BEFORE if len(rows) == 2 else _EQUAL_BEFORE)
            self._surplus += [(row[1], False, 0) for row in sinks if row[1] < begin]
            self._match(sources, [row for row in rows if not row[3] or row[1] >= begin])
        self._write_if_full()

    def _match(self, sources: list[_Row], rows: list[_Row]) -> None:
        """Match equal messages; `rows` are those of both sides in their order."""
        sinks = [row for row in rows if row[3]]
        if len(sources) == len(sinks):
            self._cross(zip(sources, sinks, strict=True), alike=_IN_ORDER if len(sources) > 1 else 0)
        elif len(sources) == 1 and sinks:
            self._cross([(sources[0], sinks[0])], alike=0)
            self._surplus += [(row[1], True, 0) for row in sinks[1:]]
        else:
            self._match_newest(rows)

    def write(self) -> None:
        for table, rows in (("pair", self._pair), ("missing", self._missing), ("surplus", self._surplus)):
            insert(self._database, table, rows)

    def _write_if_full(self) -> None:
        if len(self._pair) + len(self._missing) + len(self._surplus) > ROWS_HELD:
            self.write()

    def _cross(self, pairs: Iterable[tuple[_Row, _Row]], *, alike: int) -> None:
        before = len(self._pair)
        self._pair += [(source[2], source[1], sink[1], alike, source[5], sink[5]) for source, sink in pairs]
        self.matched += len(self._pair) - before
        if alike:
            self.by_order += len(self._pair) - before

    def _match_newest(self, rows: Iterable[_Row]) -> None:
        """Match each message that came with the newest one before it."""
        waiting: list[_Row] = []
        was_sent = False
        for row in rows:
            if not row[3]:
                was_sent = True
                waiting.append(row)
                if len(waiting) == _PIECE:
                    self._missing += [(each[1], _NEWEST) for each in waiting[: _PIECE // 2]]
                    del waiting[: _PIECE // 2]
            elif waiting:
                self._cross([(waiting.pop(), row)], alike=_NEWEST)
            else:
                self._surplus.append((row[1], was_sent, _NEWEST))
            self._write_if_full()
        self._missing += [(row[1], _NEWEST) for row in waiting]
