"""Signs of states and directions, small charts, and the replacement of all of them on ASCII terminals.

Widgets always draw Unicode. On a terminal without it, `AsciiFilter` replaces each character by ASCII of the same width.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.segment import Segment
from textual.filter import LineFilter

from rsb_bridge.model.snapshot import State
from rsb_console.notation.ascii_signs import DOTS, to_ascii

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual.color import Color

STATE_SIGN = {
    State.OK: "●",
    State.PAUSED: "‖",
    State.DISARMED: "⊘",
    State.DISARMING: "⊖",
    State.RESTING: "◎",
    State.WAITING: "◌",
    State.UNHEARD: "◇",
    State.SLOW: "≈",
    State.LATE: "◔",
    State.STOPPED: "■",
    State.STALE: "▲",
    State.DOWN: "✗",
}
STATE_WORD = {state: state.upper() for state in State} | {State.OK: "ok", State.WAITING: "WAIT"}
ARMED, ARMED_WORD = "◆", "ARMED"
KNOWN, ACK_WORD = "a", "ack"
"""Mark of an acknowledged fault."""
OUT, IN = "→", "←"
DONE, FAILED, UNKNOWN, UNDER_WAY = "✓", "✗", "·", "▸"
BARS = " ▁▂▃▄▅▆▇"


def sparkline(values: Sequence[float], width: int, top: float = 0.0) -> str:
    """Draw the last `width` values as bars, right-aligned.

    Args:
        top: the value of the highest bar, unless one of `values` is larger.
    """
    shown = values[-width:]
    top = max(top, *shown, 0.0) if shown else 0.0
    bars = "".join(BARS[_level(value, top)] for value in shown)
    return bars.rjust(width)


def _level(value: float, top: float) -> int:
    if value <= 0 or top <= 0:
        return 0
    # At least the lowest bar: a little must not look like nothing.
    return max(1, round((len(BARS) - 1) * value / top))


def braille_plot(values: Sequence[float], width: int, height: int, top: float) -> list[str]:
    """Draw the last ``2 * width`` values as a curve, in `height` lines of `width` braille cells.

    Args:
        values: oldest first; the newest is drawn at the right edge.
        width: cells, two values each.
        height: lines, four levels each.
        top: the value at the upper edge.
    """
    cells = [[0] * width for _ in range(height)]
    shown = values[-2 * width :]
    highest = 4 * height - 1
    levels = [round(highest * min(1.0, value / top)) if top > 0 else 0 for value in shown]
    first = 2 * width - len(levels)
    for index, level in enumerate(levels):
        before = levels[index - 1] if index else level
        x = first + index
        # From the level before: a step is an edge, not two dots with a gap.
        for y in range(min(before, level), max(before, level) + 1):
            cells[height - 1 - y // 4][x // 2] |= DOTS[x % 2][y % 4]
    return ["".join(chr(0x2800 + dots) for dots in line) for line in cells]


class ControlFilter(LineFilter):
    """Removes control characters, which a peer or a file could put into a name or a reason; widths stay."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Replace characters that are not printable by blanks of the same width, which is mostly 0."""
        return [
            segment
            if segment.control or segment.text.isprintable()
            else Segment(_printable(segment.text), *segment[1:])
            for segment in segments
        ]


def _printable(text: str) -> str:
    return "".join(char if char.isprintable() else " " * cell_len(char) for char in text)


class AsciiFilter(LineFilter):
    """Replaces everything that is not ASCII, for terminals without Unicode."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Replace characters that are not ASCII by ASCII of the same width."""
        return [Segment(to_ascii(text, cell_len), style, control) for text, style, control in segments]
