"""The line of a dialog that names its keys."""

from __future__ import annotations

import re

from rich.cells import cell_len
from textual.widgets import Static

GAP = "   "
"""Between two keys."""
_ARROWS = re.compile("[←→↑↓]( ?[←→↑↓])*")


class KeyHints(Static):
    """Keys with what they do, which stay together where the line is broken."""

    def __init__(self, keys: str) -> None:
        super().__init__(classes="hint keys", markup=False)
        self._hints = keys

    def say(self, keys: str) -> None:
        """Name other keys."""
        self._hints = keys
        self.on_resize()

    def on_resize(self) -> None:
        lines = [""]
        for hint in spelled(self._hints, ascii_only=self.app.ascii_only).split(GAP):  # type: ignore[attr-defined]
            longer = f"{lines[-1]}{GAP}{hint}" if lines[-1] else hint
            if lines[-1] and cell_len(longer) > self.size.width:
                lines.append(hint)
            else:
                lines[-1] = longer
        if (text := "\n".join(lines)) != self.content:
            self.update(text)


def spelled(keys: str, *, ascii_only: bool) -> str:
    """Return a text about keys with words for keys whose signs would be those of other keys in ASCII: ``<``, ``v``."""
    return _ARROWS.sub("arrows", keys).replace("⏎", "enter") if ascii_only else keys
