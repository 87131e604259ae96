"""Markers of visualization_msgs on a map: points, lines, arrows, outlines and texts."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rsb_extras.pictures.drawing import Canvas, elements, number, text
from rsb_extras.pictures.points import put_dots
from rsb_extras.pictures.transforms import Transform, coordinate, pose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.transforms import Floats, FrameTree

MOST_MARKERS = 2_000
"""Markers that are remembered, of all topics: a round figure, as the next ones."""
MOST_POINTS = 5_000
"""Points of a marker that are drawn; of the further ones, none is."""
_MOST_TEXTS = 200
"""Texts that are drawn in one picture."""
_SHADES = 3
"""Steps of red, green and blue: markers may have any number of colours, and a picture has 256 styles."""
_ARROW, _CUBE, _SPHERE, _CYLINDER, _LINE_STRIP, _LINE_LIST = range(6)
_TEXT, _TRIANGLE_LIST, _ARROW_STRIP = 9, 11, 12
_DELETE, _DELETE_ALL = 2, 3
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]])
_ANGLES = np.linspace(0.0, math.tau, 25)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1) / 2
_HEAD, _HEAD_ANGLE = 0.3, 0.5
"""Length of an arrow's head, as a part of the arrow's, and the angle (rad) between its sides and the shaft."""


class _Marker(NamedTuple):
    """A marker, in its own frame.

    Attributes:
        lines: corners of lines: x and y of each line's.
        x: of points, m.
        y: of points, m.
        styles: of the points, or one for all of them and the lines.
        text: at the marker's pose.
        until: s since the epoch, when its life ends.
    """

    frame: str
    at: Transform
    lines: list[tuple[Floats, Floats]]
    x: Floats
    y: Floats
    styles: list[str]
    text: str
    until: float


class Markers:
    """The markers of all topics that are alive."""

    def __init__(self) -> None:
        self._markers: dict[tuple[str, str, int], _Marker] = {}

    def __len__(self) -> int:
        return len(self._markers)

    def receive(self, received: TakenMessage) -> None:
        """Take a visualization_msgs/msg/Marker or MarkerArray."""
        message = received.message
        for each in elements(message, "markers") if "markers" in message else [message]:
            action = number(each, "action")
            if action == _DELETE_ALL:
                self._markers = {key: kept for key, kept in self._markers.items() if key[0] != received.topic}
                continue
            identity = number(each, "id")
            key = received.topic, text(each, "ns"), int(identity) if math.isfinite(identity) else 0
            self._markers.pop(key, None)
            if action != _DELETE:
                if len(self._markers) >= MOST_MARKERS:  # the oldest one goes
                    del self._markers[next(iter(self._markers))]
                self._markers[key] = _read(each, received.time)

    def expire(self, now: float) -> None:
        """Forget markers whose lifetime is over."""
        for key in [key for key, marker in self._markers.items() if marker.until < now]:
            del self._markers[key]

    def placed(self, tree: FrameTree, target: str) -> tuple[list[tuple[_Marker, Transform]], dict[str, str]]:
        """Return the markers with the poses of their frames, and a frame without a pose by topic."""
        places: dict[str, Transform | None] = {}
        found, lost = [], {}
        for (topic, *_), marker in self._markers.items():
            if marker.frame not in places:
                places[marker.frame] = tree.place(marker.frame, target)
            place = places[marker.frame]
            if place is None:
                lost[topic] = marker.frame
            else:
                found.append((marker, place))
        return found, lost

    def frame(self) -> str:
        """Return the frame of the first one, or an empty string."""
        return next((marker.frame for marker in self._markers.values()), "")


def points_of(marker: _Marker, place: Transform) -> tuple[Floats, Floats]:
    """Return all points of a marker, by which a picture is fitted."""
    xs, ys = [marker.x, *(x for x, _ in marker.lines)], [marker.y, *(y for _, y in marker.lines)]
    if marker.text:
        xs, ys = [*xs, np.array([marker.at.x])], [*ys, np.array([marker.at.y])]
    return place.apply(np.concatenate(xs), np.concatenate(ys))


def draw_markers(
    canvas: Canvas,
    markers: list[tuple[_Marker, Transform]],
    dot: Callable[[float, float], tuple[int, int]],
    dots: Callable[[Floats, Floats, list[str]], Iterator[tuple[Floats, Floats, str]]],
) -> None:
    """Draw markers, their texts last.

    Args:
        dot: returns the dot of a point, on the canvas or not.
        dots: returns the dots of those points that are on the canvas, by their styles.
    """
    for marker, place in markers:
        for line_x, line_y in marker.lines:
            ends = [dot(*end) for end in zip(*place.apply(line_x, line_y), strict=True)]
            for start, end in itertools.pairwise(ends):
                canvas.line(*start, *end, marker.styles[0])
        if len(marker.x):
            for across, down, style in dots(*place.apply(marker.x, marker.y), marker.styles):
                put_dots(canvas, across, down, style)
    for marker, place in [each for each in markers if each[0].text][:_MOST_TEXTS]:
        x, y = dot(*place.apply(marker.at.x, marker.at.y))
        canvas.write(x // Canvas.ACROSS, y // Canvas.DOWN, marker.text, marker.styles[0])


def _read(message: Message, time: float) -> _Marker:
    kind = number(message, "type")
    at = pose(message, "pose")
    width, length = (abs(coordinate(number(message, f"scale.{axis}"))) for axis in "xy")
    style = _style(message, "color.")
    lines: list[tuple[Floats, Floats]] = []
    x = y = np.empty(0)
    styles, shown = [style], ""
    if kind in (_CUBE, _SPHERE, _CYLINDER):
        outline = _CORNERS if kind == _CUBE else _CIRCLE
        lines = [at.apply(outline[:, 0] * width, outline[:, 1] * length)]
    elif kind == _TEXT:
        shown = text(message, "text")[:255].split("\n")[0]
    else:
        points = elements(message, "points")[:MOST_POINTS]
        x, y = at.apply(*(np.array([coordinate(number(each, axis)) for each in points]) for axis in "xy"))
        if kind == _ARROW:
            if len(x) < 2:
                tip_x, tip_y = at.apply(width, 0.0)
                x, y = np.array([at.x, tip_x]), np.array([at.y, tip_y])
            lines = _arrow(x[0], y[0], x[1], y[1])
        elif kind in (_LINE_STRIP, _ARROW_STRIP):
            lines = [(x, y)]
        elif kind == _LINE_LIST:
            lines = [(x[first : first + 2], y[first : first + 2]) for first in range(0, len(x) - 1, 2)]
        elif kind == _TRIANGLE_LIST:
            around = [0, 1, 2, 0]
            lines = [(x[first + np.array(around)], y[first + np.array(around)]) for first in range(0, len(x) - 2, 3)]
        else:
            colours = elements(message, "colors")[:MOST_POINTS]
            if not len(x):  # a mesh, or a type of the future: its place
                x, y = np.array([at.x]), np.array([at.y])
            elif len(colours) == len(x):
                styles = [_style(colour) for colour in colours]
        if lines:
            x = y = np.empty(0)
    lifetime = number(message, "lifetime.sec") + number(message, "lifetime.nanosec") * 1e-9
    until = time + lifetime if lifetime > 0 else math.inf
    return _Marker(text(message, "header.frame_id").removeprefix("/"), at, lines, x, y, styles, shown, until)


def _arrow(x0: float, y0: float, x1: float, y1: float) -> list[tuple[Floats, Floats]]:
    """Return the shaft of an arrow and its head."""
    length, heading = math.hypot(x1 - x0, y1 - y0) * _HEAD, math.atan2(y1 - y0, x1 - x0)
    sides = [heading + math.pi - _HEAD_ANGLE, heading + math.pi + _HEAD_ANGLE]
    x, y = ([tip + length * turn(side) for side in sides] for tip, turn in ((x1, math.cos), (y1, math.sin)))
    return [(np.array([x0, x1]), np.array([y0, y1])), (np.array([x[0], x1, x[1]]), np.array([y[0], y1, y[1]]))]


def _style(message: Message, path: str = "") -> str:
    """Return a std_msgs/msg/ColorRGBA as one of a few colours."""
    parts = [number(message, f"{path}{name}") for name in "rgb"]
    steps = (round(min(1.0, max(0.0, part)) * _SHADES) if math.isfinite(part) else _SHADES for part in parts)
    return "#" + "".join(f"{step * 255 // _SHADES:02x}" for step in steps)
