"""Choosing the columns of the topics."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen

from rsb_console.actions.all_actions import BY_ID
from rsb_console.preferences import TOPIC_COLUMNS
from rsb_console.screens.dialog import Dialog
from rsb_console.widgets.lines import fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen
    from rsb_console.widgets.lines import Line
    from rsb_console.widgets.topics import TopicsTable


class ColumnsList(SelectableList):
    """The columns of a table that an operator may choose, with a mark on each chosen one."""

    def __init__(self, topics: TopicsTable) -> None:
        super().__init__(id="columns")
        self._topics = topics
        self.keys = list(TOPIC_COLUMNS)

    def on_mount(self) -> None:
        self.styles.height = self.line_count
        self.sync()

    @property
    def chosen(self) -> frozenset[str]:
        wanted = self._topics.wanted_columns
        return frozenset(self.keys) if wanted is None else wanted

    def line(self, index: int) -> Line:
        title = self.keys[index]
        wanted = title in self.chosen
        why = self._topics.why_not_shown(title) if wanted else ""
        pieces = (
            ("▌" if self.is_cursor(index) else " ", "key"),
            (f"{'✓' if wanted else ' '} ", "ok"),
            (f"{title:<13}", "strong" if wanted else ""),
            (TOPIC_COLUMNS[title], "" if wanted else "dim"),
            (f": {why}" if why else "", "dim"),
        )
        return fit(pieces, self.size.width)


class ColumnsScreen(ModalScreen[None]):
    """The columns of the topics; each choice is shown at once, and kept for the next start."""

    BINDINGS: ClassVar = [
        Binding(f"escape,q,{BY_ID['columns'].keys}", "dismiss", show=False),
        Binding("space,enter", "choose", show=False),
    ]

    def __init__(self, console: Console, topics: TopicsTable) -> None:
        super().__init__()
        self.console, self._topics = console, topics
        self._list = ColumnsList(topics)

    def compose(self) -> ComposeResult:
        yield Dialog("Columns", self._list, keys="space show or hide   esc close", shape="")

    def action_choose(self) -> None:
        """Show the column under the cursor, or hide it."""
        self._topics.wanted_columns = chosen = self._list.chosen ^ {self._list.keys[self._list.position]}
        self._topics.relist()
        self._list.sync()
        self.console.remember("columns", [title for title in TOPIC_COLUMNS if title in chosen])

    def on_selectable_list_chosen(self) -> None:
        self.action_choose()


def show_columns(screen: MainScreen) -> None:
    screen.app.push_screen(ColumnsScreen(screen.console, screen.topics))
