"""Views: their interface, the table of them by type, and the canvas for drawing with characters.

A view takes decoded messages, and draws a picture of them when one is wanted. A package adds one by an entry point of
the group `_GROUP`, whose name is the type::

    [project.entry-points."rsb_console.views"]
    "my_msgs/msg/Thermal" = "my_package.thermal:ThermalView"

It runs in the process that draws, under the same limits as the others.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, NamedTuple, cast

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.feature_api import sanitize_text
from rsb_bridge.model.text import single_cells
from rsb_extras.pictures.picture import Cells

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_extras.pictures.picture import FieldNumber, Pixels, Scale, Series, Wish

_GROUP = "rsb_console.views"
_PLOTTED = {
    "sensor_msgs": (
        "Imu", "Joy", "Range", "Temperature", "FluidPressure", "MagneticField", "RelativeHumidity", "Illuminance",
    ),
    "geometry_msgs": (
        "Twist", "TwistStamped", "TwistWithCovarianceStamped", "Vector3", "Vector3Stamped", "Wrench", "WrenchStamped",
        "Accel", "AccelStamped",
    ),
    "std_msgs": (
        "Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64",
        "Float32MultiArray", "Float64MultiArray",
    ),
}  # fmt: skip
_MAPPED = (
    "nav_msgs/msg/OccupancyGrid", "nav2_msgs/msg/Costmap", "nav_msgs/msg/Path", "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PolygonStamped", "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray",
)  # fmt: skip
VIEWS: dict[str, str] = {
    **{f"{package}/msg/{name}": "plots:PlotView" for package, names in _PLOTTED.items() for name in names},
    "plot": "plots:PlotView",
    "tree": "lists:FieldsView",
    "fields": "plots:NumbersView",
    **dict.fromkeys(_MAPPED, "map_view:MapView"),
    "map": "map_view:MapView",
    "tf2_msgs/msg/TFMessage": "lists:TfTree",
    "diagnostic_msgs/msg/DiagnosticArray": "lists:DiagnosticsView",
    "diagnostic_msgs/msg/DiagnosticStatus": "lists:DiagnosticsView",
    "rcl_interfaces/msg/Log": "lists:LogView",
    "sensor_msgs/msg/BatteryState": "value_bars:BatteryView",
    "sensor_msgs/msg/JointState": "value_bars:JointsView",
    "sensor_msgs/msg/NavSatFix": "track:TrackView",
    "sensor_msgs/msg/LaserScan": "points:PointsView",
    "sensor_msgs/msg/PointCloud2": "points:PointsView",
    "sensor_msgs/msg/Image": "images:ImageView",
    "sensor_msgs/msg/CompressedImage": "images:ImageView",
}
"""This program's module and class of the view of a type, or of a `Wish.how`."""
_LAYERS = {"sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage"}
"""Types without a map of their own that can be laid over one."""
_BRAILLE = 0x2800
_STYLES = 256
"""A cell's style is a byte."""
_LINE_DOTS = 500_000
"""Dots of all lines; of further lines, only the ends are drawn. A round figure."""


class TakenMessage(NamedTuple):
    """A message that a view takes.

    Attributes:
        message: its values; arrays of primitive elements are raw (`rsb_bridge.cdr.decoder.Items.raw`).
        time: s since the epoch, when DDS received it.
        author: full name of the node that published it, or empty if unknown.
        is_asked: whether the viewer named the topic; others help to draw those.
    """

    topic: str
    type_name: str
    message: Message
    time: float
    author: str = ""
    is_asked: bool = True


@dataclass(frozen=True, slots=True)
class Drawn:
    """A picture of a view's messages.

    Attributes:
        content: the picture, or None before the first message, or with a problem.
        problem: the reason why it is missing or incomplete, and what to do.
        numbers: `rsb_extras.pictures.picture.Picture.numbers`.
    """

    content: Pixels | Cells | Series | None = None
    notes: tuple[str, ...] = ()
    problem: str = ""
    numbers: tuple[FieldNumber, ...] = ()


class UndrawableError(Exception):
    """A message cannot be drawn; the text says why, and what to do."""


class View(ABC):
    """One viewer's picture of one or more topics.

    It runs in a process of its own, which is killed if it takes too long or too much memory. Messages are not trusted:
    they may have any values that their types allow, NaN, wrong lengths and huge sizes included.

    Attributes:
        now: s since the epoch on the clock of `TakenMessage.time` when the picture is wanted, or 0.
    """

    now = 0.0

    @abstractmethod
    def receive(self, received: TakenMessage) -> None:
        """Take a message. Called for every message, or, if they are large or many, for the newest ones.

        Raises:
            UndrawableError: the message cannot be drawn; it is shown with the next picture.
        """

    @abstractmethod
    def draw(self, wish: Wish) -> Drawn:
        """Draw what has been taken so far.

        Raises:
            UndrawableError: nothing can be drawn.
        """


def view_class(how: str) -> type[View] | None:
    """Return the view of a type or of a `Wish.how`, or None if it has none of its own.

    Raises:
        ImportError: a library of it is missing.
        AttributeError: another package's entry point names what is not there.
    """
    if place := VIEWS.get(how):
        module, _, name = place.partition(":")
        return cast("type[View]", getattr(importlib.import_module(f"rsb_extras.pictures.{module}"), name))
    added = _added_views().get(how)
    return None if added is None else cast("type[View]", added.load())


def package_of_view(how: str) -> str:
    """Return the installed package that added the view of a type, or an empty string if no other package did."""
    added = None if how in VIEWS else _added_views().get(how)
    return "" if added is None else added.module.partition(".")[0] if added.dist is None else added.dist.name


def has_picture(type_name: str) -> bool:
    """Whether messages of a type have a picture other than their fields, of this program or of another package."""
    if type_name in VIEWS:
        return True
    with contextlib.suppress(Exception):  # the metadata of any installed package may be broken
        return package_of_view(type_name) != ""
    return False


def is_map(type_name: str) -> bool:
    """Whether messages of a type are drawn as a map."""
    return VIEWS.get(type_name) == VIEWS["map"]


def is_layer(type_name: str) -> bool:
    """Whether messages of a type can be laid over a map."""
    return is_map(type_name) or type_name in _LAYERS


@cache
def _added_views() -> dict[str, EntryPoint]:
    # Of a type that this program draws, its own view counts: no package that is installed changes what operators know.
    return {each.name: each for each in entry_points(group=_GROUP)}


class Canvas:
    """Cells that a view draws on: text, and dots in braille patterns (Unicode block 2800), eight to a cell.

    Attributes:
        width: cells.
        height: cells.
        dots: the braille pattern of each cell, row by row; a view may write it directly, as the next three.
        blocks: for each cell without dots, the index of its character in `BLOCKS`.
        styles: the index of each cell's style, row by row (`style`).
        backgrounds: the index of the style behind each cell, row by row.
        fine: cells in each direction of a character of text.
    """

    ACROSS, DOWN = 2, 4
    """Dots of a cell."""
    BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
    """Bit of each dot in a braille pattern, by row and column."""
    BLOCKS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█⠠"
    """A cell's quarters by their bits (upper left 1, upper right 2, lower left 4, lower right 8), and a dot."""
    A_DOT = 16

    def __init__(self, width: int, height: int, fine: int = 1) -> None:
        self.width, self.height, self.fine = width, height, fine
        self.dots = bytearray(width * height)
        self.blocks = bytearray(width * height)
        self.styles = bytearray(width * height)
        self.backgrounds = bytearray(width * height)
        self._line_dots = _LINE_DOTS
        self._characters: dict[int, str] = {}
        self._palette: dict[str, int] = {"": 0}

    @classmethod
    def of(cls, wish: Wish) -> Canvas:
        """Return a canvas as fine as a wish for a map."""
        fine = wish.allowed_fine
        return cls(wish.width * fine, wish.height * fine, fine)

    def style(self, name: str) -> int:
        """Return the index of a style of `rsb_extras.pictures.picture.STYLES`, or of a colour ``#rrggbb``."""
        if name not in self._palette and len(self._palette) >= _STYLES:
            return _STYLES - 1
        return self._palette.setdefault(name, len(self._palette))

    def dot(self, x: int, y: int, style: str = "") -> None:
        """Set a dot, counted from the upper left, if it is on the canvas."""
        column, across = divmod(x, self.ACROSS)
        row, down = divmod(y, self.DOWN)
        if 0 <= column < self.width and 0 <= row < self.height:
            cell = row * self.width + column
            self.dots[cell] |= self.BITS[down][across]
            self.styles[cell] = self.style(style)

    def is_free(self, x: int, y: int) -> bool:
        """Whether the cell of a dot is on the canvas and empty, or has only dim dots."""
        column, row = x // self.ACROSS, y // self.DOWN
        if not (0 <= column < self.width and 0 <= row < self.height):
            return False
        cell = row * self.width + column
        return not self.dots[cell] or self.styles[cell] == self._palette.get("dim")

    def line(self, x0: int, y0: int, x1: int, y1: int, style: str = "") -> None:
        """Set the dots between two points, both included; points far outside are cut off."""
        # Otherwise one far point would use up the dots of all lines.
        limit = 4 * max(self.width * self.ACROSS, self.height * self.DOWN)
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
        shown = single_cells(sanitize_text(text))
        self._clear_text(column, row, len(shown))
        for number, character in enumerate(shown):
            if 0 <= (at := column + number * self.fine) < self.width:
                cell = row * self.width + at
                self._characters[cell] = character
                self.styles[cell] = self.style(style)

    def _clear_text(self, column: int, row: int, length: int) -> None:
        """Remove characters that reach into a text which begins at a cell; of a finer canvas, they have several."""
        if (reach := self.fine - 1) and self._characters:
            columns = range(max(0, column - reach), min(self.width, column + length * self.fine))
            for each in range(max(0, row - reach), row + reach + 1):
                for at in columns:
                    self._characters.pop(each * self.width + at, None)

    def scale_bar(self, column: float) -> int:
        """Draw a bar with its length at the lower left, for so many metres a column.

        Returns:
            The number of characters up to its end.
        """
        rough = column * self.width / 5
        power = 10 ** math.floor(math.log10(rough))
        length = next(each * power for each in (1, 2, 5, 10) if each * power >= rough)
        bar = f"├{'─' * max(0, round(length / (column * self.fine)) - 1)}┤ {length:g} m"
        self.write_below(1, bar, "axis")
        return 1 + len(bar)

    def write_below(self, column: int, text: str, style: str) -> None:
        """Write text into the last line, from a column of characters on."""
        self.write(column * self.fine, self.height - self.fine, text, style)

    def characters(self) -> set[int]:
        """Return the cells that have text."""
        return {*self._characters}

    def clear_last_line(self) -> None:
        """Remove all from it, the background too, so that text on it can be read."""
        for cell in range((self.height - self.fine) * self.width, self.height * self.width):
            self.dots[cell] = self.blocks[cell] = self.styles[cell] = self.backgrounds[cell] = 0
            self._characters.pop(cell, None)

    def cells(self, scale: Scale | None = None) -> Cells:
        """Return the picture."""
        both = zip(self.dots, self.blocks, strict=True)
        characters = [chr(_BRAILLE + pattern) if pattern else self.BLOCKS[block] for pattern, block in both]
        for cell, character in self._characters.items():
            characters[cell] = character
        rows = ("".join(characters[row * self.width : (row + 1) * self.width]) for row in range(self.height))
        backgrounds = bytes(self.backgrounds) if any(self.backgrounds) else b""
        return Cells(tuple(rows), bytes(self.styles), tuple(self._palette), scale, backgrounds, self.fine)


def nested(message: Message, path: str) -> Value | None:
    """Return a field of a message by its path (``header.frame_id``), or None if it is missing."""
    value: Value | None = message
    for name in path.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value


def number(message: Message, path: str) -> float:
    """Return a number by its path, or NaN if it is missing."""
    value = nested(message, path)
    return float(value) if isinstance(value, int | float) else float("nan")


def text(message: Message, path: str) -> str:
    """Return a string by its path, or an empty string if it is missing."""
    value = nested(message, path)
    return value if isinstance(value, str) else ""


def elements(message: Message, path: str) -> list[Message]:
    """Return the messages in an array by its path, or an empty list if it is missing."""
    value = nested(message, path)
    return [each for each in value.shown if isinstance(each, dict)] if isinstance(value, Items) else []


def first_values(items: Items, most: int) -> list[Value]:
    """Return the first elements of an array, also of one of primitive elements."""
    if items.raw is None:
        return items.shown[:most]
    count = min(items.total, most)
    size = struct.calcsize(items.code)
    return list(struct.unpack(f"{items.code[0]}{count}{items.code[1:]}", items.raw[: count * size]))


def floats(message: Message, path: str, most: int) -> list[float]:
    """Return the first numbers in an array by its path, or an empty list if it is missing."""
    value = nested(message, path)
    found = first_values(value, most) if isinstance(value, Items) else []
    return [float(each) for each in found if isinstance(each, int | float)]


def raw(message: Message, path: str) -> tuple[memoryview, str]:
    """Return the bytes of an array of primitive elements by its path, and the code of one for `struct` and numpy.

    Raises:
        UndrawableError: the message has no such array.
    """
    value = nested(message, path)
    if not isinstance(value, Items) or value.raw is None:
        raise UndrawableError(f"the message has no array {path}")
    return value.raw, value.code
