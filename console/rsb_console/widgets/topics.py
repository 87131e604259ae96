"""The table of bridged topics, services, actions and nodes' parameters, with the columns that fit its width."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, cast

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import plural
from rsb_bridge.model.transports import short_name
from rsb_bridge.model.verdict import Cause
from rsb_console.notation import formats
from rsb_console.notation.formats import KIND_SHORT, PatternRow, Row, rows_of
from rsb_console.notation.glyphs import ACK_WORD, ARMED, ARMED_WORD, IN, KNOWN, OUT, STATE_SIGN, STATE_WORD, sparkline
from rsb_console.notation.topic_column import ADDED
from rsb_console.widgets.filter import table_title
from rsb_console.widgets.lines import fit
from rsb_console.widgets.selectable_list import Column, Order, SortedTable, filled

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.widgets.filter import RowFilter
    from rsb_console.widgets.lines import Line
    from rsb_console.widgets.selectable_list import Layout

FAULTS = tuple(state for state in State if state is not State.OK and not state.is_wanted)
WIDE = 70  # cells; a narrower table shows a state's sign without its word
HISTORY, _SHORT_HISTORY = 12, 7
"""s, usually, and at least, where long names need the room."""
_LEAST_NAME, _LONGEST_NAME = 14, 40
"""Cells that the columns leave a name, and for which other columns give way."""
_STATE_WIDTH = 10  # cells
TOTAL_FROM = 92  # cells from which on there is room for the bytes in all
_ENDLESS = 1000  # cells of a table that has room for all columns
_BESIDE_CALLS = 100  # cells; wider tables have room for both topics' bytes and figures of calls


def state_order(state: State, *, acknowledged: bool) -> float:
    """Return the rank of a state, the worst first; acknowledged faults come after all others."""
    return State.WAITING.rank - 0.5 if acknowledged else state.rank


def _by_state(row: Row) -> tuple[float, int, str]:
    return state_order(row.state, acknowledged=row.acknowledged is not None), row.state.rank, row.topic


def _state(row: Row) -> str:
    if row.acknowledged is not None:
        return f"{ACK_WORD} {STATE_WORD[row.state]}"
    word = ARMED_WORD if is_armed(row) and row.state is State.OK else STATE_WORD[row.state]
    text = f"{_sign(row)} {word}"
    if row.cause == Cause.SEVERAL_PUBLISHERS and not isinstance(row, PatternRow) and row.drivers:
        text += f" ×{len(row.drivers)}"
    # DISARMING has no room for its sign.
    return text if len(text) <= _STATE_WIDTH else word


def _sign(row: Row) -> str:
    if row.acknowledged is not None:
        return KNOWN
    return ARMED if is_armed(row) else STATE_SIGN[row.state]


def is_armed(row: Row) -> bool:
    return row.arming is not None and row.arming.armed


def via(row: Row) -> str:
    """Return the direction of a topic or of requests, and the transport."""
    way = OUT if row.outgoing else IN
    if isinstance(row, PatternRow):
        return f"{way} match"
    if row.transport == "bluetooth":
        return f"{way} BT {row.port}"
    return f"{way} {short_name(row.transport)}"


def _rate(route: RouteSnapshot) -> str:
    rate = formats.hertz(present_rate(route)) if carries(route) else "-"
    if route.calls is not None:
        return f"{rate} +{route.calls.in_flight}" if route.calls.in_flight else rate
    return f"{rate}{formats.beside_rate(route)}"


def present_rate(route: RouteSnapshot) -> float:
    """Return a topic's rate in Hz, 0 after it has stopped: the mean still covers seconds in which it flowed."""
    return 0.0 if route.state in {State.STALE, State.STOPPED} else route.rate


def carries(route: RouteSnapshot) -> bool:
    """Whether a topic's rate and throughput have a meaning in its present state."""
    return route.state.flows or route.state in {State.STALE, State.STOPPED}


def _way(route: RouteSnapshot) -> float | None:
    """Return the time in transit (s): a message's, or a call's there and back."""
    return route.latency_p50 if route.calls is None else route.calls.way_p50


def _node(route: RouteSnapshot) -> float | None:
    return None if route.calls is None else route.calls.node_p50


def _milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else formats.milliseconds(seconds)


def last_failure(route: RouteSnapshot) -> str:
    return "" if route.calls is None else route.calls.last_failure


# Each `from_width` leaves the topics' names 14 cells at least, in a table of any width from 40 on.
_FIGURES: tuple[Column[RouteSnapshot], ...] = (
    Column(
        "kB/s",
        6,
        lambda r: formats.kilobytes(r.bytes_per_second) if carries(r) else "-",
        lambda r: -r.bytes_per_second,
        from_width=56,
        beside_calls=_BESIDE_CALLS,
    ),
    Column(
        "TOTAL",
        8,
        lambda r: formats.byte_count(r.bytes_total),
        lambda r: -r.bytes_total,
        from_width=TOTAL_FROM,
        beside_calls=_BESIDE_CALLS + 16,
    ),
    Column("ms", 5, lambda r: _milliseconds(_way(r)), lambda r: -(_way(r) or 0.0), from_width=64),
    Column(
        "NODE",
        5,
        lambda r: _milliseconds(_node(r)),
        lambda r: -(_node(r) or 0.0),
        from_width=_BESIDE_CALLS,
        only_calls=True,
    ),
    Column("AGE", 5, lambda _: "-", lambda r: math.inf if r.last_at is None else r.last_at, from_width=48),
    Column(
        " HISTORY",
        HISTORY + 1,
        lambda r: sparkline(r.history, HISTORY, r.expected_rate or max(r.history, default=0)),
        lambda r: -sum(r.history),
        right=False,
        from_width=78,
        least=_SHORT_HISTORY + 1,
    ),
    Column("LAST FAILURE", 36, last_failure, last_failure, right=False, from_width=156, only_calls=True),
)


def _of_routes(column: Column[RouteSnapshot], of_pattern: Callable[[PatternRow], str] = lambda _: "") -> Column[Row]:
    """Make a column of figures, which patterns don't have. They come after all routes if it sorts the table."""
    text, order = column.text, column.order
    return replace(
        cast("Column[Row]", column),
        text=lambda row: of_pattern(row) if isinstance(row, PatternRow) else text(row),
        order=lambda row: (1,) if isinstance(row, PatternRow) else (0, order(row)),
    )


COLUMNS: tuple[Column[Row], ...] = (
    Column("STATE", _STATE_WIDTH, _state, _by_state, right=False, from_width=WIDE),
    Column("", 2, _sign, _by_state, right=False),
    Column(
        "KIND",
        4,
        lambda r: KIND_SHORT[r.spec.kind],
        lambda r: (tuple(KIND_SHORT).index(r.spec.kind), r.topic),
        right=False,
        from_width=50,
        only_calls=True,
    ),
    Column("TOPIC", 0, lambda r: r.topic, lambda r: r.topic, right=False, names=True),
    Column("PEER", 10, lambda r: r.link, lambda r: (r.link, r.topic), right=False, from_width=100),
    Column(
        "VIA",
        7,
        via,
        lambda r: (r.outgoing, r.transport, 0 if isinstance(r, PatternRow) else r.port),
        right=False,
        from_width=40,
    ),
    _of_routes(
        Column("HZ/EXP", 9, _rate, lambda r: (-present_rate(r), -r.calls.in_flight if r.calls else 0)),
        lambda pattern: f"{pattern.routes} {plural(pattern.routes, 'name')}",
    ),
    *map(_of_routes, _FIGURES),
    *(
        _of_routes(Column(each.title, each.width, each.text, each.text, right=False, from_width=each.from_width))
        for each in ADDED
    ),
)
STATE, SIGN, TOPIC, PEER, _RATE_COLUMN, _AGE, HISTORY_COLUMN = (
    next(column for column in COLUMNS if column.title == title)
    for title in ("STATE", "", "TOPIC", "PEER", "HZ/EXP", "AGE", " HISTORY")
)

_ALWAYS = (STATE, SIGN, TOPIC)
_FIGURED = COLUMNS[COLUMNS.index(_RATE_COLUMN) :]


@cache
def layout(
    width: int,
    *,
    peers: bool,
    grouped: bool = False,
    calls: bool = False,
    wanted: frozenset[str] | None = None,
    names: int = 0,
) -> Layout[Row]:
    """Return the columns that fit into so many cells, each with its width.

    Args:
        peers: whether there are several peers, so that the table needs a column for them.
        grouped: whether that column comes first, however narrow the table is.
        calls: whether the table has more than topics.
        names: cells of the longest name.
        wanted: the headings that the operator wants besides state and topic, or None for those of a table this wide.
    """
    hidden = {SIGN if width >= WIDE else STATE} | (set() if peers and not grouped else {PEER})
    possible = [column for column in COLUMNS if column not in hidden]
    if wanted is None:
        shown = [column for column in possible if column.fits(width, calls=calls)]
    else:
        room = width - (PEER.width + 1) * grouped
        shown = _chosen([column for column in possible if calls or not column.only_calls], room, wanted, calls=calls)
    if grouped:
        shown.insert(0, PEER)
        if wanted is None and width < TOTAL_FROM and shown[-1] is HISTORY_COLUMN:
            shown.pop()  # the names need its room
    return filled(shown, width - 1, names)


def _chosen(columns: list[Column[Row]], width: int, wanted: frozenset[str], *, calls: bool) -> list[Column[Row]]:
    """Return the wanted columns that have room; the columns of narrow tables come first."""
    shown = [each for each in columns if each in _ALWAYS]
    room = width - 1 - _LEAST_NAME - sum(each.width + 1 for each in shown)
    for column in sorted(columns, key=lambda each: each.needs(calls=calls)):
        if column.title.strip() in wanted and column.width < room:
            shown.append(column)
            room -= column.width + 1
    return sorted(shown, key=columns.index)


class TopicsTable(SortedTable[Row]):
    """Shows the routes of a snapshot, and the patterns that make some of them, one per line."""

    def __init__(self) -> None:
        super().__init__(Order(STATE), id="topics")
        self.rows: dict[str, Row] = {}
        self.faults_only = False
        self.grouped = False  # by robot
        self.pattern: RowFilter | None = None
        self.wanted_columns: frozenset[str] | None = None  # headings besides state and topic; None for all that fit
        self.now = 0.0
        self._peers = self._calls = False
        self._away: frozenset[str] = frozenset()  # links that are awaited, with what waits for them
        self._names = 0

    def show(self, snapshot: Snapshot) -> None:
        self.now = snapshot.time
        self.rows = {row.key: row for row in rows_of(snapshot)}
        self._peers = len(snapshot.links) > 1
        self._away = frozenset(link.name for link in snapshot.links if link.association_ends is not None)
        self._calls = any(row.spec.kind != "topic" for row in self.rows.values())
        self._names = min(_LONGEST_NAME, max((len(row.topic) for row in self.rows.values()), default=0))
        self.relist()

    def relist(self) -> None:
        filtered = self.faults_only or self.pattern is not None
        shown = [row for row in self.rows.values() if not filtered or self._wanted(row)]
        shown.sort(key=self.order.column.order, reverse=self.order.reversed)
        if self.grouped:
            # Sorting is stable: within a robot, the chosen order stays.
            shown.sort(key=lambda row: row.link)
        self.show_keys([row.key for row in shown])
        name = f"{'Topics and calls' if self._calls else 'Topics'}{' by robot' if self.grouped else ''}"
        counts = {"shown": len(shown), "rows": len(self.rows)}
        parts = table_title(name, self.pattern, faults_only=self.faults_only, **counts)
        self.entitle(f" {' ▸ '.join(parts)} ")

    def _wanted(self, row: Row) -> bool:
        if self.faults_only and row.state not in FAULTS:
            return False
        # A word such as "topic" or the only peer's name would match every line.
        hidden = ("kind",) if self._peers else ("kind", "robot")
        return self.pattern is None or self.pattern.matches(_searched(row), hidden=hidden)

    def select(self, key: str) -> None:
        if key in self.keys:
            self.move_to(self.keys.index(key))

    @property
    def selected(self) -> Row | None:
        return None if self.cursor_key is None else self.rows[self.cursor_key]

    @property
    def route(self) -> RouteSnapshot | None:
        """The route under the cursor, or None if that is a pattern."""
        row = self.selected
        return None if isinstance(row, PatternRow) else row

    @property
    def listed(self) -> list[Row]:
        """The rows shown, in the table's order."""
        return [self.rows[key] for key in self.keys]

    def is_match(self, key: str) -> bool:
        row = self.rows[key]
        return self.pattern is not None or (row.state in FAULTS and row.acknowledged is None)

    def row_line(self, key: str, *, cursor: bool) -> Line:
        row = self.rows[key]
        pieces = [("▌", row.state.value) if cursor else (" ", "")]
        note = self._note(row)
        for column, width in self.columns:
            if note and column in _FIGURED:
                pieces.append((f"{note[: width + 1]:<{width + 1}}", _look(STATE, row)))
                note = note[width + 1 :]
            elif column is _AGE and not isinstance(row, PatternRow) and row.last_at is not None:
                pieces.append((column.aligned(formats.age_of(row.last_at, self.now), width), _look(column, row)))
            else:
                pieces.append((column.cell(row, width), _look(column, row)))
        return tuple(pieces)

    def _note(self, row: Row) -> str:
        """Return what waits for a row's link, or still crosses, or an empty string.

        It replaces the figures, which say nothing meanwhile.
        """
        if row.cause != Cause.CATCHING_UP and (row.cause != Cause.LINK_DOWN or row.link not in self._away):
            return ""
        room = sum(width + 1 for column, width in self.columns if column in _FIGURED)
        return "".join(text for text, _ in fit(((row.reason, ""),), room))

    @property
    def columns(self) -> Layout[Row]:
        return self._layout(self.width)

    def _layout(self, width: int) -> Layout[Row]:
        return layout(
            width,
            peers=self._peers,
            grouped=self.grouped,
            calls=self._calls,
            wanted=self.wanted_columns,
            names=self._names,
        )

    def why_not_shown(self, title: str) -> str:
        """Return the reason why a wanted column is not in the table, or an empty string."""
        if any(column.title.strip() == title for column, _ in self.columns):
            return ""
        anywhere = any(column.title.strip() == title for column, _ in self._layout(_ENDLESS))
        return "no room" if anywhere else "nothing to show"


def _searched(row: Row) -> dict[str, str]:
    """Return the texts of a row that a filter looks into."""
    texts = {
        "kind": f"{row.spec.kind} {KIND_SHORT[row.spec.kind]}",
        "topic": f"{row.topic} {row.pattern}".rstrip(),  # as a filter's $ means the end of the name
        "robot": row.link,
        "state": f"{STATE_WORD[row.state]}{f' {ACK_WORD}' if row.acknowledged is not None else ''}",
        "via": via(row),
        "type": row.type_name,
        "why": row.reason,
    }
    if not isinstance(row, PatternRow):
        texts["via"] += f" {row.port or ''}"
        texts["why"] = f"{row.reason} {last_failure(row)}".rstrip()
    return texts


def _look(column: Column[Row], row: Row) -> str:
    if row.acknowledged is not None and not is_armed(row):  # an armed topic may move a robot, so it is not dimmed
        return "dim"
    if column in {STATE, SIGN}:
        return "armed" if is_armed(row) else row.state.value
    if column is HISTORY_COLUMN:
        return "plot" if row.state.flows else row.state.value
    return "dim" if row.state.is_wanted else ""
