"""Points around a sensor: laser scans and point clouds, from above or tilted, in braille."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, elements, nested, number, raw, text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

    Floats = NDArray[np.float32]

MOST_POINTS = 200_000
"""Points that are drawn; of more, every second, third … is. 100,000 take 15 ms (bench/README, Pictures)."""
_FAR = 98.0
"""Percentile of the distances that fits the picture with zoom 1: few far points may not shrink the rest."""
_LEAST_SPAN = 0.1  # m; a round figure
_COLOURS = (
    "#30123b", "#4145ab", "#4675ed", "#39a2fc", "#1bcfd4", "#24eca6", "#61fc6c", "#a4fc3c",
    "#d1e834", "#f3c63a", "#fe9b2d", "#f36315", "#d93806", "#b11901", "#7a0402",
)  # fmt: skip
"""Colours from low to high, after Turbo (Mikhailov, 2019)."""
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""By sensor_msgs/msg/PointField's datatype."""
_BITS = np.array(Canvas.BITS, dtype=np.uint8)
_RINGS = (1, 2, 5)


class PointsProblem(Wording):
    """The reason why points cannot be drawn."""

    NO_POINTS = "there is no valid point in it"
    NO_FIELD = "the cloud has no field {name}"
    TOO_SHORT = "the cloud has {got:,} bytes; {points:,} points of {step} bytes need {needed:,}"
    BAD_STEP = "a point of {step} bytes has no room for its fields"


class Points(NamedTuple):
    """Points in the frame of a sensor.

    Attributes:
        x: m, ahead.
        y: m, to the left.
        z: m, up.
        total: number of points in the message.
    """

    x: Floats
    y: Floats
    z: Floats
    intensity: Floats | None
    total: int
    frame: str


def scan_points(message: Message) -> Points:
    """Return the valid points of a sensor_msgs/msg/LaserScan."""
    ranges = _floats(message, "ranges")
    count = len(ranges)
    angles = number(message, "angle_min") + np.arange(count, dtype=np.float64) * number(message, "angle_increment")
    low, high = number(message, "range_min"), number(message, "range_max")
    valid = np.isfinite(ranges) & np.isfinite(angles) & (ranges >= low)
    # A driver may leave range_max at 0, and all points would be beyond it.
    if high > low:
        valid &= ranges <= high
    kept, angles = ranges[valid], angles[valid]
    intensities = _floats(message, "intensities")
    intensity = intensities[valid] if len(intensities) == count else None
    x, y = (kept * np.cos(angles)).astype(np.float32), (kept * np.sin(angles)).astype(np.float32)
    return Points(x, y, np.zeros_like(x), intensity, count, text(message, "header.frame_id"))


def _floats(message: Message, path: str) -> Floats:
    content, code = raw(message, path)
    return np.frombuffer(content, code).astype(np.float32)


def cloud_points(message: Message) -> Points:
    """Return the valid points of a sensor_msgs/msg/PointCloud2, at most `MOST_POINTS`.

    Raises:
        UndrawableError: the cloud lacks x, y or z, or its sizes do not fit.
    """
    width, height, step = (int(number(message, name)) for name in ("width", "height", "point_step"))
    total, order = width * height, ">" if nested(message, "is_bigendian") else "<"
    content, _ = raw(message, "data")
    fields: dict[str, tuple[str, int]] = {}
    for field in elements(message, "fields"):
        dtype, offset = _TYPES.get(int(number(field, "datatype"))), int(number(field, "offset"))
        if dtype is not None:
            if offset + np.dtype(dtype).itemsize > step:
                raise UndrawableError(PointsProblem.BAD_STEP(step=step))
            fields[text(field, "name")] = order + dtype, offset
    for name in ("x", "y", "z"):
        if name not in fields:
            raise UndrawableError(PointsProblem.NO_FIELD(name=name))
    row_bytes, row_step = width * step, int(number(message, "row_step"))
    data = np.frombuffer(content, np.uint8)
    # The last row may lack its padding. With a row_step that cannot be right, the rows follow each other, as in RViz.
    if total and row_step > row_bytes and len(content) >= row_step * (height - 1) + row_bytes:
        rows = np.lib.stride_tricks.as_strided(data, (height, row_bytes), (row_step, 1), writeable=False)
        data = np.ascontiguousarray(rows).ravel()
    if len(data) < total * step:
        raise UndrawableError(PointsProblem.TOO_SHORT(got=len(data), points=total, step=step, needed=total * step))
    stride = max(1, -(-total // MOST_POINTS))

    def column(name: str) -> Floats:
        dtype, offset = fields[name]
        cells = np.ndarray((total,), dtype, data[: total * step], offset, (step,)) if total else np.empty(0, dtype)
        with np.errstate(over="ignore", invalid="ignore"):
            return cells[::stride].astype(np.float32)

    x, y, z = column("x"), column("y"), column("z")
    valid = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    intensity = next((column(name)[valid] for name in ("intensity", "i", "reflectivity") if name in fields), None)
    return Points(x[valid], y[valid], z[valid], intensity, total, text(message, "header.frame_id"))


class PointsView(View):
    """Draws the newest scan or cloud, with the sensor in the middle, ahead at the top."""

    def __init__(self) -> None:
        self._points: Points | None = None
        self._reach: float | None = None

    def receive(self, received: TakenMessage) -> None:
        read = scan_points if "ranges" in received.message else cloud_points
        self._points = read(received.message)

    def draw(self, wish: Wish) -> Drawn:
        points = self._points
        if points is None:
            return Drawn()
        if not len(points.x):
            raise UndrawableError(PointsProblem.NO_POINTS())
        canvas = Canvas.of(wish)
        metres = self._metres(points, wish, canvas)
        tilt = math.radians(wish.tilt)
        width, height = canvas.width * Canvas.ACROSS, canvas.height * Canvas.DOWN
        with np.errstate(all="ignore"):
            ahead = points.x * math.cos(tilt) + points.z * math.sin(tilt)
            depth = points.z * math.cos(tilt) - points.x * math.sin(tilt)
            across = (-points.y / metres + width / 2 - wish.x * width).astype(np.int64)
            down = (-ahead / metres + height / 2 + wish.y * height).astype(np.int64)
        inside = (across >= 0) & (across < width) & (down >= 0) & (down < height)
        values, kind = _values(points, wish)
        order = np.argsort(depth[inside], kind="stable")  # the highest is drawn last
        put_values(canvas, across[inside][order], down[inside][order], values[inside][order])
        middle_column = round(canvas.width / 2 - wish.x * canvas.width)
        middle_row = round(canvas.height / 2 + wish.y * canvas.height)
        if not tilt:
            _rings(canvas, middle_column, middle_row, metres)
        canvas.write(middle_column - canvas.fine // 2, middle_row - canvas.fine // 2, "▲", "robot")
        low, high = (float(each) for each in (values.min(), values.max()))
        notes = [
            f"{points.total:,} points",
            f"frame {points.frame}" if points.frame else "",
            kind and f"{kind} {low:.3g} to {high:.3g}",
        ]
        return Drawn(canvas.cells(), tuple(note for note in notes if note))

    def _metres(self, points: Points, wish: Wish, canvas: Canvas) -> float:
        """Return the metres of a dot. They change only if the surroundings do, so that the picture stands still."""
        distance = float(np.percentile(np.hypot(points.x, points.y), _FAR))
        if self._reach is None or not 0.5 < distance / self._reach <= 1.05:
            self._reach = max(_LEAST_SPAN, distance * 1.05)
        dots = min(canvas.width * Canvas.ACROSS, canvas.height * Canvas.DOWN) / 2
        return self._reach / dots / wish.zoom


def _values(points: Points, wish: Wish) -> tuple[Floats, str]:
    """Return the values that give points their colours, and their name."""
    if wish.colour == "intensity" and points.intensity is not None:
        return np.nan_to_num(points.intensity, posinf=0.0, neginf=0.0), "intensity"
    if points.z.any():
        return points.z, "height"
    return np.hypot(points.x, points.y), "distance"


def put_dots(canvas: Canvas, across: NDArray[Any], down: NDArray[Any], style: str = "") -> NDArray[Any]:
    """Set dots that are on the canvas, all in one style; return their cells."""
    cells: NDArray[Any] = down // Canvas.DOWN * canvas.width + across // Canvas.ACROSS
    # `at`: with `|=`, only the last one of several dots in a cell would be set.
    np.bitwise_or.at(np.frombuffer(canvas.dots, np.uint8), cells, _BITS[down % Canvas.DOWN, across % Canvas.ACROSS])
    np.frombuffer(canvas.styles, np.uint8)[cells] = canvas.style(style)
    return cells


def put_values(canvas: Canvas, across: NDArray[Any], down: NDArray[Any], values: NDArray[Any]) -> None:
    """Set dots, coloured by values; of those in one cell, the last one gives the colour."""
    styles = np.array([canvas.style(colour) for colour in _COLOURS], dtype=np.uint8)
    cells = put_dots(canvas, across, down)
    if len(values):
        low, high = np.percentile(values, (2, 98))
        part = np.clip((values - low) / max(float(high - low), 1e-9), 0, 1)
        np.frombuffer(canvas.styles, np.uint8)[cells] = styles[(part * (len(_COLOURS) - 1)).astype(int)]


def _rings(canvas: Canvas, column: int, row: int, metres: float) -> None:
    """Draw circles at round distances from the sensor, with their distances."""
    reach = metres * canvas.height * Canvas.DOWN / 2
    if not (math.isfinite(reach) and reach > 0):
        return
    power = 10 ** math.floor(math.log10(reach))
    step = next(each * power / 2 for each in (*_RINGS, 10) if each * power / 2 >= reach / 3)
    for ring in (1, 2, 3):
        radius = ring * step / metres
        count = int(min(720, max(24, radius * 2)))
        for at in range(count):
            angle = 2 * math.pi * at / count
            x = round(column * Canvas.ACROSS + radius * math.sin(angle))
            y = round(row * Canvas.DOWN - radius * math.cos(angle))
            if canvas.is_free(x, y):
                canvas.dot(x, y, "dim")
        canvas.write(column + 1, round(row - radius / Canvas.DOWN), f"{ring * step:g} m", "dim")
