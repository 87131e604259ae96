"""The table of bridged topics."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.snapshot import State
from rsb_console.look import formats
from rsb_console.look.glyphs import IN, OUT, STATE_SIGN, STATE_WORD, sparkline
from rsb_console.widgets.lines import clip
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.widgets.lines import Line
    from rsb_console.widgets.pattern import Pattern

FAULTS = frozenset(State) - {State.PAUSED, State.OK}
WIDE = 70  # cells; a narrower table shows a state's sign without its word
HISTORY = 12  # s
TOTAL_FROM = 92  # cells from which on there is room for the bytes in all


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column of the table.

    Attributes:
        title: its heading.
        width: cells; 0: all that the other columns leave.
        text: a route's cell.
        order: sort key of a route.
        right: whether cells are aligned to the right.
        from_width: cells; in a narrower table the column is left out.
    """

    title: str
    width: int
    text: Callable[[RouteSnapshot], str]
    order: Callable[[RouteSnapshot], Any]
    right: bool = True
    from_width: int = 0


def _state(route: RouteSnapshot) -> str:
    return f"{STATE_SIGN[route.state]} {STATE_WORD[route.state]}"


def _via(route: RouteSnapshot) -> str:
    way = OUT if route.outgoing else IN
    return f"{way} BT {route.port}" if route.transport == "bluetooth" else f"{way} {route.transport.upper()}"


def _rate(route: RouteSnapshot) -> str:
    rate = formats.hertz(present_rate(route)) if carries(route) else "-"
    return rate if route.expected_rate is None else f"{rate}/{formats.expected(route.expected_rate)}"


def present_rate(route: RouteSnapshot) -> float:
    """A topic's rate in Hz. One that has stopped has 0: the measured mean still covers seconds in which it flowed."""
    return 0.0 if route.state in {State.STALE, State.STOPPED} else route.rate


def carries(route: RouteSnapshot) -> bool:
    """Whether a topic's rate and throughput have a meaning in its present state."""
    return route.state.flows or route.state in {State.STALE, State.STOPPED}


COLUMNS = (
    Column("STATE", 9, _state, lambda r: (r.state.rank, r.topic), right=False, from_width=WIDE),
    Column("", 2, lambda r: STATE_SIGN[r.state], lambda r: (r.state.rank, r.topic), right=False),
    Column("TOPIC", 0, lambda r: r.topic, lambda r: r.topic, right=False),
    Column("PEER", 10, lambda r: r.link, lambda r: (r.link, r.topic), right=False, from_width=100),
    Column("VIA", 7, _via, lambda r: (r.outgoing, r.transport, r.port), right=False, from_width=40),
    Column("HZ/EXP", 9, _rate, lambda r: -present_rate(r)),
    Column(
        "kB/s",
        6,
        lambda r: formats.kilobytes(r.bytes_per_second) if carries(r) else "-",
        lambda r: -r.bytes_per_second,
        from_width=56,
    ),
    Column("TOTAL", 8, lambda r: formats.byte_count(r.bytes_total), lambda r: -r.bytes_total, from_width=TOTAL_FROM),
    Column(
        "ms",
        5,
        lambda r: "-" if r.latency_p50 is None else formats.milliseconds(r.latency_p50),
        lambda r: -(r.latency_p50 or 0.0),
        from_width=64,
    ),
    Column("AGE", 5, lambda r: "-" if r.age is None else formats.age(r.age), lambda r: -(r.age or 0.0), from_width=48),
    Column(
        " HISTORY",
        HISTORY + 1,
        lambda r: sparkline(r.history, HISTORY, r.expected_rate or max(r.history, default=0)),
        lambda r: -sum(r.history),
        right=False,
        from_width=78,
    ),
)
STATE, SIGN, TOPIC, PEER, HISTORY_COLUMN = COLUMNS[0], COLUMNS[1], COLUMNS[2], COLUMNS[3], COLUMNS[-1]


@cache
def layout(width: int, *, peers: bool, grouped: bool = False) -> tuple[tuple[Column, int], ...]:
    """The columns that fit, each with its width in cells.

    Args:
        width: of the table, cells.
        peers: whether there are several peers, so that the table needs a column for them.
        grouped: whether that column comes first, however narrow the table is.
    """
    hidden = {SIGN if width >= WIDE else STATE} | (set() if peers and not grouped else {PEER})
    shown = [column for column in COLUMNS if width >= column.from_width and column not in hidden]
    if grouped:
        shown.insert(0, PEER)
        if width < TOTAL_FROM and shown[-1] is HISTORY_COLUMN:
            shown.pop()  # the names need its room
    rest = max(8, width - 1 - sum(column.width + 1 for column in shown))
    return tuple((column, column.width or rest) for column in shown)


class TopicsTable(SelectableList):
    """Shows the routes of a snapshot, one per line. The cursor stays on its route when the order changes."""

    sticky = 1

    def __init__(self) -> None:
        super().__init__(id="topics")
        self.routes: dict[str, RouteSnapshot] = {}
        self.sort_column = STATE
        self.reversed = False
        self.faults_only = False
        self.grouped = False
        """Whether the topics of each robot stand together."""
        self.pattern: Pattern | None = None
        self._peers = False
        self._empty: list[str] = []

    @property
    def line_count(self) -> int:
        """The heading and a line per route, or the lines that say why there is no route."""
        return self.sticky + (len(self.keys) or len(self._empty))

    def explain(self, empty: str) -> None:
        """Set the text shown while the table is empty: why it is, and what to do."""
        lines = textwrap.wrap(empty, max(20, self.size.width - 4))
        if lines != self._empty:
            self._empty = lines
            self.sync()

    def show(self, snapshot: Snapshot) -> None:
        self.routes = {route.key: route for route in snapshot.routes}
        self._peers = len(snapshot.links) > 1
        self.relist()

    def relist(self) -> None:
        shown = [route for route in self.routes.values() if self._wanted(route)]
        shown.sort(key=self.sort_column.order, reverse=self.reversed)
        if self.grouped:
            shown.sort(key=lambda route: route.link)
        self.show_keys([route.key for route in shown])

    def _wanted(self, route: RouteSnapshot) -> bool:
        if self.faults_only and route.state not in FAULTS:
            return False
        return self.pattern is None or self.pattern.matches(
            {
                "topic": route.topic,
                "robot": route.link,
                "state": STATE_WORD[route.state],
                "via": f"{_via(route)} {route.port}",
                "type": route.type_name,
                "why": route.reason,
            },
            hidden=() if self._peers else ("robot",),
        )

    def is_cursor(self, index: int) -> bool:
        """Whether the cursor is on a line; an empty table has none."""
        return bool(self.keys) and super().is_cursor(index)

    @property
    def selected(self) -> RouteSnapshot | None:
        return None if self.cursor_key is None else self.routes[self.cursor_key]

    @property
    def listed(self) -> list[RouteSnapshot]:
        """The routes shown, in the table's order."""
        return [self.routes[key] for key in self.keys]

    def sort_by(self, step: int) -> None:
        """Sort by the column `step` places to the right."""
        columns = [column for column, _ in self._layout]
        at = columns.index(self.sort_column) if self.sort_column in columns else 0
        self.sort_column = columns[(at + step) % len(columns)]
        self.relist()

    def reverse(self) -> None:
        self.reversed = not self.reversed
        self.relist()

    def next_match(self, step: int) -> None:
        """Move to the next match, or without a filter to the next fault. With a filter, every line is a match."""
        count = len(self.keys)
        for distance in range(1, count + 1):
            position = (self.position + step * distance) % count
            if self.pattern is not None or self.routes[self.keys[position]].state in FAULTS:
                self.move_to(position)
                return

    def line(self, index: int) -> Line:
        if index == 0:
            return ((" ", ""), *(self._heading(column, width) for column, width in self._layout))
        if not self.keys:
            return ((f"  {self._empty[index - 1]}", "dim"),)
        route = self.routes[self.keys[index - 1]]
        edge = ("▌", route.state.value) if self.is_cursor(index) else (" ", "")
        return (edge, *(_cell(column, route, width) for column, width in self._layout))

    @property
    def _layout(self) -> tuple[tuple[Column, int], ...]:
        return layout(self.width, peers=self._peers, grouped=self.grouped)

    def _heading(self, column: Column, width: int) -> tuple[str, str]:
        arrow = ("▲" if self.reversed else "▼") if column is self.sort_column else ""
        title = clip(column.title + arrow, width)
        return (f"{title:>{width}} " if column.right else f"{title:<{width}} "), "head"

    def heading_clicked(self, x: int) -> None:
        """Sort by the column at `x`; if the table is sorted by it already, reverse the order."""
        edge = 1
        for column, width in self._layout:
            edge += width + 1
            if x < edge:
                self.reversed = column is self.sort_column and not self.reversed
                self.sort_column = column
                self.relist()
                return


def _cell(column: Column, route: RouteSnapshot, width: int) -> tuple[str, str]:
    text = column.text(route)
    if len(text) > width:
        text = text[: width - 1] + "…"
    look = ""
    if column in {STATE, SIGN}:
        look = route.state.value
    elif column is HISTORY_COLUMN:
        look = "plot" if route.state.flows else route.state.value
    elif route.state is State.PAUSED:
        look = "dim"
    return (f"{text:>{width}} " if column.right else f"{text:<{width}} "), look
