"""The fields of any message as a tree, in which the values that changed since the last picture are marked."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.view.canvas import lines_to_cells
from rsb_bridge.view.drawing import Drawn, View

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.decoder import Value
    from rsb_bridge.model.pictures import Wish
    from rsb_bridge.view.drawing import TakenMessage

_SHOWN = 8
"""Elements of an array."""
_LINES = 2_000
"""A round figure: a message may have any number of fields, and each picture goes through all lines."""


class FieldsView(View):
    """Draws the newest message as a tree."""

    def __init__(self) -> None:
        self._newest: dict[str, str] = {}
        self._shown: dict[str, str] = {}
        self._lines: list[tuple[str, str, str]] = []

    def receive(self, received: TakenMessage) -> None:
        self._lines = []
        for line in _tree(received.message, "", 0):
            self._lines.append(line)
            if len(self._lines) >= _LINES:
                break
        self._newest = {path: value for _, value, path in self._lines}

    def draw(self, wish: Wish) -> Drawn:
        if not self._lines:
            return Drawn()
        lines = [line for line in self._lines if wish.match in line[2]]
        first = max(0, min(len(lines) - 1, int(-wish.y * wish.height)))
        shown: list[list[tuple[str, str]]] = []
        for label, value, path in lines[first : first + wish.height]:
            changed = bool(self._shown) and self._shown.get(path) != value
            shown.append([(label, "axis"), (value, "strong" if changed else "")])
        self._shown = self._newest
        if not shown:
            return Drawn(problem=f"no field contains {wish.match!r}")
        return Drawn(lines_to_cells(shown, wish.width, wish.height), (f"{len(lines)} fields",))


def _tree(value: Value, path: str, depth: int) -> Iterator[tuple[str, str, str]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _branch(name, inner, f"{path}.{name}" if path else name, depth)
    elif isinstance(value, Items):
        for at, inner in enumerate(value.shown[:_SHOWN]):
            yield from _branch(f"[{at}]", inner, f"{path}[{at}]", depth)
        if value.total > min(len(value.shown), _SHOWN):
            yield "  " * depth + "… ", f"{value.total - min(len(value.shown), _SHOWN):,} more", f"{path}[…]"


def _branch(name: str, value: Value, path: str, depth: int) -> Iterator[tuple[str, str, str]]:
    label = "  " * depth + name
    if isinstance(value, dict):
        yield f"{label}:", "", path
        yield from _tree(value, path, depth + 1)
    elif isinstance(value, Items) and value.raw is not None:
        yield f"{label}: ", _numbers(value), path
    elif isinstance(value, Items):
        yield f"{label}: ", f"{value.total:,} × {value.element}", path
        yield from _tree(value, path, depth + 1)
    else:
        yield f"{label}: ", _text(value), path


def _numbers(items: Items) -> str:
    assert items.raw is not None
    size = struct.calcsize(items.code)
    shown = min(items.total, _SHOWN)
    values = struct.unpack(f"{items.code[0]}{shown}{items.code[1:]}", items.raw[: shown * size])
    more = f", … {items.total:,} × {items.element}" if items.total > shown else ""
    return "[" + ", ".join(_text(each) for each in values) + more + "]"


def _text(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
