"""A picture of characters: text, and dots in braille patterns (Unicode block 2800), eight to a cell."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rsb_bridge.model.pictures import Cells
from rsb_bridge.model.text import sanitize_text, single_cells

if TYPE_CHECKING:
    from rsb_bridge.model.pictures import Scale

DOTS_ACROSS, DOTS_DOWN = 2, 4
"""Dots of a cell."""
DOT_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bit of each dot in a braille pattern, by row and column."""
_BRAILLE = 0x2800
_STYLES = 256
"""A cell's style is a byte."""
LINE_DOTS = 500_000
"""Dots of all lines; of further lines, only the ends are drawn."""


class Canvas:
    """Cells that are drawn on.

    Attributes:
        width: cells.
        height: cells.
        dots: the braille pattern of each cell, row by row; a view may write it directly.
        styles: the index of each cell's style, row by row (`style`).
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.dots = bytearray(width * height)
        self.styles = bytearray(width * height)
        self._line_dots = LINE_DOTS
        self._characters: dict[int, str] = {}
        self._palette: dict[str, int] = {"": 0}

    def style(self, name: str) -> int:
        """Return the index of a style of `rsb_bridge.model.pictures.STYLES`, or of a colour ``#rrggbb``."""
        return self._palette.setdefault(name, min(len(self._palette), _STYLES - 1))

    def dot(self, x: int, y: int, style: str = "") -> None:
        """Set a dot, counted from the upper left, if it is on the canvas."""
        column, across = divmod(x, DOTS_ACROSS)
        row, down = divmod(y, DOTS_DOWN)
        if 0 <= column < self.width and 0 <= row < self.height:
            cell = row * self.width + column
            self.dots[cell] |= DOT_BITS[down][across]
            self.styles[cell] = self.style(style)

    def is_free(self, x: int, y: int) -> bool:
        """Whether the cell of a dot is on the canvas and empty, or has only dim dots."""
        column, row = x // DOTS_ACROSS, y // DOTS_DOWN
        if not (0 <= column < self.width and 0 <= row < self.height):
            return False
        cell = row * self.width + column
        return not self.dots[cell] or self.styles[cell] == self._palette.get("dim")

    def line(self, x0: int, y0: int, x1: int, y1: int, style: str = "") -> None:
        """Set the dots between two points, both included; points far outside are cut off."""
        # Otherwise one far point would use up the dots of all lines.
        limit = 4 * max(self.width * DOTS_ACROSS, self.height * DOTS_DOWN)
        x0, y0, x1, y1 = (max(-limit, min(limit, each)) for each in (x0, y0, x1, y1))
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        self._line_dots -= steps
        # A path to and fro over the canvas, of thousands of poses, must be drawn in bounded time.
        if self._line_dots < 0:
            steps = 1
        for step in range(steps + 1):
            self.dot(round(x0 + (x1 - x0) * step / steps), round(y0 + (y1 - y0) * step / steps), style)

    def write(self, column: int, row: int, text: str, style: str = "") -> None:
        """Write text over the dots, as much as fits. Characters that do not take one cell become U+FFFD."""
        if not 0 <= row < self.height:
            return
        for at, character in enumerate(single_cells(sanitize_text(text)), column):
            if 0 <= at < self.width:
                cell = row * self.width + at
                self._characters[cell] = character
                self.styles[cell] = self.style(style)

    def scale_bar(self, column: float) -> None:
        """Draw a bar with its length at the lower left, for so many metres a column."""
        rough = column * self.width / 5
        power = 10 ** math.floor(math.log10(rough))
        length = next(each * power for each in (1, 2, 5, 10) if each * power >= rough)
        self.write(1, self.height - 1, f"├{'─' * max(0, round(length / column) - 1)}┤ {length:g} m", "axis")

    def cells(self, scale: Scale | None = None) -> Cells:
        """Return the picture."""
        characters = [chr(_BRAILLE + pattern) if pattern else " " for pattern in self.dots]
        for cell, character in self._characters.items():
            characters[cell] = character
        rows = ("".join(characters[row * self.width : (row + 1) * self.width]) for row in range(self.height))
        return Cells(tuple(rows), bytes(self.styles), tuple(self._palette), scale)
