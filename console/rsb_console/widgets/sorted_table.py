"""A table of rows in columns, sorted by one of them, with a text while it is empty."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from rsb_console.widgets.lines import clip, fit_middle
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_console.widgets.lines import Line

R = TypeVar("R")


# Compared by identity: by value, each look into a set of columns would hash all fields.
@dataclass(frozen=True, slots=True, eq=False)
class Column(Generic[R]):
    """One column of a table.

    Attributes:
        width: cells, or 0 for all remaining ones.
        text: formats the cell of a route or another row.
        right: whether cells are aligned to the right.
        from_width: cells; a narrower table leaves the column out.
        beside_calls: the same for a table with calls, or None to use `from_width`.
        only_calls: whether a table with only topics leaves it out.
        names: whether it has names, which are cut in their middle.
    """

    title: str
    width: int
    text: Callable[[R], str]
    order: Callable[[R], Any]
    right: bool = True
    from_width: int = 0
    beside_calls: int | None = None
    only_calls: bool = False
    names: bool = False

    def fits(self, width: int, *, calls: bool) -> bool:
        """Whether a table of so many cells, which has more than topics or not, has this column."""
        if not calls:
            return width >= self.from_width and not self.only_calls
        return width >= (self.from_width if self.beside_calls is None else self.beside_calls)

    def cell(self, row: R, width: int) -> str:
        """Return the text of a row in so many cells, and a blank behind it."""
        text = self.text(row)
        if len(text) > width:
            text = fit_middle(text, width) if self.names else f"{text[: width - 1]}…"
        return self.aligned(text, width)

    def aligned(self, text: str, width: int) -> str:
        return f"{text:>{width}} " if self.right else f"{text:<{width}} "


Layout = tuple[tuple[Column[R], int], ...]
"""Columns, each with its width in cells."""


def filled(columns: Sequence[Column[R]], width: int) -> Layout[R]:
    """Columns with their widths in cells: one of width 0 gets what the others leave of `width`, a blank behind each."""
    rest = max(8, width - sum(column.width + 1 for column in columns))
    return tuple((column, column.width or rest) for column in columns)


@dataclass
class Order(Generic[R]):
    """The operator's order of a table."""

    column: Column[R]
    reversed: bool = False


class SortedTable(SelectableList, Generic[R]):
    """A heading, and a line for each row; or a text while it is empty.

    The cursor stays on its row when the order changes.

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
        """The columns that fit the present width, each with its own in cells."""
        raise NotImplementedError

    def relist(self) -> None:
        """List the rows again, in their order."""
        raise NotImplementedError

    def row_line(self, key: str, *, cursor: bool) -> Line:
        """Line of the row with a key."""
        raise NotImplementedError

    def is_match(self, key: str) -> bool:
        """Whether a row of the list matches the filter; without one, whether it has a fault."""
        raise NotImplementedError

    @property
    def line_count(self) -> int:
        """Number of lines: the heading and the rows, or a text for an empty table."""
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
        """Whether the cursor is on a line; an empty table has none."""
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
