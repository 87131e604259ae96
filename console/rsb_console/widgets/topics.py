"""The table of bridged topics, services, actions and nodes' parameters."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_console.look.formats import KIND_SHORT, pattern_rows
from rsb_console.look.glyphs import ACK_WORD, STATE_WORD
from rsb_console.widgets.columns import HISTORY_COLUMN, SIGN, STATE, TOPIC, is_armed, layout, via
from rsb_console.widgets.lines import clip, fit_middle
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.widgets.columns import Column
    from rsb_console.widgets.filter import RowFilter
    from rsb_console.widgets.lines import Line

FAULTS = tuple(state for state in State if state not in (State.PAUSED, State.DISARMED, State.DISARMING, State.OK))


class TopicsTable(SelectableList):
    """Shows the routes of a snapshot, one per line, and the patterns that make some of them.

    The cursor stays on its route when the order changes.
    """

    sticky = 1
    begins_at_top = True

    def __init__(self) -> None:
        super().__init__(id="topics")
        self.routes: dict[str, RouteSnapshot] = {}
        self.sort_column = STATE
        self.reversed = False
        self.faults_only = False
        self.grouped = False
        """Whether the topics of each robot stand together."""
        self.pattern: RowFilter | None = None
        self._peers = self._calls = False
        self._empty: list[str] = []

    @property
    def line_count(self) -> int:
        """Number of lines: the heading and a line for each route, or a text for an empty table."""
        return self.sticky + (len(self.keys) or len(self._empty))

    @property
    def subject(self) -> str:
        """The name of the contents, for a title."""
        return "Topics and calls" if self._calls else "Topics"

    def explain(self, empty: str) -> None:
        """Set the text shown while the table is empty: why it is, and what to do."""
        lines = textwrap.wrap(empty, max(20, self.size.width - 4))
        if lines != self._empty:
            self._empty = lines
            self.sync()

    def show(self, snapshot: Snapshot) -> None:
        self.routes = {route.key: route for route in (*snapshot.routes, *pattern_rows(snapshot))}
        self._peers = len(snapshot.links) > 1
        self._calls = any(route.spec.kind != "topic" for route in self.routes.values())
        self.relist()

    def relist(self) -> None:
        filtered = self.faults_only or self.pattern is not None
        shown = [route for route in self.routes.values() if not filtered or self._wanted(route)]
        shown.sort(key=self.sort_column.order, reverse=self.reversed)
        if self.grouped:
            shown.sort(key=lambda route: route.link)
        self.show_keys([route.key for route in shown])

    def _wanted(self, route: RouteSnapshot) -> bool:
        if self.faults_only and route.state not in FAULTS:
            return False
        return self.pattern is None or self.pattern.matches(
            {
                "kind": f"{route.spec.kind} {KIND_SHORT[route.spec.kind]}",
                "topic": f"{route.topic} {route.pattern}" if route.pattern else route.topic,
                "robot": route.link,
                "state": f"{STATE_WORD[route.state]}{f' {ACK_WORD}' if route.acknowledged is not None else ''}",
                "via": f"{via(route)} {route.port or ''}",
                "type": route.type_name,
                "why": route.reason if route.calls is None else f"{route.reason} {route.calls.last_failure}",
            },
            hidden=("kind",) if self._peers else ("kind", "robot"),
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
            route = self.routes[self.keys[position]]
            if self.pattern is not None or (route.state in FAULTS and route.acknowledged is None):
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
    def _layout(self) -> tuple[tuple[Column[RouteSnapshot], int], ...]:
        return layout(self.width, peers=self._peers, grouped=self.grouped, calls=self._calls)

    def _heading(self, column: Column[RouteSnapshot], width: int) -> tuple[str, str]:
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


def _cell(column: Column[RouteSnapshot], route: RouteSnapshot, width: int) -> tuple[str, str]:
    text = column.text(route)
    if len(text) > width:
        text = fit_middle(text, width) if column is TOPIC else text[: width - 1] + "…"
    look = ""
    if route.acknowledged is not None and not is_armed(route):
        look = "dim"
    elif column in {STATE, SIGN}:
        look = "armed" if is_armed(route) else route.state.value
    elif column is HISTORY_COLUMN:
        look = "plot" if route.state.flows else route.state.value
    elif route.state in (State.PAUSED, State.DISARMED, State.DISARMING):
        look = "dim"
    return (f"{text:>{width}} " if column.right else f"{text:<{width}} "), look
