"""Lines of rcl_interfaces/msg/Log (``/rosout``), the newest last."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.view.canvas import lines_to_cells
from rsb_bridge.view.drawing import Drawn, View, number, text

if TYPE_CHECKING:
    from rsb_bridge.model.pictures import Wish
    from rsb_bridge.view.drawing import TakenMessage

LINES = 2000
"""Lines that are remembered."""
_LENGTH = 1000
"""Characters of a line, and of a node's name, that are remembered: more than the widest picture shows."""
_LEVELS = {
    10: ("debug", "dim"),
    20: ("info", ""),
    30: ("WARN", "warning"),
    40: ("ERROR", "error"),
    50: ("FATAL", "error"),
}
"""rcl_interfaces/msg/Log."""


class _Line(NamedTuple):
    time: float
    level: int
    node: str
    text: str


class LogView(View):
    """Draws the newest lines. The same line of a node, repeated, is drawn once with a count."""

    def __init__(self) -> None:
        self._lines: deque[tuple[_Line, int]] = deque(maxlen=LINES)

    def receive(self, received: TakenMessage) -> None:
        message = received.message
        level = number(message, "level")
        line = _Line(
            received.time,
            int(level) if level in _LEVELS else 20,
            text(message, "name")[:_LENGTH],
            # Blanks instead of line breaks, which a row of cells cannot have.
            " ".join(text(message, "msg")[:_LENGTH].split()),
        )
        if self._lines and self._lines[-1][0][1:] == line[1:]:
            self._lines[-1] = line, self._lines[-1][1] + 1
        else:
            self._lines.append((line, 1))

    def draw(self, wish: Wish) -> Drawn:
        shown = [
            (line, count)
            for line, count in self._lines
            if line.level >= wish.level and (wish.match in line.node or wish.match in line.text)
        ]
        last = len(shown) - max(0, min(len(shown) - 1, int(wish.y * wish.height)))
        lines = []
        for line, count in shown[max(0, last - wish.height) : last]:
            word, style = _LEVELS[line.level]
            moment = time.strftime("%H:%M:%S", time.localtime(line.time))
            times = f"  ×{count}" if count > 1 else ""
            text_parts = (
                (f"{moment} ", "dim"),
                (f"{word:<6}", style),
                (f"{line.node}  ", "axis"),
                (line.text + times, ""),
            )
            lines.append([*text_parts])
        cells = lines_to_cells(lines or [[("", "")]], wish.width, wish.height)
        return Drawn(cells, (f"{len(shown)} lines",))
