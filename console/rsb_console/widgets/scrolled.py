"""Lines that are read, and scrolled with a list's keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding

from rsb_console.widgets.lines import Line, LiveLines, fit

if TYPE_CHECKING:
    from collections.abc import Iterable


class ScrolledLines(LiveLines, can_focus=True):
    """Some lines that are replaced as a whole."""

    BINDINGS: ClassVar = [
        Binding("j", "scroll_down", show=False),
        Binding("k", "scroll_up", show=False),
        Binding("g", "scroll_home", show=False),
        Binding("G", "scroll_end", show=False),
    ]

    def __init__(self, *, id: str, classes: str = "") -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self._lines: list[Line] = []

    @property
    def line_count(self) -> int:
        """As many as there are."""
        return len(self._lines)

    def line(self, index: int) -> Line:
        return self._lines[index]

    def show(self, lines: Iterable[Line]) -> None:
        """Show other lines in place of the present ones."""
        width = self.scrollable_content_region.width
        self._lines = [fit(line, width) for line in lines]
        self.sync()
