"""The views of types: this program's, and other installed packages'.

A package adds a view by an entry point of the group `GROUP`, whose name is the type::

    [project.entry-points."rsb_console.views"]
    "my_msgs/msg/Thermal" = "my_package.thermal:ThermalView"

It runs in the process that draws, under the same limits as the others.
"""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from rsb_bridge.view.drawing import View

GROUP = "rsb_console.views"
"""The group of entry points by which other packages add views."""

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


def view_class(how: str) -> type[View] | None:
    """Return the view of a type or of a `Wish.how`, or None if it has none of its own.

    Raises:
        ImportError: a library of it is missing.
        AttributeError: another package's entry point names what is not there.
    """
    if place := VIEWS.get(how):
        module, _, name = place.partition(":")
        return cast("type[View]", getattr(importlib.import_module(f"rsb_bridge.view.{module}"), name))
    added = _added().get(how)
    return None if added is None else cast("type[View]", added.load())


def package_of(how: str) -> str:
    """Return the installed package that added the view of a type, or an empty string if no other package did."""
    added = None if how in VIEWS else _added().get(how)
    return "" if added is None else added.module.partition(".")[0] if added.dist is None else added.dist.name


@cache
def _added() -> dict[str, EntryPoint]:
    # Of a type that this program draws, its own view counts: no package that is installed changes what operators know.
    return {each.name: each for each in entry_points(group=GROUP)}
