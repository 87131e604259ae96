"""Lists whose cursor stays on its item while they are sorted, filtered and refreshed, and such lists with columns."""

from __future__ import annotations

import textwrap
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from textual.geometry import Region
from textual.message import Message

from rsb_console.actions.action import Group
from rsb_console.actions.all_actions import bindings
from rsb_console.terminal.input_queue import InputGate
from rsb_console.widgets.lines import LiveLines, clip, fit_middle

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from textual import events

    from rsb_console.widgets.lines import Line

R = TypeVar("R")


class SelectableList(LiveLines, can_focus=True):
    """A list of keyed items, one a line, below `sticky` lines of heading.

    `show_keys` sets the items; a subclass draws each in `line`.

    Attributes:
        slid_at: s, when another item slid below the cursor, or minus infinity.
    """

    BINDINGS = bindings(Group.MOVE)

    begins_at_top: ClassVar[bool] = False
    """Whether the first item is what matters, until the operator moves the cursor. Elsewhere a key that acts on an item
    must not meet the one that has just taken its place."""

    class CursorMoved(Message):
        """Another item is under the cursor."""

        def __init__(self, pane: SelectableList) -> None:
            super().__init__()
            self.pane = pane

        @property
        def control(self) -> SelectableList:
            return self.pane

    class Chosen(CursorMoved):
        """An item was clicked."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self.keys: Sequence[str] = ()
        self._cursor = 0
        self._moved = False
        self.slid_at = float("-inf")

    @property
    def follows_top(self) -> bool:
        """Whether the cursor stays on the first item, until the operator moves it."""
        return self.begins_at_top and not self._moved

    @property
    def line_count(self) -> int:
        return self.sticky + len(self.keys)

    def is_cursor(self, index: int) -> bool:
        return index == self.sticky + self._cursor

    @property
    def cursor_key(self) -> str | None:
        return self.keys[self._cursor] if self._cursor < len(self.keys) else None

    def show_keys(self, keys: Sequence[str]) -> None:
        """List `keys`. The cursor stays on its item, or at its position if the item is gone."""
        before, follows = self.cursor_key, self.follows_top
        self.keys = keys
        # First: Textual scrolls no further than the height that it knows.
        self.measure_lines()
        if follows:
            self._place(0)
        elif self.cursor_key != before:
            self._place(keys.index(before) if before in keys else min(self._cursor, max(0, len(keys) - 1)))
        self.sync()
        if self.cursor_key != before:
            if before is not None:
                self.slid_at = time.monotonic()
            self.post_message(self.CursorMoved(self))

    def is_seen(self) -> bool:
        """Whether a key can be for the item under the cursor, and not for one that was there a moment ago."""
        return InputGate.of(self.app).was_seen(self.slid_at)

    def hold(self) -> None:
        """Keep the cursor on its item from now on, as the operator has chosen it."""
        self._moved = True

    def move_to(self, position: int) -> None:
        """Put the cursor on item number `position`, or the nearest there is."""
        self.hold()
        position = max(0, min(len(self.keys) - 1, position))
        if position != self._cursor:
            self._place(position)
            self.sync()
            self.post_message(self.CursorMoved(self))

    def _place(self, position: int) -> None:
        self._cursor = position
        top, page = round(self.scroll_offset.y), self.page
        shown = max(position - page + 1, min(top, position))
        if shown != top:
            # Forced: Textual scrolls only a widget that shows a scrollbar, and shows it a refresh after it has grown.
            self.scroll_to(y=shown, animate=False, force=True)

    @property
    def position(self) -> int:
        return self._cursor

    @property
    def page(self) -> int:
        return max(1, self.size.height - self.sticky)

    def action_move_down(self) -> None:
        self.move_to(self._cursor + 1)

    def action_move_up(self) -> None:
        self.move_to(self._cursor - 1)

    def action_move_first(self) -> None:
        self.move_to(0)

    def action_move_last(self) -> None:
        self.move_to(len(self.keys) - 1)

    def action_page_down(self) -> None:
        self.move_to(self._cursor + self.page)

    def action_page_up(self) -> None:
        self.move_to(self._cursor - self.page)

    def on_click(self, event: events.Click) -> None:
        """Move the cursor to the item under the mouse; choose the item if the cursor is there already."""
        at = event.get_content_offset(self)
        if at is None:  # on the border
            return
        if at.y < self.sticky:
            self.heading_clicked(at.x)
            return
        position = self.index_at(at.y) - self.sticky
        if position == self._cursor:
            self.hold()
            self.post_message(self.Chosen(self))
        elif position < len(self.keys):
            self.move_to(position)

    def heading_clicked(self, x: int) -> None:
        """Handle a click on the heading, `x` cells from its left edge."""

    def on_focus(self) -> None:
        """Redraw the cursor's line, which looks different in the focused pane."""
        y = self.sticky + self._cursor - round(self.scroll_offset.y)
        self.refresh(Region(0, y, self.size.width, 1))

    on_blur = on_focus


# Compared by identity: by value, each look into a set of columns would hash all fields.
@dataclass(frozen=True, slots=True, eq=False)
class Column(Generic[R]):
    """One column of a table. Widths are in cells."""

    title: str
    width: int  # 0 for all remaining cells
    text: Callable[[R], str]
    order: Callable[[R], Any]
    right: bool = True  # aligned to the right
    from_width: int = 0  # a narrower table leaves the column out
    beside_calls: int | None = None  # the same for a table with calls, or None to use `from_width`
    only_calls: bool = False  # a table with only topics leaves it out
    names: bool = False  # names are cut in their middle
    least: int = 0  # to which it shrinks before names are cut, losing its beginning; 0 if it does not shrink

    def needs(self, *, calls: bool) -> int:
        """Return the least width of a table that has this column."""
        return self.from_width if self.beside_calls is None or not calls else self.beside_calls

    def fits(self, width: int, *, calls: bool) -> bool:
        """Whether a table of so many cells, which has more than topics or not, has this column."""
        return width >= self.needs(calls=calls) and (calls or not self.only_calls)

    def cell(self, row: R, width: int) -> str:
        """Return the text of a row in so many cells, and a blank behind it."""
        text = self.text(row)
        if len(text) > width:
            text = text[-width:] if self.least else fit_middle(text, width) if self.names else f"{text[: width - 1]}…"
        return self.aligned(text, width)

    def aligned(self, text: str, width: int) -> str:
        return f"{text:>{width}} " if self.right else f"{text:<{width}} "


Layout = tuple[tuple[Column[R], int], ...]
"""Columns, each with its width in cells."""


def filled(columns: Sequence[Column[R]], width: int, names: int = 0) -> Layout[R]:
    """Return columns with their widths in cells: one of width 0 gets the rest of `width`, a blank behind each.

    Other columns shrink for `names`, the cells of the longest name.
    """
    rest = max(8, width - sum(column.width + 1 for column in columns))
    shrinking = next((column for column in columns if column.least), None)
    if shrinking is None or rest >= names:
        return tuple((column, column.width or rest) for column in columns)
    less = max(shrinking.least, shrinking.width - (names - rest))
    rest += shrinking.width - less
    return tuple((column, less if column is shrinking else column.width or rest) for column in columns)


@dataclass
class Order(Generic[R]):
    """The operator's order of a table."""

    column: Column[R]
    reversed: bool = False


class SortedTable(SelectableList, Generic[R]):
    """A list with a heading of columns, one of which sorts it; or a text while it is empty.

    Attributes:
        EDGE: cells before the first column.
    """

    sticky = 1
    begins_at_top = True
    EDGE: ClassVar[int] = 1

    def __init__(self, order: Order[R], *, id: str, classes: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self.order = order
        self._empty: list[str] = []

    @property
    def columns(self) -> Layout[R]:
        """The columns that fit the present width."""
        raise NotImplementedError

    def relist(self) -> None:
        """List the rows again, in their order."""
        raise NotImplementedError

    def row_line(self, key: str, *, cursor: bool) -> Line:
        raise NotImplementedError

    def is_match(self, key: str) -> bool:
        """Whether a row of the list matches the filter; without one, whether it has a fault."""
        raise NotImplementedError

    @property
    def line_count(self) -> int:
        return self.sticky + (len(self.keys) or len(self._empty))

    def line(self, index: int) -> Line:
        if index == 0:
            return ((" " * self.EDGE, ""), *(self._heading(column, width) for column, width in self.columns))
        if not self.keys:
            return ((f"  {self._empty[index - 1]}", "dim"),)
        return self.row_line(self.keys[index - 1], cursor=self.is_cursor(index))

    def _heading(self, column: Column[R], width: int) -> tuple[str, str]:
        arrow = ("▲" if self.order.reversed else "▼") if column is self.order.column else ""
        return column.aligned(clip(column.title + arrow, width), width), "head"

    def is_cursor(self, index: int) -> bool:
        return bool(self.keys) and super().is_cursor(index)

    def explain(self, empty: str) -> None:
        """Set the text shown while the table is empty: why it is, and what to do."""
        lines = textwrap.wrap(empty, max(20, self.size.width - 4))
        if lines != self._empty:
            self._empty = lines
            self.sync()

    def sort_by(self, step: int) -> None:
        """Sort by the column `step` places to the right."""
        columns = [column for column, _ in self.columns]
        at = columns.index(self.order.column) if self.order.column in columns else 0
        self.order.column = columns[(at + step) % len(columns)]
        self.relist()

    def reverse(self) -> None:
        self.order.reversed = not self.order.reversed
        self.relist()

    def heading_clicked(self, x: int) -> None:
        """Sort by the column at `x`; if the table is sorted by it already, reverse the order."""
        edge = self.EDGE
        for column, width in self.columns:
            edge += width + 1
            if x < edge:
                self.order.reversed = column is self.order.column and not self.order.reversed
                self.order.column = column
                self.relist()
                return

    def next_match(self, step: int) -> None:
        """Move to the next match, or without a filter to the next fault."""
        count = len(self.keys)
        for distance in range(1, count + 1):
            position = (self.position + step * distance) % count
            if self.is_match(self.keys[position]):
                self.move_to(position)
                return
