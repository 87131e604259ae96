"""Numbers of any message over time."""

from __future__ import annotations

import difflib
import math
import re
import struct
from array import array
from bisect import bisect_left
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Drawn, UndrawableError, View, first_values
from rsb_extras.pictures.picture import (
    MOST_COLUMNS,
    MOST_NUMBERS,
    MOST_VALUE,
    TOPICS_AT_ONCE,
    Curve,
    FieldNumber,
    Series,
    field_of,
    split_field,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

CURVES, MOST_CURVES = 4, 8
"""Numbers that are plotted if none are chosen, of each topic and of all; these limits are round figures."""
NUMBERS = 256
"""Numbers that are remembered, besides the chosen ones."""
VALUES = 60_000
"""Values of each number that are remembered: 10 min at 100 Hz."""
_ITEMS = 16
"""Elements of an array that are remembered. Of longer ones, also the lowest, mean and highest element."""
_SUMMED = 10_000
"""Elements of an array of which these are computed."""
_SECONDS = 3600.0
"""Time that is remembered."""
_PATH = 255
"""Characters of the path of a number that can be plotted."""
_COLUMNS = 2
"""Columns of a cell."""
_NOT_FIRST = re.compile(
    r"(^|\.)(header|layout|stamp|seq|sequence|sec|nanosec|id|ns|covariance|\w+_(covariance|id)"
    r"|(angle|range)_(min|max)|(min|max)_range|field_of_view|radiation_type|angle_increment|time_increment|scan_time"
    r"|width|height|step|(point|row)_step|is_bigendian|is_dense|frame_number|\w*variance)(\.|\[|$)"
)
"""Fields that are plotted only if they are chosen, or if there are no others: they count, or hardly change."""
_POSE = ("position.x", "position.y")
_VECTOR = ("x", "y", "z")
_TWIST = ("linear.x", "linear.y", "angular.z")
_FORCES = tuple(f"force.{axis}" for axis in _VECTOR)


def _below(path: str, fields: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{path}.{field}" for field in fields)


_USUAL = {
    "geometry_msgs/msg/PoseStamped": _below("pose", _POSE),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _below("pose.pose", _POSE),
    "geometry_msgs/msg/Twist": _TWIST,
    "geometry_msgs/msg/TwistStamped": _below("twist", _TWIST),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _below("twist.twist", _TWIST),
    "geometry_msgs/msg/Vector3Stamped": _below("vector", _VECTOR),
    "geometry_msgs/msg/Wrench": _FORCES,
    "geometry_msgs/msg/WrenchStamped": _below("wrench", _FORCES),
    "nav_msgs/msg/Odometry": ("twist.twist.linear.x", "twist.twist.angular.z"),
    "sensor_msgs/msg/BatteryState": ("percentage", "voltage", "current"),
    "sensor_msgs/msg/Imu": (*_below("angular_velocity", _VECTOR), "linear_acceleration.x"),
    "sensor_msgs/msg/Joy": ("axes[0]", "axes[1]", "axes[2]", "axes[3]"),
    "sensor_msgs/msg/LaserScan": ("min(ranges)",),
    "sensor_msgs/msg/MagneticField": _below("magnetic_field", _VECTOR),
    "sensor_msgs/msg/NavSatFix": ("altitude",),
    "sensor_msgs/msg/Range": ("range",),
    "ackermann_msgs/msg/AckermannDriveStamped": ("drive.speed", "drive.steering_angle"),
}
"""The numbers that are plotted if none are chosen."""


class PlotProblem(Wording):
    """The reason why there is no plot."""

    NO_NUMBERS = "the message has no numbers to plot"
    NO_MESSAGE = "no message of {topic} so far, whose numbers are to be plotted"
    UNKNOWN_FIELD = "the message has no number {path!r}{hint}"


class _Track:
    """One number over time."""

    def __init__(self) -> None:
        self.times, self.values = array("d"), array("d")  # a fourth of the memory of lists

    def add(self, time: float, value: float) -> None:
        self.times.append(time)
        self.values.append(value)
        # Seldom: to delete from the front moves all values.
        if len(self.times) > VALUES + VALUES // 4 or (len(self.times) % 256 == 0 and time - self.times[0] > _SECONDS):
            keep = max(bisect_left(self.times, time - _SECONDS), len(self.times) - VALUES)
            del self.times[:keep], self.values[:keep]


class PlotView(View):
    """Draws numbers of all messages since the view began, up to an hour, of one or more topics."""

    def __init__(self) -> None:
        self._tracks: dict[tuple[str, str], _Track] = {}
        self._types: dict[str, str] = {}
        """By topic, in the order in which they came."""
        self._chosen: tuple[str, ...] = ()
        self._newest = 0.0

    def receive(self, received: TakenMessage) -> None:
        topic = received.topic
        if topic not in self._types and len(self._types) >= TOPICS_AT_ONCE:
            return
        self._types[topic] = received.type_name
        self._newest = max(self._newest, received.time)
        for path, value in _numbers(received.message, "", _element_names(received.message)):
            track = self._tracks.get((topic, path))
            if track is None:
                is_chosen = path in self._chosen or field_of(topic, path) in self._chosen
                if len(path) > _PATH or (len(self._tracks) >= NUMBERS and not is_chosen):
                    continue
                track = self._tracks[topic, path] = _Track()
            if abs(value) <= MOST_VALUE:  # false for NaN, too
                # Not with its own time: `bisect_left` needs ascending ones.
                track.add(self._newest, value)

    def draw(self, wish: Wish) -> Drawn:
        self._chosen = wish.fields
        if not self._newest:
            return Drawn()
        columns = min(_COLUMNS * wish.width * wish.fine, _COLUMNS * MOST_COLUMNS)
        step, start = wish.seconds / columns, self._newest - wish.seconds
        plotted = self._plotted(wish)
        curves = tuple(_curve(self._name(*key), self._tracks[key], start, step, columns) for key in plotted)
        return Drawn(Series(start, step, curves))

    def _name(self, topic: str, path: str) -> str:
        return (f"{topic} {path}" if len(self._types) > 1 else path)[:_PATH]

    def _plotted(self, wish: Wish) -> list[tuple[str, str]]:
        """Return the topics and paths of the numbers to plot."""
        if wish.fields:
            return [self._found(field) for field in wish.fields]
        if wish.match:
            found = [key for key in self._tracks if wish.match in key[1]][:MOST_CURVES]
        else:
            found = [key for topic in self._types for key in self._usual(topic)][:MOST_CURVES]
        if not found:
            raise UndrawableError(PlotProblem.NO_NUMBERS())
        return found

    def _found(self, field: str) -> tuple[str, str]:
        """Return the topic and the path of a chosen number.

        Raises:
            UndrawableError: there is no such number.
        """
        topic, path = split_field(field)
        found = next((key for key in self._tracks if key[1] == path and topic in ("", key[0])), None)
        if found is None:
            if topic and topic not in self._types:
                raise UndrawableError(PlotProblem.NO_MESSAGE(topic=topic))
            known = [key[1] for key in self._tracks if topic in ("", key[0])]
            near = difflib.get_close_matches(path, known, 3, 0.3)
            hint = f": one of {', '.join(near)}" if near else ""
            raise UndrawableError(PlotProblem.UNKNOWN_FIELD(path=field, hint=hint))
        return found

    def _usual(self, topic: str) -> list[tuple[str, str]]:
        own = [key for key in self._tracks if key[0] == topic]
        usual = [(topic, path) for path in _USUAL.get(self._types[topic], ()) if (topic, path) in self._tracks]
        return usual or ([key for key in own if not _NOT_FIRST.search(key[1])] or own)[:CURVES]


class NumbersView(View):
    """Lists the numbers of topics with their newest values, for a viewer that chooses some to plot."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str], float] = {}

    def receive(self, received: TakenMessage) -> None:
        for path, value in _numbers(received.message, "", _element_names(received.message)):
            key = received.topic, path
            # Longer ones cannot be wished for.
            if key in self._numbers or (len(self._numbers) < MOST_NUMBERS and len(field_of(*key)) <= _PATH):
                self._numbers[key] = value

    def draw(self, wish: Wish) -> Drawn:
        # Those that count or hardly change come last.
        listed = sorted(self._numbers.items(), key=lambda each: _NOT_FIRST.search(each[0][1]) is not None)
        numbers = (
            FieldNumber(topic, path, value if abs(value) <= MOST_VALUE else None)
            for (topic, path), value in listed
            if wish.match in path
        )
        return Drawn(numbers=tuple(numbers))


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
        for at, inner in enumerate(first_values(value, _ITEMS)):
            yield from _numbers(inner, f"{path}[{names[at] if value.total == len(names) else at}]", names)
        yield from _summary(value, path)
    elif isinstance(value, int | float):
        yield path, float(value)


def _summary(items: Items, path: str) -> Iterator[tuple[str, float]]:
    """Yield what one number says of many: the distance to the nearest obstacle, of a scan."""
    if items.raw is None or items.code[-1:] not in ("f", "d") or not _ITEMS < items.total <= _SUMMED:
        return
    if _NOT_FIRST.search(path):  # of a covariance, they say nothing
        return
    values = [
        each
        for each in struct.unpack(f"{items.code[0]}{items.total}{items.code[1:]}", items.raw)
        if abs(each) <= MOST_VALUE
    ]
    if values:
        yield f"min({path})", min(values)
        yield f"mean({path})", math.fsum(values) / len(values)
        yield f"max({path})", max(values)


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
