"""Lists of rows in columns that are as wide as their texts."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Generic, Protocol, TypeVar

from rich.cells import cell_len

from rsb_console.widgets.lines import fit, fit_middle
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_console.widgets.lines import Line


class CellRow(Protocol):
    """A row of a `CellTable`."""

    @property
    def key(self) -> str: ...


R = TypeVar("R", bound=CellRow)
_GAP, _LEAST = 2, 8  # cells


class CellTable(SelectableList, Generic[R]):
    """Rows in columns below headings. Without room for all, the widest column gives way, in the middle of its texts.

    Attributes:
        WHOLE: headings of columns of which a part means nothing: they give way once the others have `_LEAST` cells.
    """

    HEADINGS: ClassVar[tuple[str, ...]]
    WHOLE: ClassVar[frozenset[str]] = frozenset()
    sticky = 1

    def __init__(self, *, id: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id)
        self._rows: dict[str, R] = {}
        self._widths: list[int] = [*map(len, self.HEADINGS)]

    def cells(self, row: R) -> tuple[tuple[str, str], ...]:
        """Return the text and the look of each cell."""
        raise NotImplementedError

    def show(self, rows: Sequence[R]) -> None:
        self._rows = {row.key: row for row in rows}
        columns = zip(self.HEADINGS, *([text for text, _ in self.cells(row)] for row in rows), strict=True)
        self._widths = [max(map(cell_len, column)) for column in columns]
        self.show_keys(list(self._rows))

    @property
    def selected(self) -> R | None:
        return None if self.cursor_key is None else self._rows.get(self.cursor_key)

    def line(self, index: int) -> Line:
        if index < self.sticky:
            return self._laid_out(" ", [(heading, "head") for heading in self.HEADINGS])
        row = self._rows[self.keys[index - self.sticky]]
        return self._laid_out("▌" if self.is_cursor(index) else " ", self.cells(row))

    def _laid_out(self, mark: str, cells: Sequence[tuple[str, str]]) -> Line:
        widths = list(self._widths)
        for _ in range(len(mark) + sum(widths) + _GAP * (len(widths) - 1) - self.width):
            widest = max(range(len(widths)), key=lambda each: (self._gives_way(each, widths[each]), widths[each]))
            widths[widest] -= 1
        *padded, (last, look) = [
            (f"{fitted}{' ' * (width + _GAP - cell_len(fitted))}", look)
            for (text, look), width in zip(cells, widths, strict=True)
            for fitted in (fit_middle(text, width),)
        ]
        return fit(((mark, "key"), *padded, (last.rstrip(), look)), self.width)

    def _gives_way(self, column: int, width: int) -> bool:
        return width > _LEAST and self.HEADINGS[column] not in self.WHOLE
