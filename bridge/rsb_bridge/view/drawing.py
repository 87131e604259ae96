"""Views: their interface, and the table of those of types, this program's and other installed packages'.

A view takes decoded messages, and draws a picture of them when one is wanted. A package adds one by an entry point of
the group `_GROUP`, whose name is the type::

    [project.entry-points."rsb_console.views"]
    "my_msgs/msg/Thermal" = "my_package.thermal:ThermalView"

It runs in the process that draws, under the same limits as the others.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, NamedTuple, cast

from rsb_bridge.cdr.decoder import Items

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_bridge.model.pictures import Cells, Pixels, Series, Wish

_GROUP = "rsb_console.views"
_PLOTTED = {
    "sensor_msgs": (
        "JointState", "Imu", "BatteryState", "Range", "Temperature", "FluidPressure", "MagneticField",
        "RelativeHumidity", "Illuminance",
    ),
    "geometry_msgs": (
        "Twist", "TwistStamped", "Vector3", "Vector3Stamped", "Wrench", "WrenchStamped", "Accel", "AccelStamped",
    ),
    "std_msgs": (
        "Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64",
        "Float32MultiArray", "Float64MultiArray",
    ),
}  # fmt: skip
_MAPPED = (
    "nav_msgs/msg/OccupancyGrid", "nav2_msgs/msg/Costmap", "nav_msgs/msg/Path", "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PolygonStamped",
)  # fmt: skip
VIEWS: dict[str, str] = {
    **{f"{package}/msg/{name}": "plots:PlotView" for package, names in _PLOTTED.items() for name in names},
    "plot": "plots:PlotView",
    "tree": "lists:FieldsView",
    **dict.fromkeys(_MAPPED, "map_view:MapView"),
    "map": "map_view:MapView",
    "tf2_msgs/msg/TFMessage": "lists:TfTree",
    "diagnostic_msgs/msg/DiagnosticArray": "lists:DiagnosticsView",
    "diagnostic_msgs/msg/DiagnosticStatus": "lists:DiagnosticsView",
    "rcl_interfaces/msg/Log": "lists:LogView",
    "sensor_msgs/msg/NavSatFix": "track:TrackView",
    "sensor_msgs/msg/LaserScan": "points:PointsView",
    "sensor_msgs/msg/PointCloud2": "points:PointsView",
    "sensor_msgs/msg/Image": "images:ImageView",
    "sensor_msgs/msg/CompressedImage": "images:ImageView",
}
"""This program's module and class of the view of a type, or of a `Wish.how`."""


class TakenMessage(NamedTuple):
    """A message that a view takes.

    Attributes:
        message: its values; arrays of primitive elements are raw (`rsb_bridge.cdr.decoder.Items.raw`).
        time: s since the epoch, when DDS received it.
        author: full name of the node that published it, or empty if unknown.
    """

    topic: str
    type_name: str
    message: Message
    time: float
    author: str = ""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A picture of a view's messages.

    Attributes:
        content: the picture, or None before the first message, or with a problem.
        problem: the reason why it is missing or incomplete, and what to do.
    """

    content: Pixels | Cells | Series | None = None
    notes: tuple[str, ...] = ()
    problem: str = ""


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
        return cast("type[View]", getattr(importlib.import_module(f"rsb_bridge.view.{module}"), name))
    added = _added_views().get(how)
    return None if added is None else cast("type[View]", added.load())


def package_of_view(how: str) -> str:
    """Return the installed package that added the view of a type, or an empty string if no other package did."""
    added = None if how in VIEWS else _added_views().get(how)
    return "" if added is None else added.module.partition(".")[0] if added.dist is None else added.dist.name


@cache
def _added_views() -> dict[str, EntryPoint]:
    # Of a type that this program draws, its own view counts: no package that is installed changes what operators know.
    return {each.name: each for each in entry_points(group=_GROUP)}


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


def raw(message: Message, path: str) -> tuple[memoryview, str]:
    """Return the bytes of an array of primitive elements by its path, and the code of one for `struct` and numpy.

    Raises:
        UndrawableError: the message has no such array.
    """
    value = nested(message, path)
    if not isinstance(value, Items) or value.raw is None:
        raise UndrawableError(f"the message has no array {path}")
    return value.raw, value.code
