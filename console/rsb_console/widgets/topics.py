"""The table of bridged topics, services, actions and nodes' parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_console.look.formats import KIND_SHORT, PatternRow, rows_of
from rsb_console.look.glyphs import ACK_WORD, STATE_WORD
from rsb_console.widgets.columns import HISTORY_COLUMN, SIGN, STATE, is_armed, last_failure, layout, via
from rsb_console.widgets.filter import table_title
from rsb_console.widgets.sorted_table import Order, SortedTable

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.look.formats import Row
    from rsb_console.widgets.filter import RowFilter
    from rsb_console.widgets.lines import Line
    from rsb_console.widgets.sorted_table import Column, Layout

FAULTS = tuple(state for state in State if state not in (State.PAUSED, State.DISARMED, State.DISARMING, State.OK))


class TopicsTable(SortedTable["Row"]):
    """Shows the routes of a snapshot, and the patterns that make some of them, one per line."""

    def __init__(self) -> None:
        super().__init__(Order(STATE), id="topics")
        self.rows: dict[str, Row] = {}
        self.faults_only = False
        self.grouped = False
        """Whether the topics of each robot stand together."""
        self.pattern: RowFilter | None = None
        self._peers = self._calls = False

    def show(self, snapshot: Snapshot) -> None:
        self.rows = {row.key: row for row in rows_of(snapshot)}
        self._peers = len(snapshot.links) > 1
        self._calls = any(row.spec.kind != "topic" for row in self.rows.values())
        self.relist()

    def relist(self) -> None:
        filtered = self.faults_only or self.pattern is not None
        shown = [row for row in self.rows.values() if not filtered or self._wanted(row)]
        shown.sort(key=self.order.column.order, reverse=self.order.reversed)
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
        edge = ("▌", row.state.value) if cursor else (" ", "")
        return (edge, *((column.cell(row, width), _look(column, row)) for column, width in self.columns))

    @property
    def columns(self) -> Layout[Row]:
        return layout(self.width, peers=self._peers, grouped=self.grouped, calls=self._calls)


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
    return "dim" if row.state in (State.PAUSED, State.DISARMED, State.DISARMING) else ""
