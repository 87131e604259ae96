"""Views that draw lines of text: a message's fields, frames, diagnostics and the log."""

from __future__ import annotations

import struct
import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.feature_api import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, elements, number, text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Cells, Wish

_MOST_FRAMES, _MOST_STATUSES, _MOST_LOG_LINES = 1000, 2000, 2000
"""Frames, statuses, and lines of the log that are remembered: round figures."""
_ELEMENTS = 8
"""Elements of an array that are shown: a round figure."""
_FIELD_LINES = 2_000
"""A round figure: a message may have any number of fields, and each picture goes through all lines."""
_FRAME_OLD = 1.0
"""s without a new transform after which a frame is late: a round figure."""
_TIMES = 20
"""Newest times of a frame, for its rate, and parents and authors of it, that are remembered: a round figure."""
_DEEPEST = 30
"""Steps by which a frame is indented at most: 60 columns, which leave 20 of 80 to its name."""
_STATUS_OLD = 5.0
"""s after which a status is stale, as in rqt_robot_monitor."""
_VALUES = 20
"""Values of a status that are remembered. A round figure: a node may send any number."""
_STATUS_LEVELS = {0: ("ok", "ok"), 1: ("WARN", "warning"), 2: ("ERROR", "error"), 3: ("STALE", "warning")}
_MOST_PARTS = 8
"""Parts of a status's name that are groups: a round figure."""
_STATUS_ORDER = {2: 0, 1: 1, 3: 2, 0: 3}
"""Rank of each level: the worst comes first."""
_LOG_LENGTH = 1000
"""Characters of a line, and of a node's name, that are remembered: more than the widest picture shows."""
_LOG_LEVELS = {
    10: ("debug", "dim"),
    20: ("info", ""),
    30: ("WARN", "warning"),
    40: ("ERROR", "error"),
    50: ("FATAL", "error"),
}
"""rcl_interfaces/msg/Log."""
_Line = list[tuple[str, str]]
"""Parts of a line, each with its style."""


class FieldsView(View):
    """Draws the fields of the newest message, of any type, as a tree, in which changed values are marked."""

    def __init__(self) -> None:
        self._newest: dict[str, str] = {}
        self._shown: dict[str, str] = {}
        self._lines: list[tuple[str, str, str]] = []

    def receive(self, received: TakenMessage) -> None:
        self._lines = []
        for line in _field_tree(received.message, "", 0):
            self._lines.append(line)
            if len(self._lines) >= _FIELD_LINES:
                break
        self._newest = {path: value for _, value, path in self._lines}

    def draw(self, wish: Wish) -> Drawn:
        if not self._lines:
            return Drawn()
        lines = [line for line in self._lines if wish.match in line[2]]
        first = max(0, min(len(lines) - 1, int(-wish.y * wish.height)))
        shown: list[_Line] = []
        for label, value, path in lines[first : first + wish.height]:
            changed = bool(self._shown) and self._shown.get(path) != value
            shown.append([(label, "axis"), (value, "strong" if changed else "")])
        self._shown = self._newest
        if not shown:
            return Drawn(problem=f"no field contains {wish.match!r}")
        return Drawn(_cells(shown, wish.width, wish.height), (f"{len(lines)} fields",))


def _field_tree(value: Value, path: str, depth: int) -> Iterator[tuple[str, str, str]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _field_branch(name, inner, f"{path}.{name}" if path else name, depth)
    elif isinstance(value, Items):
        for at, inner in enumerate(value.shown[:_ELEMENTS]):
            yield from _field_branch(f"[{at}]", inner, f"{path}[{at}]", depth)
        if value.total > min(len(value.shown), _ELEMENTS):
            yield "  " * depth + "… ", f"{value.total - min(len(value.shown), _ELEMENTS):,} more", f"{path}[…]"


def _field_branch(name: str, value: Value, path: str, depth: int) -> Iterator[tuple[str, str, str]]:
    label = "  " * depth + name
    if isinstance(value, dict):
        yield f"{label}:", "", path
        yield from _field_tree(value, path, depth + 1)
    elif isinstance(value, Items) and value.raw is not None:
        yield f"{label}: ", _numbers(value), path
    elif isinstance(value, Items):
        yield f"{label}: ", f"{value.total:,} × {value.element}", path
        yield from _field_tree(value, path, depth + 1)
    else:
        yield f"{label}: ", _value_text(value), path


def _numbers(items: Items) -> str:
    assert items.raw is not None
    size = struct.calcsize(items.code)
    shown = min(items.total, _ELEMENTS)
    values = struct.unpack(f"{items.code[0]}{shown}{items.code[1:]}", items.raw[: shown * size])
    more = f", … {items.total:,} × {items.element}" if items.total > shown else ""
    return "[" + ", ".join(_value_text(each) for each in values) + more + "]"


def _value_text(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class TreeProblem(Wording):
    """Faults of frames."""

    TWO_PARENTS = "two parents: {parents}"
    TWO_AUTHORS = "published by two nodes: {authors}"
    AUTHOR = "by {author}"
    CIRCLE = "is its own ancestor"
    ROOTS = "the tree is in {count} parts, with the roots {roots}"


class _Frame:
    """One frame."""

    def __init__(self) -> None:
        self.parents: dict[str, float] = {}
        """Parents, with the time of their newest transform."""
        self.authors: dict[str, float] = {}
        """Nodes that publish it, with the time of their newest transform."""
        self.times: deque[float] = deque(maxlen=_TIMES)
        self.is_static = True


class TfTree(View):
    """Draws all frames of tf2_msgs/msg/TFMessage as a tree, with their ages, rates, and what is wrong."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}
        self._newest = 0.0
        self._too_many = False

    def receive(self, received: TakenMessage) -> None:
        self._newest = max(self._newest, received.time)
        static = received.topic.endswith("tf_static")
        for each in elements(received.message, "transforms"):
            # As tf2 does, since older nodes begin the names of frames with a /.
            child, parent = (text(each, name).removeprefix("/") for name in ("child_frame_id", "header.frame_id"))
            frame = self._frames.get(child)
            if frame is None:
                if len(self._frames) >= _MOST_FRAMES:
                    self._too_many = True
                    continue
                frame = self._frames[child] = _Frame()
            # A hostile node may give a frame any number of parents, each with a line of its own.
            if len(frame.parents) < _TIMES or parent in frame.parents:
                frame.parents[parent] = received.time
            if received.author and (len(frame.authors) < _TIMES or received.author in frame.authors):
                frame.authors[received.author] = received.time
            frame.times.append(received.time)
            frame.is_static = frame.is_static and static

    def draw(self, wish: Wish) -> Drawn:
        if not self._frames:
            return Drawn()
        children: dict[str, list[str]] = {}
        for name, frame in self._frames.items():
            for parent in frame.parents:
                children.setdefault(parent, []).append(name)
        roots = [parent for parent in children if parent not in self._frames]
        lines = [*self._lines(roots, children)]
        shown = {line[0][0].strip() for line in lines}
        circles = sorted(self._frames.keys() - shown)  # frames that are below no root
        lines += [[(name, "error"), (f"  {TreeProblem.CIRCLE()}", "error")] for name in circles]
        matching = [line for line in lines if wish.match in line[0][0]]
        if not matching:
            raise UndrawableError(f"no frame contains {wish.match!r}")
        first = max(0, min(len(matching) - 1, int(-wish.y * wish.height)))
        problem = f"more than {_MOST_FRAMES} frames: only the first ones are shown" if self._too_many else ""
        if len(roots) > 1:
            problem = problem or TreeProblem.ROOTS(count=len(roots), roots=", ".join(sorted(roots)[:8]))
        cells = _cells(matching[first : first + wish.height], wish.width, wish.height)
        return Drawn(cells, (f"{len(self._frames) + len(roots)} frames",), problem)

    def _lines(self, roots: Iterable[str], children: dict[str, list[str]]) -> Iterator[_Line]:
        """Yield the lines of frames and of all below them, which are drawn below one of their parents only."""
        drawn: set[str] = set()
        # Backwards, because the last one is drawn first.
        waiting = [(root, 0) for root in sorted(roots, reverse=True)]
        while waiting:
            name, depth = waiting.pop()
            yield [(f"{'  ' * min(depth, _DEEPEST)}{name}", ""), *self._state(name)]
            if name not in drawn:
                drawn.add(name)
                waiting += [(child, depth + 1) for child in sorted(children.get(name, ()), reverse=True)]

    def _state(self, name: str) -> _Line:
        now = max(self.now, self._newest)
        frame = self._frames.get(name)
        if frame is None:
            return []
        alive = [parent for parent, time in frame.parents.items() if frame.is_static or now - time < _FRAME_OLD]
        if len(alive) > 1:
            return [(f"  {TreeProblem.TWO_PARENTS(parents=', '.join(alive))}", "error"), *self._author(frame, now)]
        if frame.is_static:
            return [("  static", "dim"), *self._author(frame, now)]
        age = now - frame.times[-1]
        span = frame.times[-1] - frame.times[0]
        rate = f"  {(len(frame.times) - 1) / span:.3g} Hz" if span > 0 else ""
        late = (f"  {age:.1f} s old", "warning" if age > _FRAME_OLD else "dim")
        return [(rate, "dim"), late, *self._author(frame, now)]

    def _author(self, frame: _Frame, now: float) -> _Line:
        """Return the nodes that publish a frame now, or the last one that did."""
        if not frame.authors:
            return []
        alive = [author for author, time in frame.authors.items() if frame.is_static or now - time < _FRAME_OLD]
        if len(alive) > 1:
            return [(f"  {TreeProblem.TWO_AUTHORS(authors=', '.join(sorted(alive)))}", "warning")]
        newest = max(frame.authors, key=frame.authors.__getitem__)
        return [(f"  {TreeProblem.AUTHOR(author=newest)}", "dim")]


class _Status(NamedTuple):
    level: int
    message: str
    values: list[tuple[str, str]]
    time: float


class _Group:
    """Statuses below a part of their names, as diagnostic_aggregator groups them."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._inner: dict[str, _Group] = {}
        self._status: _Status | None = None
        self._level = 0
        """The worst level of it and all below."""

    def add(self, parts: list[str], status: _Status) -> None:
        """Add a status below the further parts of its name."""
        group = self
        for part in parts:
            group = group._inner.setdefault(part, _Group(part))
            group._level = min(group._level, status.level, key=_STATUS_ORDER.__getitem__)
        group._status = status

    def lines(self, opened: int, depth: int = 0) -> list[_Line]:
        """Return the lines of all below it, worst first.

        Args:
            opened: depth down to which groups without faults are opened, too.
        """
        lines: list[_Line] = []
        for inner in sorted(self._inner.values(), key=lambda each: (_STATUS_ORDER[each._level], each._name)):
            word, style = _STATUS_LEVELS[inner._level]
            is_open = bool(inner._inner) and (inner._level != 0 or opened > depth)
            sign = "" if not inner._inner else "▾ " if is_open else f"▸ {len(inner._inner)} in "
            status, indent = inner._status, "  " * depth
            message = "" if status is None else status.message
            name = f"{inner._name}  "
            lines.append([(f"{word:<6}", style), (f"{indent}{sign}", "axis"), (name, "strong"), (message, "")])
            # Those of a group repeat what is below it.
            if status is not None and status.level and not inner._inner:
                lines += [[(f"       {indent}{key}: ", "axis"), (value, "")] for key, value in status.values]
            if is_open:
                lines += inner.lines(opened, depth + 1)
        return lines


def _parts(name: str) -> list[str]:
    """Return the parts of an aggregated name (/Robot/Motors/left); of others, a / has no meaning."""
    if not name.startswith("/"):
        return [name]
    return name[1:].split("/", _MOST_PARTS - 1)


class DiagnosticsView(View):
    """Draws the newest status of each name of diagnostic_msgs as a tree, worst first, with the values of bad ones."""

    def __init__(self) -> None:
        self._statuses: dict[str, _Status] = {}
        self._newest = 0.0

    def receive(self, received: TakenMessage) -> None:
        self._newest = max(self._newest, received.time)
        message = received.message
        for each in elements(message, "status") if "status" in message else [message]:
            name = text(each, "name")
            if name in self._statuses or len(self._statuses) < _MOST_STATUSES:
                values = [(text(pair, "key"), text(pair, "value")) for pair in elements(each, "values")[:_VALUES]]
                self._statuses[name] = _Status(_status_level(each), text(each, "message"), values, received.time)

    def draw(self, wish: Wish) -> Drawn:
        now = {name: self._aged(status) for name, status in self._statuses.items()}
        counts = [sum(status.level == level for status in now.values()) for level in (2, 1, 3, 0)]
        root = _Group("")
        for name, status in now.items():
            if status.level >= wish.level and (wish.match in name or wish.match in status.message):
                root.add(_parts(name), status)
        lines, depth = root.lines(0), 1
        # Where there is room, groups without faults are opened, too: all of a depth or none.
        while depth < _MOST_PARTS and len(opened := root.lines(depth)) <= wish.height:
            lines, depth = opened, depth + 1
        first = max(0, min(len(lines) - 1, int(-wish.y * wish.height)))
        notes = ("{} errors, {} warnings, {} stale, {} ok".format(*counts),)
        cells = _cells(lines[first : first + wish.height] or [[("", "")]], wish.width, wish.height)
        return Drawn(cells, notes)

    def _aged(self, status: _Status) -> _Status:
        return status._replace(level=3) if max(self.now, self._newest) - status.time > _STATUS_OLD else status


def _status_level(status: Message) -> int:
    """Return a status's level; unknown levels count as errors."""
    value = number(status, "level")
    return int(value) if value in _STATUS_LEVELS else 2


class _LogLine(NamedTuple):
    time: float
    level: int
    node: str
    text: str


class LogView(View):
    """Draws the newest lines of ``/rosout``. The same line of a node, repeated, is drawn once with a count."""

    def __init__(self) -> None:
        self._lines: deque[tuple[_LogLine, int]] = deque(maxlen=_MOST_LOG_LINES)

    def receive(self, received: TakenMessage) -> None:
        message = received.message
        level = number(message, "level")
        line = _LogLine(
            received.time,
            int(level) if level in _LOG_LEVELS else 20,
            text(message, "name")[:_LOG_LENGTH],
            # Blanks instead of line breaks, which a row of cells cannot have.
            " ".join(text(message, "msg")[:_LOG_LENGTH].split()),
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
            word, style = _LOG_LEVELS[line.level]
            moment = time.strftime("%H:%M:%S", time.localtime(line.time))
            times = f"  ×{count}" if count > 1 else ""
            text_parts = (
                (f"{moment} ", "dim"),
                (f"{word:<6}", style),
                (f"{line.node}  ", "axis"),
                (line.text + times, ""),
            )
            lines.append([*text_parts])
        cells = _cells(lines or [[("", "")]], wish.width, wish.height)
        return Drawn(cells, (f"{len(shown)} lines",))


def _cells(lines: list[_Line], width: int, height: int) -> Cells:
    """Return text as a picture.

    Args:
        lines: lines of parts, each with its style; longer ones are cut off.
        height: cells; further lines are left out.
    """
    canvas = Canvas(width, max(1, min(height, len(lines))))
    for row, line in enumerate(lines[:height]):
        column = 0
        for part, style in line:
            canvas.write(column, row, part, style)
            column += len(part)
    return canvas.cells()
