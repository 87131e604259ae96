"""The table of bridged topics, services, actions and nodes' parameters."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_console.look.formats import KIND_SHORT, PatternRow, rows_of
from rsb_console.look.glyphs import ACK_WORD, STATE_WORD
from rsb_console.widgets.columns import HISTORY_COLUMN, SIGN, STATE, TOPIC, is_armed, last_failure, layout, via
from rsb_console.widgets.filter import table_title
from rsb_console.widgets.lines import clip, fit_middle
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.look.formats import Row
    from rsb_console.widgets.columns import Column
    from rsb_console.widgets.filter import RowFilter
    from rsb_console.widgets.lines import Line

FAULTS = tuple(state for state in State if state not in (State.PAUSED, State.DISARMED, State.DISARMING, State.OK))


class TopicsTable(SelectableList):
    """Shows the routes of a snapshot, and the patterns that make some of them, one per line.

    The cursor stays on its route when the order changes.
    """

    sticky = 1
    begins_at_top = True

    def __init__(self) -> None:
        super().__init__(id="topics")
        self.rows: dict[str, Row] = {}
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

    def explain(self, empty: str) -> None:
        """Set the text shown while the table is empty: why it is, and what to do."""
        lines = textwrap.wrap(empty, max(20, self.size.width - 4))
        if lines != self._empty:
            self._empty = lines
            self.sync()

    def show(self, snapshot: Snapshot) -> None:
        self.rows = {row.key: row for row in rows_of(snapshot)}
        self._peers = len(snapshot.links) > 1
        self._calls = any(row.spec.kind != "topic" for row in self.rows.values())
        self.relist()

    def relist(self) -> None:
        filtered = self.faults_only or self.pattern is not None
        shown = [row for row in self.rows.values() if not filtered or self._wanted(row)]
        shown.sort(key=self.sort_column.order, reverse=self.reversed)
        if self.grouped:
            # Sorting is stable: within a robot, the chosen order stays.
            shown.sort(key=lambda row: row.link)
        self.show_keys([row.key for row in shown])
        self._show_title()

    def _show_title(self) -> None:
        name = f"{'Topics and calls' if self._calls else 'Topics'}{' by robot' if self.grouped else ''}"
        shown, rows = len(self.keys), len(self.rows)
        parts = table_title(name, self.pattern, faults_only=self.faults_only, shown=shown, rows=rows)
        self.entitle(f" {' ▸ '.join(parts)} ")

    def _wanted(self, row: Row) -> bool:
        if self.faults_only and row.state not in FAULTS:
            return False
        # A word such as "topic" or the only peer's name would match every line.
        hidden = ("kind",) if self._peers else ("kind", "robot")
        return self.pattern is None or self.pattern.matches(_searched(row), hidden=hidden)

    def is_cursor(self, index: int) -> bool:
        """Whether the cursor is on a line; an empty table has none."""
        return bool(self.keys) and super().is_cursor(index)

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
            row = self.rows[self.keys[position]]
            if self.pattern is not None or (row.state in FAULTS and row.acknowledged is None):
                self.move_to(position)
                return

    def line(self, index: int) -> Line:
        if index == 0:
            return ((" ", ""), *(self._heading(column, width) for column, width in self._layout))
        if not self.keys:
            return ((f"  {self._empty[index - 1]}", "dim"),)
        row = self.rows[self.keys[index - 1]]
        edge = ("▌", row.state.value) if self.is_cursor(index) else (" ", "")
        return (edge, *(_cell(column, row, width) for column, width in self._layout))

    @property
    def _layout(self) -> tuple[tuple[Column[Row], int], ...]:
        return layout(self.width, peers=self._peers, grouped=self.grouped, calls=self._calls)

    def _heading(self, column: Column[Row], width: int) -> tuple[str, str]:
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


def _cell(column: Column[Row], row: Row, width: int) -> tuple[str, str]:
    text = column.text(row)
    if len(text) > width:
        text = fit_middle(text, width) if column is TOPIC else text[: width - 1] + "…"
    look = ""
    if row.acknowledged is not None and not is_armed(row):  # an armed topic may move a robot, so it is not dimmed
        look = "dim"
    elif column in {STATE, SIGN}:
        look = "armed" if is_armed(row) else row.state.value
    elif column is HISTORY_COLUMN:
        look = "plot" if row.state.flows else row.state.value
    elif row.state in (State.PAUSED, State.DISARMED, State.DISARMING):
        look = "dim"
    return (f"{text:>{width}} " if column.right else f"{text:<{width}} "), look
