"""Numbers of any message over time."""

from __future__ import annotations

import difflib
import math
import re
import struct
from bisect import bisect_left
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Drawn, UndrawableError, View
from rsb_extras.pictures.picture import MOST_VALUE, Curve, Series

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

CURVES = 4
"""Numbers that are plotted if none are chosen; these limits are round figures."""
NUMBERS = 256
"""Numbers of a message that are remembered."""
VALUES = 20_000
"""Values of each number that are remembered."""
_ITEMS = 16
"""Elements of an array that are remembered."""
_SECONDS = 3600.0
"""Time that is remembered."""
_PATH = 255
"""Characters of the path of a number that can be plotted."""
_COLUMNS = 2
"""Columns of a cell."""
_NOT_FIRST = re.compile(r"(^|\.)(header|stamp|covariance|seq|orientation_covariance|.*_covariance)(\.|\[|$)")
"""Fields that are plotted only if they are chosen."""
_USUAL = {
    "sensor_msgs/msg/BatteryState": ("percentage", "voltage", "current"),
    "sensor_msgs/msg/Imu": ("angular_velocity.x", "angular_velocity.y", "angular_velocity.z", "linear_acceleration.x"),
    "nav_msgs/msg/Odometry": ("twist.twist.linear.x", "twist.twist.angular.z"),
    "sensor_msgs/msg/Range": ("range",),
    "geometry_msgs/msg/Twist": ("linear.x", "linear.y", "angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.linear.y", "twist.angular.z"),
}
"""The numbers that are plotted if none are chosen."""


class PlotProblem(Wording):
    """The reason why there is no plot."""

    NO_NUMBERS = "the message has no numbers to plot"
    UNKNOWN_FIELD = "the message has no number {path!r}{hint}"


class _Track:
    """One number over time."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[float] = []

    def add(self, time: float, value: float) -> None:
        self.times.append(time)
        self.values.append(value)
        # Seldom: to delete from the front moves all values.
        if len(self.times) > VALUES + VALUES // 4 or (len(self.times) % 256 == 0 and time - self.times[0] > _SECONDS):
            keep = max(bisect_left(self.times, time - _SECONDS), len(self.times) - VALUES)
            del self.times[:keep], self.values[:keep]


class PlotView(View):
    """Draws numbers of all messages since the view began, up to an hour."""

    def __init__(self) -> None:
        self._tracks: dict[str, _Track] = {}
        self._type_name = ""
        self._newest = 0.0

    def receive(self, received: TakenMessage) -> None:
        self._type_name = received.type_name
        self._newest = max(self._newest, received.time)
        for path, value in _numbers(received.message, "", _element_names(received.message)):
            track = self._tracks.get(path)
            if track is None:
                if len(self._tracks) >= NUMBERS or len(path) > _PATH:
                    continue
                track = self._tracks[path] = _Track()
            if abs(value) <= MOST_VALUE:  # false for NaN, too
                # Not with its own time: `bisect_left` needs ascending ones.
                track.add(self._newest, value)

    def draw(self, wish: Wish) -> Drawn:
        if not self._newest:
            return Drawn()
        columns = _COLUMNS * wish.width
        step, start = wish.seconds / columns, self._newest - wish.seconds
        curves = tuple(_curve(path, self._tracks[path], start, step, columns) for path in self._chosen(wish))
        return Drawn(Series(start, step, curves))

    def _chosen(self, wish: Wish) -> list[str]:
        for path in wish.fields:
            if path not in self._tracks:
                near = difflib.get_close_matches(path, self._tracks, 3, 0.3)
                hint = f": one of {', '.join(near)}" if near else ""
                raise UndrawableError(PlotProblem.UNKNOWN_FIELD(path=path, hint=hint))
        if wish.fields:
            return list(wish.fields)
        usual = [path for path in _USUAL.get(self._type_name, ()) if path in self._tracks]
        found = usual or [path for path in self._tracks if not _NOT_FIRST.search(path)][:CURVES]
        if wish.match:
            found = [path for path in self._tracks if wish.match in path][: 2 * CURVES]
        if not found:
            raise UndrawableError(PlotProblem.NO_NUMBERS())
        return found


def _element_names(message: Message) -> list[str]:
    """Return the names of the elements of a message's arrays, as sensor_msgs/msg/JointState has them, or none."""
    names = message.get("name")
    return (
        [sanitize_text(str(each)) for each in names.shown]
        if isinstance(names, Items) and names.element == "string"
        else []
    )


def _numbers(value: Value, path: str, names: list[str]) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their paths."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _numbers(inner, f"{path}.{name}" if path else name, names)
    elif isinstance(value, Items):
        for at, inner in enumerate(_items(value)):
            yield from _numbers(inner, f"{path}[{names[at] if value.total == len(names) else at}]", names)
    elif isinstance(value, int | float):
        yield path, float(value)


def _items(items: Items) -> list[Value]:
    if items.raw is None:
        return items.shown[:_ITEMS]
    count = min(items.total, _ITEMS)
    size = struct.calcsize(items.code)
    return list(struct.unpack(f"{items.code[0]}{count}{items.code[1:]}", items.raw[: count * size]))


def _curve(name: str, track: _Track, start: float, step: float, columns: int) -> Curve:
    first = bisect_left(track.times, start)
    lows: list[float | None] = [None] * columns
    highs: list[float | None] = [None] * columns
    for time, value in zip(track.times[first:], track.values[first:], strict=True):
        column = min(columns - 1, int((time - start) / step))
        low, high = lows[column], highs[column]
        lows[column] = value if low is None else min(low, value)
        highs[column] = value if high is None else max(high, value)
    shown = track.values[first:]
    mean = math.fsum(shown) / len(shown) if shown else None
    return Curve(name, tuple(lows), tuple(highs), track.values[-1] if track.values else None, mean)
