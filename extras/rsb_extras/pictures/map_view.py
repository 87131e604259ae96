"""A map: grids, robot, path, goal, scan, markers and frames of several topics, laid over one another in one frame."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rsb_bridge.model.text import sanitize_text, single_cells
from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, elements, number, text
from rsb_extras.pictures.grids import INSCRIBED_TINT, Grid, Sheet, ground, has_inscribed, lay_under, read_grid
from rsb_extras.pictures.markers import Markers, draw_markers, points_of
from rsb_extras.pictures.picture import TOPICS_AT_ONCE, Scale
from rsb_extras.pictures.points import cloud_points, put_dots, scan_points
from rsb_extras.pictures.transforms import FrameTree, Transform, coordinate, pose, stamp_of, transform

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.grids import Kinds
    from rsb_extras.pictures.picture import Wish
    from rsb_extras.pictures.transforms import Floats

POSES = 5_000
"""Poses of a path that are drawn; of more, every second, third … is. A round figure."""
_MARGIN = 1.1  # so that nothing touches the edge
_ARROWS, _GOAL, _MARKED = "▶▲◀▼", "◆", "▪"
_NAMED = 12
"""Frames that are shown with their names: a round figure."""
_ROBOTS = ("base_link", "base_footprint")
"""Frames of robots, the more usual one first (REP 105)."""
_MOST_ROBOTS = 8
"""Robots of a tree of frames that are drawn, as namespaces may have one each: a round figure."""
_LOST = 5.0
"""s after which a robot's transform is named as old. A round figure: a localization sends several a second."""
_OTHERS = {"path": ("path", "warning", "strong"), "scan": ("scan", "warning", "ok")}
"""Styles of several layers of the same kind, one after the other."""
_LOW = 3
"""Rows of a picture that has none to spare for a legend."""
_GAP = 2
"""Cells between the scale bar and the legend, and between the legend's parts."""


class MapProblem(Wording):
    """The reason why a map, or a layer of it, cannot be drawn."""

    NO_TRANSFORM = "{topic}: no transform from {frame!r} to {target!r} yet: add the topic /tf"
    OLD = "{frame} is {age:.0f} s old"


class _Layer(NamedTuple):
    """The part of the map that one topic adds, in its own frame.

    Attributes:
        sign: its character in the legend.
        x: of points, m.
        y: of points, m.
        stamp: s, its own, by which its frame is placed, or 0.
        is_line: whether the points are joined.
        pose: a pose with a direction, or None.
        robot: frame of the pose, if it is a robot's, or an empty string.
        style: of points and pose.
    """

    frame: str
    sign: str
    grid: Grid | None = None
    x: Floats = np.empty(0)
    y: Floats = np.empty(0)
    stamp: float = 0.0
    is_line: bool = False
    pose: Transform | None = None
    robot: str = ""
    style: str = ""
    note: str = ""


class MapView(View):
    """Draws the newest message of each topic."""

    def __init__(self) -> None:
        self._layers: dict[str, _Layer] = {}
        self._markers = Markers()
        self._marked: list[str] = []
        """Topics of markers."""
        self._tree = FrameTree()
        self._broadcast: set[str] = set()
        """Frames that TF has; of others, an odometry gives the pose."""
        self._shows_frames = False
        self._newest = 0.0
        self._ground: tuple[Any, Kinds] | None = None
        """The ground of the last picture, with all that it depends on: grids seldom change."""

    def receive(self, received: TakenMessage) -> None:
        message, name = received.message, received.type_name.rpartition("/")[2]
        self._newest = max(self._newest, received.time)
        if name == "TFMessage":
            self._receive_frames(received)
        elif name in ("Marker", "MarkerArray"):
            if received.topic not in self._marked and len(self._marked) < TOPICS_AT_ONCE:
                self._marked.append(received.topic)
            self._markers.receive(received)
        elif (read := _LAYERS.get(name)) is not None:
            layer = self._layers[received.topic] = read(message, received.topic)._replace(stamp=stamp_of(message))
            if layer.pose is not None and layer.robot not in self._broadcast:
                self._tree.add(layer.robot, layer.frame, layer.pose, layer.stamp, received.time)
        else:
            raise UndrawableError(f"{received.topic}: {received.type_name} has no place on a map")

    def _receive_frames(self, received: TakenMessage) -> None:
        self._shows_frames |= received.is_asked
        time = math.inf if received.topic.endswith("tf_static") else received.time
        for each in elements(received.message, "transforms"):
            # As tf2 does, since older nodes begin the names of frames with a /.
            child, parent = (text(each, name).removeprefix("/") for name in ("child_frame_id", "header.frame_id"))
            self._tree.add(child, parent, transform(each, "transform"), stamp_of(each), time)
            if child in self._tree:  # no more of them are remembered
                self._broadcast.add(child)

    def draw(self, wish: Wish) -> Drawn:
        now = max(self.now, self._newest)
        self._markers.expire(now)
        if not self._layers and not len(self._markers):
            return Drawn()
        target = wish.frame or self._usual_frame()
        placed, markers, problem = self._placed(target)
        robots = self._robots(target)
        extent = _extent(placed, [points_of(*each) for each in markers])
        if extent is None:
            raise UndrawableError(problem or f"nothing to draw in frame {target!r}")
        canvas = Canvas.of(wish)
        paper = _Paper(extent, wish, canvas)
        for _, layer, place in placed:
            _draw_points(canvas, paper, layer, place)
        draw_markers(canvas, markers, paper.dot, paper.dots_by_style)
        if self._shows_frames:
            self._draw_frames(canvas, paper, target, robots)
        for _, layer, place in placed:  # poses over all else
            if layer.pose is not None and layer.robot not in robots:
                _draw_pose(canvas, paper, place.after(layer.pose), layer.style)
        for place in robots.values():
            _draw_pose(canvas, paper, place, "robot")
        legend = self._legend(placed, robots)
        grids = [(layer.grid, place) for _, layer, place in placed if layer.grid is not None]
        if grids:
            kinds = self._kinds(grids, paper, canvas)
            lay_under(canvas, kinds)
            if has_inscribed(kinds):  # a bright bar, which nobody should take for a goal
                legend.append(("■", f"@{INSCRIBED_TINT}", "inscribed"))
        if wish.height > _LOW:
            canvas.clear_last_line()
        column = canvas.scale_bar(paper.metres * Canvas.ACROSS)
        if wish.height > _LOW:
            _write_legend(canvas, column, legend)
        notes = [f"frame {target}", *(layer.note for _, layer, _ in placed if layer.note)]
        notes += [
            MapProblem.OLD(frame=frame, age=age) for frame in robots if (age := now - self._tree.oldest(frame)) > _LOST
        ]
        return Drawn(canvas.cells(paper.scale(target)), tuple(notes), problem)

    def _usual_frame(self) -> str:
        """Return the frame of the first grid, of a map rather than of costs, else of the first layer."""
        layers = sorted(self._layers.values(), key=lambda each: 2 if each.grid is None else each.grid.has_costs)
        return layers[0].frame if layers else self._markers.frame()

    def _placed(self, target: str) -> tuple[list[_Placed], list[Any], str]:
        """Return layers and markers with the poses of their frames, and the reason why some are left out."""
        placed: list[_Placed] = []
        used: dict[str, int] = {}
        markers, lost = self._markers.placed(self._tree, target)
        for topic, layer in self._layers.items():
            place = self._tree.place(layer.frame, target, layer.stamp)
            if place is None:
                lost[topic] = layer.frame
                continue
            styles = _OTHERS.get(layer.style, (layer.style,))
            at = used[layer.style] = used.get(layer.style, -1) + 1
            placed.append((topic, layer._replace(style=styles[at % len(styles)]), place))
        problems = [MapProblem.NO_TRANSFORM(topic=topic, frame=frame, target=target) for topic, frame in lost.items()]
        return placed, markers, problems[-1] if problems else ""

    def _robots(self, target: str) -> dict[str, Transform]:
        """Return the poses of the robots that TF has, by their frames."""
        found: dict[str, Transform] = {}
        spaces: set[str] = set()
        for name in _ROBOTS:
            for frame in self._tree:
                if frame not in self._broadcast:  # an odometry's, which is a layer of its own
                    continue
                space, slash, last = frame.rpartition("/")
                if last != name or space + slash in spaces or frame == target or len(found) >= _MOST_ROBOTS:
                    continue
                if (place := self._tree.place(frame, target)) is not None:
                    spaces.add(space + slash)
                    found[frame] = place
        return found

    def _kinds(self, grids: list[tuple[Grid, Transform]], paper: _Paper, canvas: Canvas) -> Kinds:
        # The grids themselves: another one might get the id of one that is gone.
        key = [(grid.kinds, place) for grid, place in grids], paper.sheet, (canvas.width, canvas.height)
        if self._ground is not None:
            before, same_size = (
                self._ground[0],
                self._ground[0][1:] == key[1:] and len(self._ground[0][0]) == len(key[0]),
            )
            if same_size and all(a[0] is b[0] and a[1] == b[1] for a, b in zip(before[0], key[0], strict=True)):
                return self._ground[1]
        kinds = ground(grids, paper.sheet, canvas.width, canvas.height)
        self._ground = key, kinds
        return kinds

    def _draw_frames(self, canvas: Canvas, paper: _Paper, target: str, robots: Iterable[str]) -> None:
        named = [frame for frame in self._tree if frame not in robots][:_NAMED]
        for frame in named:
            if (place := self._tree.place(frame, target)) is not None:
                x, y = paper.dots(np.array([place.x]), np.array([place.y]))
                if len(x):
                    row = int(y[0]) // Canvas.DOWN - canvas.fine // 2
                    canvas.write(int(x[0]) // Canvas.ACROSS + canvas.fine, row, f"·{frame}", "dim")

    def _legend(self, placed: list[_Placed], robots: Iterable[str]) -> list[tuple[str, str, str]]:
        """Return signs, their styles, and what they stand for."""
        legend = [
            (layer.sign, "lethal" if layer.grid is not None and layer.grid.has_costs else layer.style, topic)
            for topic, layer, _ in placed
            if layer.robot not in robots or layer.pose is None
        ]
        legend += [(_MARKED, "strong", topic) for topic in self._marked]
        return legend + [(_ARROWS[0], "robot", frame) for frame in robots]


_Placed = tuple[str, _Layer, Transform]
"""A layer, with its topic and the pose of its frame."""


def _write_legend(canvas: Canvas, column: int, legend: list[tuple[str, str, str]]) -> None:
    """Write as many entries as have room, with the last part of names if whole ones have none."""
    width = canvas.width // canvas.fine
    names = [name for _, _, name in legend]
    if sum(len(name) + 2 + _GAP for name in names) > width - column:
        last = [name.rpartition("/")[2] for name in names]
        # Of /local_costmap/costmap and /global_costmap/costmap, the first part says more.
        names = [
            name.strip("/").partition("/")[0] if last.count(short) > 1 else short
            for name, short in zip(names, last, strict=True)
        ]
    for (sign, style, _), name in zip(legend, names, strict=True):
        shown = single_cells(sanitize_text(name))
        column += _GAP
        if column + 2 + len(shown) > width:
            canvas.write_below(column, "…", "axis")
            return
        # A full block is a part of walls: on a finer canvas it is no sign of its own.
        canvas.write_below(column, sign.replace("█", "■") if canvas.fine > 1 else sign, style)
        canvas.write_below(column + 2, shown, "axis")
        column += 2 + len(shown)


class _Paper:
    """The part of the plane that the canvas shows."""

    def __init__(self, extent: tuple[float, float, float, float], wish: Wish, canvas: Canvas) -> None:
        left, bottom, right, top = extent
        self._across, self._down = canvas.width * Canvas.ACROSS, canvas.height * Canvas.DOWN
        above_legend = self._down - Canvas.DOWN * canvas.fine * (wish.height > _LOW)
        fitting = max(
            (right - left) / self._across, (top - bottom) / above_legend, 1e-6
        )  # a single point has no extent
        self.metres = fitting * _MARGIN / wish.zoom
        """m a dot."""
        self.left = (left + right) / 2 - self._across * self.metres * (0.5 - wish.x)
        self.top = (top + bottom) / 2 + self.metres * (above_legend / 2 + self._down * wish.y)

    @property
    def sheet(self) -> Sheet:
        return Sheet(self.left, self.top, self.metres)

    def dots(self, x: Floats, y: Floats) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the dots of those points that are on the canvas."""
        across, down, _ = self._inside(x, y)
        return across, down

    def dots_by_style(self, x: Floats, y: Floats, styles: list[str]) -> Iterator[tuple[Any, Any, str]]:
        """Yield the dots of points that are on the canvas, by style; there is a style for each point, or for all."""
        across, down, inside = self._inside(x, y)
        if len(styles) == 1:
            yield across, down, styles[0]
            return
        names, which = np.unique(np.array(styles)[inside], return_inverse=True)
        for at, name in enumerate(names):
            yield across[which == at], down[which == at], str(name)

    def _inside(self, x: Floats, y: Floats) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        with np.errstate(all="ignore"):
            across, down = np.floor((x - self.left) / self.metres), np.floor((self.top - y) / self.metres)
        inside = (across >= 0) & (across < self._across) & (down >= 0) & (down < self._down)
        return across[inside].astype(np.int64), down[inside].astype(np.int64), inside

    def dot(self, x: float, y: float) -> tuple[int, int]:
        """Return the dot of a point, on the canvas or not."""
        return math.floor((x - self.left) / self.metres), math.floor((self.top - y) / self.metres)

    def scale(self, frame: str) -> Scale:
        return Scale(
            sanitize_text(frame, 255), self.left, self.top, self.metres * Canvas.ACROSS, self.metres * Canvas.DOWN
        )


def _frame(message: Message) -> str:
    return text(message, "header.frame_id").removeprefix("/")


def _grid(message: Message, topic: str) -> _Layer:
    grid = read_grid(message, topic)
    height, width = grid.kinds.shape
    note = f"{width}×{height} cells of {grid.resolution:g} m"
    return _Layer(_frame(message), "■" if grid.has_costs else "█", grid, style="occupied", note=note)


def _path(message: Message, _topic: str) -> _Layer:
    poses = elements(message, "poses")
    # Without poses, the step would be 0, which no slice has.
    poses = poses[:: max(1, -(-len(poses) // POSES))]
    inner = "pose.position" if "header" in (poses[0] if poses else {}) else "position"
    x, y = (np.array([coordinate(number(each, f"{inner}.{axis}")) for each in poses]) for axis in "xy")
    is_line = inner.startswith("pose.")
    return _Layer(
        _frame(message), "─" if is_line else "·", x=x, y=y, is_line=is_line, style="path", note=f"{len(x)} poses"
    )


def _polygon(message: Message, _topic: str) -> _Layer:
    points = elements(message, "polygon.points")[:POSES]
    points = [*points, *points[:1]]
    x, y = (np.array([coordinate(number(each, axis)) for each in points]) for axis in "xy")
    return _Layer(_frame(message), "□", x=x, y=y, is_line=True, style="robot")


def _odometry(message: Message, _topic: str) -> _Layer:
    robot = text(message, "child_frame_id").removeprefix("/")
    return _Layer(_frame(message), _ARROWS[0], pose=pose(message, "pose.pose"), robot=robot, style="robot")


def _goal(message: Message, _topic: str) -> _Layer:
    return _Layer(_frame(message), _GOAL, pose=pose(message, "pose"), style="goal")


def _scan(message: Message, _topic: str) -> _Layer:
    points = (scan_points if "ranges" in message else cloud_points)(message)
    return _Layer(_frame(message), "•", x=points.x.astype(float), y=points.y.astype(float), style="scan")


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


def _extent(placed: Iterable[_Placed], marked: list[tuple[Floats, Floats]]) -> tuple[float, float, float, float] | None:
    """Return left, bottom, right and top of what is fitted: the grids, or everything if there is no grid."""
    grids = [(layer.grid, place) for _, layer, place in placed if layer.grid is not None]
    found = [place.apply(*grid.known) for grid, place in grids]
    if not grids:
        found += marked
    for _, layer, place in [] if grids else placed:
        if layer.pose is not None:
            x, y = layer.pose.x + np.array([-2.0, 2.0]), layer.pose.y + np.array([-2.0, 2.0])
        else:
            x, y = layer.x, layer.y
        found.append(place.apply(x, y))
    # The empty ones, because numpy refuses to concatenate nothing.
    x, y = (np.concatenate([*(each[axis] for each in found), np.empty(0)]) for axis in (0, 1))
    valid = np.isfinite(x) & np.isfinite(y)
    if not valid.any():
        return None
    x, y = x[valid], y[valid]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _draw_points(canvas: Canvas, paper: _Paper, layer: _Layer, place: Transform) -> None:
    x, y = place.apply(layer.x, layer.y)
    if layer.is_line:
        ends = [paper.dot(each_x, each_y) for each_x, each_y in zip(x, y, strict=True)]
        for start, end in itertools.pairwise(ends):
            canvas.line(*start, *end, layer.style)
    else:
        put_dots(canvas, *paper.dots(x, y), layer.style)


def _draw_pose(canvas: Canvas, paper: _Paper, at: Transform, style: str) -> None:
    across, down = paper.dot(at.x, at.y)
    length = 3 * Canvas.DOWN * canvas.fine
    tip = round(across + length * math.cos(at.yaw)), round(down - length * math.sin(at.yaw))
    canvas.line(across, down, *tip, style)
    mark = _ARROWS[round(at.yaw / (math.pi / 2)) % 4] if style == "robot" else _GOAL
    half = canvas.fine // 2
    canvas.write(across // Canvas.ACROSS - half, down // Canvas.DOWN - half, mark, style)
