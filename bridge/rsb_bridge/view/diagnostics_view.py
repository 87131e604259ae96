"""Statuses of diagnostic_msgs, worst first, with the values of the bad ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.view.canvas import lines_to_cells
from rsb_bridge.view.drawing import Drawn, View, elements, number, text

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message
    from rsb_bridge.model.pictures import Wish
    from rsb_bridge.view.drawing import TakenMessage

STATUSES = 2000
"""Statuses that are remembered."""
_OLD = 5.0
"""s after which a status is stale, as in rqt_robot_monitor."""
_VALUES = 20
"""Values of a status that are remembered. A round figure: a node may send any number."""
_LEVELS = {0: ("ok", "ok"), 1: ("WARN", "warning"), 2: ("ERROR", "error"), 3: ("STALE", "warning")}
_ORDER = {2: 0, 1: 1, 3: 2, 0: 3}
"""Rank of each level: the worst comes first."""


class _Status(NamedTuple):
    level: int
    message: str
    values: list[tuple[str, str]]
    time: float


class DiagnosticsView(View):
    """Draws the newest status of each name."""

    def __init__(self) -> None:
        self._statuses: dict[str, _Status] = {}
        self._newest = 0.0

    def receive(self, received: TakenMessage) -> None:
        self._newest = max(self._newest, received.time)
        message = received.message
        for each in elements(message, "status") if "status" in message else [message]:
            name = text(each, "name")
            if name in self._statuses or len(self._statuses) < STATUSES:
                values = [(text(pair, "key"), text(pair, "value")) for pair in elements(each, "values")[:_VALUES]]
                self._statuses[name] = _Status(_level(each), text(each, "message"), values, received.time)

    def draw(self, wish: Wish) -> Drawn:
        now = {name: self._aged(status) for name, status in self._statuses.items()}
        counts = [sum(status.level == level for status in now.values()) for level in (2, 1, 3, 0)]
        shown = [
            (name, status)
            for name, status in sorted(now.items(), key=lambda each: (_ORDER[each[1].level], each[0]))
            if status.level >= wish.level and (wish.match in name or wish.match in status.message)
        ]
        lines = []
        for name, status in shown:
            word, style = _LEVELS[status.level]
            lines.append([(f"{word:<6}", style), (f"{name}  ", "strong"), (status.message, "")])
            if status.level:
                lines += [[(f"       {key}: ", "axis"), (value, "")] for key, value in status.values]
        first = max(0, min(len(lines) - 1, int(-wish.y * wish.height)))
        notes = ("{} errors, {} warnings, {} stale, {} ok".format(*counts),)
        cells = lines_to_cells(lines[first : first + wish.height] or [[("", "")]], wish.width, wish.height)
        return Drawn(cells, notes)

    def _aged(self, status: _Status) -> _Status:
        return status._replace(level=3) if max(self.now, self._newest) - status.time > _OLD else status


def _level(status: Message) -> int:
    """Return a status's level; unknown levels count as errors."""
    value = number(status, "level")
    return int(value) if value in _LEVELS else 2
