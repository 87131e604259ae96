"""The way of each topic's messages, and the difference of two recordings' clocks. Times are in ns.

A recording does not say which of its topics a bridge has published. But only the sending side can have a message that
the other one lacks, and delays have a long end on the side of the late ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median_low
from typing import TYPE_CHECKING, Literal, NamedTuple

from rsb_extras.audit.recorded import view
from rsb_extras.audit.topic_pairs import is_named

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.patterns import Pattern
    from rsb_extras.audit.recorded import ReadRecording
    from rsb_extras.audit.topic_pairs import TopicPair

SECOND = 1_000_000_000
_FEWEST_DELAYS = 20  # messages of which it can be told which end of their delays is long. A round figure
_CLEARLY = 3  # times as many, or as long. A round figure

Way = Literal["to_far", "to_near"]
WayBy = Literal["option", "alone", "delays", "clocks", "assumed"]
"""Sources of a topic's way: the user; messages that only the sending side has; delays, whose late end is long;
clocks that other topics tell, or the user; or nothing."""
OffsetBy = Literal["option", "two_ways", "least_age", "assumed"]


class Clocks(NamedTuple):
    """How the clocks of two recordings compare.

    Attributes:
        offset: ns that FAR's clock is ahead.
        by: what says so: the user; messages both ways; the least age of messages one way, which then counts as 0; or
            nothing.
        uncertainty: ns, or None if unknown.
    """

    offset: int
    by: OffsetBy
    uncertainty: int | None = None


class Direction(NamedTuple):
    way: Way
    by: WayBy


@dataclass(frozen=True)
class _Differences:
    """FAR's times less NEAR's of a topic's messages that are there once on each side.

    Attributes:
        low, mid, high: percentiles 1, 50 and 99. A recorder that is late for once says nothing of a clock.
    """

    count: int
    low: int
    mid: int
    high: int


def directions(
    database: sqlite3.Connection,
    near: ReadRecording,
    far: ReadRecording,
    pairs: Sequence[TopicPair],
    *,
    back: Iterable[Pattern],
    forth: Iterable[Pattern],
    offset: int | None,
) -> tuple[list[Direction], Clocks]:
    """Return the way of each topic's messages, and how the clocks compare.

    Args:
        back: topics that go to NEAR, as the user says.
        forth: topics that go to FAR, as the user says.
        offset: ns that FAR's clock is ahead, if the user says so.
    """
    differences = [_differences(database, pair) for pair in pairs]
    known = [each.mid for each in differences if each is not None]
    rough = offset if offset is not None else median_low(known) if known else 0
    # Where a recording begins or ends, the other one has messages alone.
    covered = max(near.first, far.first - rough) + SECOND, min(near.last, far.last - rough) - SECOND
    given = None if offset is None else Clocks(offset, "option")
    told = [
        _by_option(pair, back, forth)
        or (given and each and _by_clocks(each, given))
        or _by_alone(database, pair, rough, covered)
        or _by_delays(each)
        for pair, each in zip(pairs, differences, strict=True)
    ]
    clocks = given or _clocks(told, differences)
    ways = [way or _by_clocks(each, clocks) for way, each in zip(told, differences, strict=True)]
    return ways, given or _clocks(ways, differences)


def _by_option(pair: TopicPair, back: Iterable[Pattern], forth: Iterable[Pattern]) -> Direction | None:
    ways: tuple[tuple[Way, Iterable[Pattern]], ...] = (("to_near", back), ("to_far", forth))
    for way, patterns in ways:
        if is_named(patterns, pair.near.name, pair.far.name):
            return Direction(way, "option")
    return None


def _by_delays(differences: _Differences | None) -> Direction | None:
    if differences is None or differences.count < _FEWEST_DELAYS:
        return None
    early, late = differences.mid - differences.low, differences.high - differences.mid
    if late > _CLEARLY * early:
        return Direction("to_far", "delays")
    return Direction("to_near", "delays") if early > _CLEARLY * late else None


def _by_alone(database: sqlite3.Connection, pair: TopicPair, offset: int, covered: tuple[int, int]) -> Direction | None:
    view(database, near=(pair.near, 0), far=(pair.far, offset))
    # A recorder may find this topic later than others.
    found = "SELECT max(first) FROM (SELECT min(time) AS first FROM near UNION ALL SELECT min(time) FROM far)"
    begin = max(covered[0], (database.execute(found).fetchone()[0] or 0) + SECOND)
    near, far = database.execute(
        "SELECT (SELECT count(*) FROM near WHERE time BETWEEN :begin AND :end"
        " AND NOT EXISTS (SELECT * FROM far WHERE far.key = near.key)),"
        " (SELECT count(*) FROM far WHERE time BETWEEN :begin AND :end"
        " AND NOT EXISTS (SELECT * FROM near WHERE near.key = far.key))",
        {"begin": begin, "end": covered[1]},
    ).fetchone()
    if near > _CLEARLY * far:
        return Direction("to_far", "alone")
    return Direction("to_near", "alone") if far > _CLEARLY * near else None


def _by_clocks(differences: _Differences | None, clocks: Clocks) -> Direction:
    if differences is None or clocks.by == "assumed":
        return Direction("to_far", "assumed")
    return Direction("to_near" if differences.mid < clocks.offset else "to_far", "clocks")


def _differences(database: sqlite3.Connection, pair: TopicPair) -> _Differences | None:
    """Return the differences of a topic's times, or None if no message tells any."""
    view(database, near=(pair.near, 0), far=(pair.far, 0))
    database.execute("DROP TABLE IF EXISTS difference")
    database.execute(
        "CREATE TEMP TABLE difference AS SELECT far.time - near.time AS ns"
        " FROM (SELECT key, min(time) AS time FROM near GROUP BY key HAVING count(*) = 1) AS near"
        " JOIN (SELECT key, min(time) AS time FROM far GROUP BY key HAVING count(*) = 1) AS far USING (key)"
        " WHERE near.time > (SELECT min(time) + :after FROM near) AND far.time > (SELECT min(time) + :after FROM far)",
        # A recorder that comes late gets latched messages at once, which says nothing of when they were sent.
        {"after": SECOND if pair.near.offer.latched is True or pair.far.offer.latched is True else -1},
    )
    count = database.execute("SELECT count(*) FROM difference").fetchone()[0]
    if not count:
        return None
    lowest = (count - 1) // 100
    ranks = (lowest, (count - 1) // 2, count - 1 - lowest)
    rows = database.execute(
        "SELECT rank, ns FROM (SELECT ns, row_number() OVER (ORDER BY ns) - 1 AS rank FROM difference)"
        " WHERE rank IN (?, ?, ?)",
        ranks,
    )
    by_rank = dict(rows)
    return _Differences(count, *(by_rank[rank] for rank in ranks))


def _clocks(ways: Sequence[Direction | None], differences: Sequence[_Differences | None]) -> Clocks:
    """Compare the clocks: no message comes before it was sent, and the fastest ones take as long both ways."""
    known = [(way.way, each) for way, each in zip(ways, differences, strict=True) if way and each]
    least = min((each.low for way, each in known if way == "to_far"), default=None)
    most = max((each.high for way, each in known if way == "to_near"), default=None)
    if least is not None and most is not None:
        return Clocks((least + most) // 2, "two_ways", abs(least - most) // 2)
    if least is not None:
        return Clocks(least, "least_age")
    return Clocks(0, "assumed") if most is None else Clocks(most, "least_age")
