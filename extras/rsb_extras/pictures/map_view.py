"""A map: grid, robot, path, goal, scan and frames of several topics, laid over one another in one frame."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, elements, nested, number, raw, text
from rsb_extras.pictures.picture import Scale
from rsb_extras.pictures.points import cloud_points, put_dots, scan_points

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

    Floats = NDArray[np.float64]

FRAMES = 500
"""Frames that are remembered: a round figure."""
POSES = 5_000
"""Poses of a path that are drawn; of more, every second, third … is. A round figure."""
MOST_CELLS = 64 << 20
"""Cells of a grid that is drawn at most. A round figure: copies of it must fit into `worker.MEMORY_LIMIT`."""
_OCCUPIED = 65
"""Lowest value of an occupied cell (nav2_map_server's default, as a percentage)."""
_LETHAL = 253
"""The same of a nav2_msgs/msg/Costmap."""
_UNKNOWN_COST = 255
_DEPTH = 64
"""Transforms from a frame to another at most: a round figure."""
_MARGIN = 1.1  # so that nothing touches the edge
_ARROWS = "▶▲◀▼"
_FAR = 1e7
"""m, a quarter of the way around the Earth: coordinates beyond are wrong."""
_NAMED = 12
"""Frames that are shown with their names: a round figure."""


class MapProblem(Wording):
    """The reason why a map, or a layer of it, cannot be drawn."""

    BAD_GRID = "the grid of {width:,}×{height:,} cells has {got:,} values"
    NO_TRANSFORM = "{topic}: no transform from {frame!r} to {target!r} yet: add the topic /tf"


class Transform(NamedTuple):
    """The pose of a frame in another, in the plane."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return coordinates of the frame as coordinates of the other."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + cos * x - sin * y, self.y + sin * x + cos * y

    def after(self, inner: Transform) -> Transform:
        """Return the pose, in the other frame, of a pose in this one."""
        x, y = self.apply(inner.x, inner.y)
        return Transform(x, y, self.yaw + inner.yaw)

    def inverse(self) -> Transform:
        """Return the pose of the other frame in this one."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Transform(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw)


class _Grid(NamedTuple):
    """A grid.

    Attributes:
        cells: values by row, from the origin; occupied from `occupied` on, and unknown below 0.
        resolution: m a cell.
        origin: pose of the first cell's corner.
        occupied: lowest value of an occupied cell.
    """

    cells: NDArray[Any]
    resolution: float
    origin: Transform
    occupied: int


class _Layer(NamedTuple):
    """The part of the map that one topic adds, in its own frame.

    Attributes:
        x: of points, m.
        y: of points, m.
        is_line: whether the points are joined.
        pose: a pose with a direction, or None.
        style: of points and pose.
    """

    frame: str
    grid: _Grid | None = None
    x: Floats = np.empty(0)
    y: Floats = np.empty(0)
    is_line: bool = False
    pose: Transform | None = None
    style: str = ""
    note: str = ""


class MapView(View):
    """Draws the newest message of each topic."""

    def __init__(self) -> None:
        self._layers: dict[str, _Layer] = {}
        self._frames: dict[str, tuple[str, Transform]] = {}
        self._broadcast: set[str] = set()
        """Frames that TF has; of others, an odometry gives the pose."""
        self._topics: list[str] = []

    def receive(self, received: TakenMessage) -> None:
        message, name = received.message, received.type_name.rpartition("/")[2]
        if received.topic not in self._topics:
            self._topics.append(received.topic)
        if name == "TFMessage":
            for each in elements(message, "transforms"):
                child = text(each, "child_frame_id")
                self._add_frame(child, text(each, "header.frame_id"), _transform(each, "transform"))
                if child in self._frames:  # no more of them are remembered
                    self._broadcast.add(child)
            return
        read = _LAYERS.get(name)
        if read is None:
            raise UndrawableError(f"{received.topic}: {received.type_name} has no place on a map")
        layer = self._layers[received.topic] = read(message)
        child = text(message, "child_frame_id")
        if layer.pose is not None and child not in self._broadcast:
            self._add_frame(child, layer.frame, layer.pose)

    def _add_frame(self, child: str, parent: str, transform: Transform) -> None:
        if child and (child in self._frames or len(self._frames) < FRAMES):
            self._frames[child] = parent, transform

    def draw(self, wish: Wish) -> Drawn:
        if not self._layers:
            return Drawn()
        target = wish.frame or self._usual_frame()
        placed: list[tuple[_Layer, Transform]] = []
        notes, problem = [f"frame {target}"], ""
        for topic, layer in self._layers.items():
            place = self._place(layer.frame, target)
            if place is None:
                problem = MapProblem.NO_TRANSFORM(topic=topic, frame=layer.frame, target=target)
                continue
            placed.append((layer, place))
            notes += [layer.note] if layer.note else []
        extent = _extent(placed)
        if extent is None:
            raise UndrawableError(problem or f"nothing to draw in frame {target!r}")
        canvas, paper = Canvas(wish.width, wish.height), _Paper(extent, wish)
        for layer, place in sorted(placed, key=lambda each: each[0].pose is not None):  # poses over all else
            _draw_layer(canvas, paper, layer, place)
        if any(topic.rpartition("/")[2].startswith("tf") for topic in self._topics):
            self._draw_frames(canvas, paper, target)
        canvas.scale_bar(paper.metres * Canvas.ACROSS)
        return Drawn(canvas.cells(paper.scale(target)), tuple(notes), problem)

    def _usual_frame(self) -> str:
        """Return the frame of the first grid, else of the first layer."""
        layers = sorted(self._layers.values(), key=lambda layer: layer.grid is None)
        return layers[0].frame if layers else ""

    def _place(self, frame: str, target: str) -> Transform | None:
        """Return the pose of a frame in another, or None if the transforms between them are unknown."""
        if frame == target:
            return Transform()
        up, up_target = self._to_root(frame), self._to_root(target)
        for common, place in up.items():
            if common in up_target:
                return up_target[common].inverse().after(place)
        return None

    def _to_root(self, frame: str) -> dict[str, Transform]:
        """Return the poses of a frame in itself, in its parent, in its parent's parent …."""
        poses, pose = {frame: Transform()}, Transform()
        for _ in range(_DEPTH):
            found = self._frames.get(frame)
            # A hostile node, or two that disagree, may publish a circle.
            if found is None or found[0] in poses:
                break
            frame, pose = found[0], found[1].after(pose)
            poses[frame] = pose
        return poses

    def _draw_frames(self, canvas: Canvas, paper: _Paper, target: str) -> None:
        for frame in list(self._frames)[:_NAMED]:
            if (place := self._place(frame, target)) is not None:
                x, y = paper.dots(np.array([place.x]), np.array([place.y]))
                if len(x):
                    canvas.write(int(x[0]) // Canvas.ACROSS + 1, int(y[0]) // Canvas.DOWN, f"·{frame}", "dim")


class _Paper:
    """The part of the plane that the canvas shows."""

    def __init__(self, extent: tuple[float, float, float, float], wish: Wish) -> None:
        left, bottom, right, top = extent
        self._across, self._down = wish.width * Canvas.ACROSS, wish.height * Canvas.DOWN
        fitting = max((right - left) / self._across, (top - bottom) / self._down, 1e-6)  # a single point has no extent
        self.metres = fitting * _MARGIN / wish.zoom
        """m a dot."""
        self.left = (left + right) / 2 - self._across * self.metres * (0.5 - wish.x)
        self.top = (top + bottom) / 2 + self._down * self.metres * (0.5 + wish.y)

    def dots(self, x: Floats, y: Floats) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the dots of those points that are on the canvas."""
        with np.errstate(all="ignore"):
            across, down = np.floor((x - self.left) / self.metres), np.floor((self.top - y) / self.metres)
        inside = (across >= 0) & (across < self._across) & (down >= 0) & (down < self._down)
        return across[inside].astype(np.int64), down[inside].astype(np.int64)

    def dot(self, x: float, y: float) -> tuple[int, int]:
        """Return the dot of a point, on the canvas or not."""
        return math.floor((x - self.left) / self.metres), math.floor((self.top - y) / self.metres)

    def scale(self, frame: str) -> Scale:
        return Scale(
            sanitize_text(frame, 255), self.left, self.top, self.metres * Canvas.ACROSS, self.metres * Canvas.DOWN
        )


def _yaw(message: Message, path: str) -> float:
    """Return the rotation about z of a geometry_msgs/msg/Quaternion."""
    x, y, z, w = (number(message, f"{path}.{each}") for each in "xyzw")
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return yaw if math.isfinite(yaw) else 0.0


def _transform(message: Message, path: str) -> Transform:
    return Transform(
        _coordinate(number(message, f"{path}.translation.x")),
        _coordinate(number(message, f"{path}.translation.y")),
        _yaw(message, f"{path}.rotation"),
    )


def _pose(message: Message, path: str) -> Transform:
    x, y = (_coordinate(number(message, f"{path}.position.{axis}")) for axis in "xy")
    return Transform(x, y, _yaw(message, f"{path}.orientation"))


def _coordinate(value: float) -> float:
    return max(-_FAR, min(_FAR, value)) if math.isfinite(value) else 0.0


def _frame(message: Message) -> str:
    return text(message, "header.frame_id").removeprefix("/")


def _grid(message: Message) -> _Layer:
    costs = nested(message, "metadata") is not None
    about = "metadata" if costs else "info"
    sizes = ("size_x", "size_y") if costs else ("width", "height")
    width, height = (int(number(message, f"{about}.{name}")) for name in sizes)
    content, code = raw(message, "data")
    if width * height > min(MOST_CELLS, len(content)) or not width * height:
        raise UndrawableError(MapProblem.BAD_GRID(width=width, height=height, got=len(content)))
    cells: NDArray[Any] = np.frombuffer(content, code, width * height).reshape(height, width)
    if costs:
        # Costs are bytes without sign: -1 and 254 fit into 16 bits together.
        cells = np.where(cells == _UNKNOWN_COST, np.int16(-1), cells)
    resolution = number(message, f"{about}.resolution")
    # Cells of no size would be divided by.
    if not 0 < resolution < _FAR:
        resolution = 1.0
    grid = _Grid(cells, resolution, _pose(message, f"{about}.origin"), _LETHAL if costs else _OCCUPIED)
    note = f"{width}×{height} cells of {resolution:g} m"
    return _Layer(_frame(message), grid, style="occupied", note=note)


def _path(message: Message) -> _Layer:
    poses = elements(message, "poses")
    # Without poses, the step would be 0, which no slice has.
    poses = poses[:: max(1, -(-len(poses) // POSES))]
    inner = "pose.position" if "header" in (poses[0] if poses else {}) else "position"
    x, y = (np.array([_coordinate(number(each, f"{inner}.{axis}")) for each in poses]) for axis in "xy")
    return _Layer(_frame(message), x=x, y=y, is_line=inner.startswith("pose."), style="path", note=f"{len(x)} poses")


def _polygon(message: Message) -> _Layer:
    points = elements(message, "polygon.points")[:POSES]
    points = [*points, *points[:1]]
    x, y = (np.array([_coordinate(number(each, axis)) for each in points]) for axis in "xy")
    return _Layer(_frame(message), x=x, y=y, is_line=True, style="path")


def _odometry(message: Message) -> _Layer:
    return _Layer(_frame(message), pose=_pose(message, "pose.pose"), style="robot")


def _goal(message: Message) -> _Layer:
    return _Layer(_frame(message), pose=_pose(message, "pose"), style="goal")


def _scan(message: Message) -> _Layer:
    points = (scan_points if "ranges" in message else cloud_points)(message)
    return _Layer(_frame(message), x=points.x.astype(float), y=points.y.astype(float), style="scan")


_LAYERS = {
    "OccupancyGrid": _grid,
    "Costmap": _grid,
    "Path": _path,
    "PoseArray": _path,
    "PolygonStamped": _polygon,
    "Odometry": _odometry,
    "PoseWithCovarianceStamped": _odometry,
    "PoseStamped": _goal,
    "LaserScan": _scan,
    "PointCloud2": _scan,
}


def _corners(grid: _Grid) -> tuple[Floats, Floats]:
    height, width = grid.cells.shape
    x = np.array([0.0, width, width, 0.0]) * grid.resolution
    y = np.array([0.0, 0.0, height, height]) * grid.resolution
    return grid.origin.apply(x, y)


def _extent(placed: Iterable[tuple[_Layer, Transform]]) -> tuple[float, float, float, float] | None:
    """Return left, bottom, right and top of what is fitted: the grids, or everything if there is no grid."""
    placed = list(placed)
    grids = [(layer, place) for layer, place in placed if layer.grid is not None]
    xs, ys = [], []
    for layer, place in grids or placed:
        if layer.grid is not None:
            x, y = _known_part(layer.grid)
        elif layer.pose is not None:
            x, y = layer.pose.x + np.array([-2.0, 2.0]), layer.pose.y + np.array([-2.0, 2.0])
        else:
            x, y = layer.x, layer.y
        x, y = place.apply(x, y)
        xs.append(x)
        ys.append(y)
    # The empty ones, because numpy refuses to concatenate nothing.
    x, y = np.concatenate([*xs, np.empty(0)]), np.concatenate([*ys, np.empty(0)])
    valid = np.isfinite(x) & np.isfinite(y)
    if not valid.any():
        return None
    x, y = x[valid], y[valid]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _known_part(grid: _Grid) -> tuple[Floats, Floats]:
    """Return the corners of the part of a grid that is not unknown."""
    known = grid.cells >= 0 if grid.cells.dtype.kind == "i" else np.ones(grid.cells.shape, bool)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return _corners(grid)
    x = np.array([columns[0], columns[-1] + 1, columns[-1] + 1, columns[0]]) * grid.resolution
    y = np.array([rows[0], rows[0], rows[-1] + 1, rows[-1] + 1]) * grid.resolution
    return grid.origin.apply(x, y)


def _draw_layer(canvas: Canvas, paper: _Paper, layer: _Layer, place: Transform) -> None:
    if layer.grid is not None:
        _draw_grid(canvas, paper, layer.grid, place)
    x, y = place.apply(layer.x, layer.y)
    if layer.is_line:
        ends = [paper.dot(each_x, each_y) for each_x, each_y in zip(x, y, strict=True)]
        for start, end in itertools.pairwise(ends):
            canvas.line(*start, *end, layer.style)
    else:
        put_dots(canvas, *paper.dots(x, y), layer.style)
    if layer.pose is not None:
        pose = place.after(layer.pose)
        across, down = paper.dot(pose.x, pose.y)
        length = 3 * Canvas.DOWN
        canvas.line(
            across,
            down,
            round(across + length * math.cos(pose.yaw)),
            round(down - length * math.sin(pose.yaw)),
            layer.style,
        )
        mark = _ARROWS[round(pose.yaw / (math.pi / 2)) % 4] if layer.style == "robot" else "◆"
        canvas.write(across // Canvas.ACROSS, down // Canvas.DOWN, mark, layer.style)


def _draw_grid(canvas: Canvas, paper: _Paper, grid: _Grid, place: Transform) -> None:
    """Draw occupied cells, and one dim dot in each of the canvas's cells that is free."""
    place = place.after(grid.origin)
    back = place.inverse()
    height, width = grid.cells.shape

    def sampled(step_x: int, step_y: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        down, across = np.mgrid[
            step_y // 2 : canvas.height * Canvas.DOWN : step_y, step_x // 2 : canvas.width * Canvas.ACROSS : step_x
        ]
        x, y = back.apply(paper.left + (across + 0.5) * paper.metres, paper.top - (down + 0.5) * paper.metres)
        column, row = np.floor(x / grid.resolution).astype(int), np.floor(y / grid.resolution).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        values = grid.cells[row[inside], column[inside]]
        return across[inside], down[inside], values

    across, down, values = sampled(Canvas.ACROSS, Canvas.DOWN)
    free = (values >= 0) & (values < grid.occupied)
    put_dots(canvas, across[free], down[free], "free")
    across, down, values = sampled(1, 1)
    shown = np.zeros((canvas.height * Canvas.DOWN, canvas.width * Canvas.ACROSS), bool)
    shown[down, across] = values >= grid.occupied
    if paper.metres > grid.resolution:  # thin walls between the sampled places
        block = int(paper.metres / grid.resolution)  # cells of a dot, in each direction
        highest = np.maximum.reduceat(grid.cells, np.arange(0, height, block), axis=0)
        highest = np.maximum.reduceat(highest, np.arange(0, width, block), axis=1)
        rows, columns = np.nonzero(highest >= grid.occupied)
        middle = block / 2 * grid.resolution
        x, y = place.apply(columns * block * grid.resolution + middle, rows * block * grid.resolution + middle)
        across, down = paper.dots(x, y)
        shown[down, across] = True
    down, across = np.nonzero(shown)
    put_dots(canvas, across, down, "occupied")
