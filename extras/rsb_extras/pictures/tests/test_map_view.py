"""Layers of a map, each in its own frame."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from sensor_msgs.msg import LaserScan
from tests.support.held import held_by
from tests.support.wording import has_text

from rsb_bridge.cdr.decoder import Items, Message
from rsb_extras.pictures.drawing import Canvas, Drawn, TakenMessage
from rsb_extras.pictures.grids import GridProblem
from rsb_extras.pictures.map_view import MapProblem, MapView
from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.tests.samples import cells_of, task
from rsb_extras.pictures.transforms import FrameTree, Transform
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=40, height=20)


def picture(*messages: Any, wish: Wish = WISH) -> Picture:
    """Return the picture of messages, each on a topic of its own."""
    artist, result = Artist(), None
    first = task(wish, messages[0])
    for at, message in enumerate(messages):
        wanted = task(wish, message, topic=f"/topic{at}")
        result = artist.do(msgspec.structs.replace(wanted, type_name=first.type_name))
    assert result is not None
    return result


def grid(side: int = 100, resolution: float = 0.1) -> OccupancyGrid:
    """Return a free square around the origin with one occupied row at its upper edge."""
    message = OccupancyGrid()
    message.header.frame_id = "map"
    message.info.width = message.info.height = side
    message.info.resolution = resolution
    message.info.origin.position.x = message.info.origin.position.y = -side * resolution / 2
    message.data = [0] * (side * (side - 1)) + [100] * side
    return message


def pose(x: float, y: float, yaw: float, kind: type = PoseStamped, frame: str = "map") -> Any:
    message = kind()
    message.header.frame_id = frame
    at = message.pose.pose if kind is Odometry else message.pose
    at.position.x, at.position.y = x, y
    at.orientation.z, at.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return message


def place(of: Picture, mark: str) -> tuple[float, float]:
    """Return the map's coordinates of a character."""
    cells = cells_of(of)
    assert cells.scale is not None
    row = next(at for at, text in enumerate(cells.rows) if mark in text)
    column = cells.rows[row].index(mark)
    scale = cells.scale
    return scale.left + (column + 0.5) * scale.column, scale.top - (row + 0.5) * scale.row


def styles(of: Picture | Drawn) -> dict[str, list[int]]:
    """Return the rows in which each style is, without the row of the legend."""
    cells, at = cells_of(of), 0
    found: dict[str, list[int]] = {}
    for row, text in enumerate(cells.rows[:-1]):
        for character, style in zip(text, cells.styles[at : at + len(text)], strict=True):
            if character != " ":
                found.setdefault(cells.palette[style], []).append(row)
        at += len(text)
    return found


def test_occupied_row_is_drawn_once_and_at_top() -> None:
    found = styles(picture(grid()))
    assert len(set(found["occupied"])) <= 2
    assert max(found["occupied"]) < min(found["free"]) + 2


def test_thin_wall_of_large_grid_is_seen() -> None:
    assert "occupied" in styles(picture(grid(2000, 0.05)))


@pytest.mark.parametrize(
    ("yaw", "mark", "kind"),
    [
        (0.0, "▶", Odometry),
        (math.pi / 2, "▲", Odometry),
        (math.pi, "◀", Odometry),
        (-math.pi / 2, "▼", Odometry),
        (0.0, "◆", PoseStamped),
    ],
)
def test_robot_heading_and_goal_are_in_place(yaw: float, mark: str, kind: type) -> None:
    assert place(picture(grid(), pose(2.0, -1.0, yaw, kind)), mark) == pytest.approx((2.0, -1.0), abs=0.5)


def test_a_scan_goes_along_with_the_robot() -> None:
    odometry = pose(2.0, 0.0, math.pi / 2, Odometry)
    odometry.child_frame_id = "base_link"
    scan = LaserScan(angle_min=0.0, angle_increment=0.01, range_min=0.1, range_max=9.0, ranges=[4.0] * 3)
    scan.header.frame_id = "base_link"
    result = picture(grid(), odometry, scan)
    assert result.problem == ""
    cells = cells_of(result)
    assert cells.scale is not None
    row = styles(result)["scan"][0]
    assert abs(cells.scale.top - (row + 0.5) * cells.scale.row - 4.0) < 1.0


def test_frame_of_tf_is_not_moved_by_odometry() -> None:
    view = MapView()
    transform: Message = {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"}
    shown: tuple[tuple[str, Message], ...] = (
        ("tf2_msgs/msg/TFMessage", {"transforms": Items("", 1, [transform])}),
        ("nav_msgs/msg/Odometry", {"header": {"frame_id": "other"}, "child_frame_id": "base_link"}),
        (
            "geometry_msgs/msg/PoseStamped",
            {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 1, "y": 1}}},
        ),
    )
    for type_name, message in shown:
        view.receive(TakenMessage(f"/{type_name}", type_name, message, 1.0))
    assert "goal" in styles(view.draw(msgspec.structs.replace(WISH, frame="odom")))


def test_a_layer_without_a_transform_is_named() -> None:
    scan = LaserScan(angle_increment=0.1, range_max=9.0, ranges=[2.0] * 9)
    scan.header.frame_id = "laser"
    result = picture(grid(), scan)
    assert result.content is not None
    assert has_text(result.problem, MapProblem.NO_TRANSFORM)


def test_a_path_is_a_line() -> None:
    path = Path(poses=[pose(0.0, 0.0, 0.0), pose(4.0, 0.0, 0.0)])
    path.header.frame_id = "map"
    assert len(styles(picture(grid(), path))["path"]) >= 10


def test_a_grid_whose_size_is_a_lie() -> None:
    message = grid()
    message.info.width = 2**31
    assert has_text(picture(message).problem, GridProblem.BAD_GRID)


def test_zoom_shows_less() -> None:
    wide, narrow = (cells_of(picture(grid(), wish=Wish(width=40, height=20, zoom=zoom))).scale for zoom in (1.0, 4.0))
    assert wide is not None
    assert narrow is not None
    assert wide.column == pytest.approx(4 * narrow.column)


def test_transforms() -> None:
    there = Transform(1.0, 2.0, math.pi / 2)
    assert there.apply(1.0, 0.0) == pytest.approx((1.0, 3.0))
    assert there.inverse().after(there) == pytest.approx(Transform())
    assert there.after(Transform(1.0, 0.0, 0.0)) == pytest.approx(Transform(1.0, 3.0, math.pi / 2))


def test_unknown_cells_of_a_costmap_are_not_occupied() -> None:
    cells = Items("uint8", 4, raw=memoryview(bytes([255, 255, 0, 254])), code="<B")
    view = MapView()
    message: Message = {"metadata": {"size_x": 2, "size_y": 2, "resolution": 1.0}, "data": cells}
    view.receive(TakenMessage("/c", "nav2_msgs/msg/Costmap", message, 1.0))
    found = styles(view.draw(WISH))
    assert {"free", "lethal"} <= found.keys()
    assert max(found["lethal"]) <= max(found["free"]) + 1, "below are the unknown ones"


def test_repeated_path_is_drawn_in_bounded_time() -> None:
    canvas = Canvas(400, 150)
    for _ in range(5000):
        canvas.line(0, 0, 799, 599, "path")
    assert canvas.dots[0]
    assert canvas.dots[-1]
    before = bytes(canvas.dots)
    canvas.line(0, 599, 799, 0, "path")
    assert sum(a != b for a, b in zip(before, bytes(canvas.dots), strict=True)) <= 2  # its ends


# -- the ground


def tints(of: Picture | Drawn) -> dict[str, set[int]]:
    """Return the columns of the middle row in which each tint is."""
    cells = cells_of(of)
    middle, width = len(cells.rows) // 2, len(cells.rows[0])
    row = cells.backgrounds[middle * width : (middle + 1) * width]
    found: dict[str, set[int]] = {}
    for column, tint in enumerate(row):
        found.setdefault(cells.palette[tint], set()).add(column)
    return found


def test_free_and_unknown_ground_differ() -> None:
    message = grid()
    message.data = [0 if at % 100 < 50 else -1 for at in range(10_000)]
    message.data[99] = 0  # so that all of it is known
    found = tints(picture(message))
    assert found["free"] == set(range(min(found["free"]), 20))
    assert found["unknown"] >= set(range(20, 40))


@pytest.mark.parametrize("turned", [0.0, 0.02, math.pi / 2])
def test_wall_of_one_cell_is_whole(turned: float) -> None:
    message = grid(2000, 0.01)
    message.info.origin.orientation.z, message.info.origin.orientation.w = math.sin(turned / 2), math.cos(turned / 2)
    message.data = [100 if at // 2000 == 1000 else 0 for at in range(4_000_000)]
    cells = cells_of(picture(message))
    walls = sum(cells.palette[style] == "occupied" for style in cells.styles[: -len(cells.rows[-1])])
    assert walls >= (8 if turned > 1 else 16), "cells of a grid of 20 m in a square picture of 20 rows"


def test_walls_are_drawn_by_quarters() -> None:
    message = grid(4, 1.0)
    message.data = [100 if at in (0, 5) else 0 for at in range(16)]
    shown = "".join(cells_of(picture(message, wish=Wish(width=2, height=4, zoom=1.1))).rows)
    assert set(shown) & set("▖▘▝▗▞▚▄▀▌▐")


def costs(values: list[int], topic: str) -> set[str]:
    """Return the tints of a row of values."""
    message = OccupancyGrid(data=values)
    message.header.frame_id = "map"
    message.info.width, message.info.height, message.info.resolution = len(values), 1, 1.0
    result = Artist().do(task(Wish(width=4 * len(values), height=8), message, topic=topic))
    assert result is not None
    cells = cells_of(result)
    return {cells.palette[each] for each in (*cells.backgrounds, *cells.styles)}


def test_costs_are_told_by_topic_or_values() -> None:
    values = [0, 0, 0, 0, 0, 0, 10, 90, 99, 100]
    as_map, by_name = costs([0, 0, 40, 50, 60, 70], "/map"), costs([0, 0, 40, 50, 60, 70], "/local_costmap/costmap")
    assert not any("#" in each for each in as_map)
    assert any("#" in each for each in by_name)
    assert {"lethal", "#00ffff", "#0000ff", "#ff0000"} <= costs(values, "/anything")


@pytest.mark.parametrize(("cost", "named"), [(99, True), (90, False)])
def test_bright_band_beside_obstacle_is_named(cost: int, named: bool) -> None:
    message = grid()
    message.data = [0] * 5000 + [cost] * 1000 + [100] * 100 + [0] * 3900
    wish = Wish(width=100, height=20)
    assert ("■ inscribed" in cells_of(picture(message, wish=wish)).rows[-1]) == named


def test_costs_leave_walls_of_map_in_sight() -> None:
    wall, cost = grid(), grid()
    cost.data = [0] * 5000 + [100] * 5000
    both = MapView()
    for topic, message in (("/map", wall), ("/costmap", cost)):
        info = {"width": 100, "height": 100, "resolution": 0.1, "origin": {"position": {"x": -5.0, "y": -5.0}}}
        values = Items("int8", 10_000, raw=memoryview(bytes(each % 256 for each in message.data)), code="<b")
        decoded: Message = {"header": {"frame_id": "map"}, "info": info, "data": values}  # type: ignore[dict-item]
        both.receive(TakenMessage(topic, "nav_msgs/msg/OccupancyGrid", decoded, 1.0))
    over = styles(both.draw(WISH))
    assert {"lethal", "occupied"} <= over.keys()
    assert over["occupied"] == styles(picture(wall))["occupied"]


def test_ground_goes_on_behind_dots() -> None:
    cells = cells_of(picture(grid(), path([(-4.0, 0.0), (4.0, 0.0)])))
    behind = {
        cells.palette[background]
        for style, background in zip(cells.styles, cells.backgrounds, strict=True)
        if cells.palette[style] == "path" and background
    }
    assert behind == {"free"}


def path(points: list[tuple[float, float]]) -> Path:
    message = Path(poses=[pose(x, y, 0.0) for x, y in points])
    message.header.frame_id = "map"
    return message


def test_legend_names_topics_as_room_allows() -> None:
    messages = grid(), path([(0.0, 0.0), (1.0, 1.0)])
    wide, narrow, low = (
        picture(*messages, wish=Wish(width=width, height=height)) for width, height in ((100, 20), (24, 20), (24, 3))
    )
    assert "/topic0" in cells_of(wide).rows[-1]
    assert "/topic1" in cells_of(wide).rows[-1]
    assert "…" in cells_of(narrow).rows[-1]
    assert "topic" not in cells_of(low).rows[-1]


def test_topics_of_one_name_differ_in_legend() -> None:
    view, path = MapView(), Items("", 0)
    for topic in ("/local/plan", "/global/plan"):
        view.receive(TakenMessage(topic, "nav_msgs/msg/Path", {"header": {"frame_id": "map"}, "poses": path}, 1.0))
    view.receive(TakenMessage("/goal", "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "map"}}, 1.0))
    legend = cells_of(view.draw(Wish(width=56, height=20))).rows[-1]
    assert {"local", "global", "goal"} <= set(legend.split())


# -- robots and frames


def frame(child: str, parent: str, x: float = 0.0, *, topic: str = "/tf", asked: bool = False) -> TakenMessage:
    transform: Message = {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": 5.0}},
    }
    return TakenMessage(topic, "tf2_msgs/msg/TFMessage", {"transforms": Items("", 1, [transform])}, 1.0, is_asked=asked)


def on_grid(*received: TakenMessage) -> MapView:
    view = MapView()
    cells = Items("int8", 100, raw=memoryview(bytes(100)), code="<b")
    info: Message = {"width": 10, "height": 10, "resolution": 1.0}
    message: Message = {"header": {"frame_id": "map"}, "info": info, "data": cells}
    view.receive(TakenMessage("/map", "nav_msgs/msg/OccupancyGrid", message, 1.0))
    for each in received:
        view.receive(each)
    return view


def shown(view: MapView) -> str:
    return "\n".join(cells_of(view.draw(Wish(width=60, height=20))).rows)


def test_robot_is_drawn_where_frames_have_it() -> None:
    without, with_it = shown(on_grid()), shown(on_grid(frame("odom", "map"), frame("base_link", "odom", 5.0)))
    assert "▶" not in without
    assert "▶" in with_it
    two = on_grid(frame("a/base_link", "map", 2.0), frame("b/base_link", "map", 8.0), frame("b/base_footprint", "map"))
    assert shown(two).count("▶") == 4, "each on the map, and in the legend"


def test_robot_of_frames_is_not_drawn_twice() -> None:
    odometry: Message = {"header": {"frame_id": "map"}, "child_frame_id": "base_link", "pose": {"pose": {}}}
    view = on_grid(frame("base_link", "map", 5.0), TakenMessage("/odom", "nav_msgs/msg/Odometry", odometry, 1.0))
    assert shown(view).count("▶") == 2


def turning(*poses: tuple[float, float]) -> FrameTree:
    """Return the frames of a robot with its headings at some times."""
    tree = FrameTree()
    for stamp, yaw in poses:
        tree.add("base_link", "map", Transform(yaw=yaw), stamp, stamp)
    return tree


@pytest.mark.parametrize(
    ("stamp", "yaw"),
    [(10.1, 0.5), (10.3, 2.0), (10.5, math.pi), (9.9, 0.0), (0.0, -3.0), (99.0, -3.0), (5.0, -3.0)],
)
def test_layer_is_placed_by_its_own_time(stamp: float, yaw: float) -> None:
    """A scan is older than the newest transform, and the robot turns meanwhile."""
    tree = turning((10.0, 0.0), (10.2, 1.0), (10.4, 3.0), (10.6, -3.0))
    found = tree.place("base_link", "map", stamp)
    assert found is not None
    assert math.remainder(found.yaw - yaw, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_poses_of_frame_are_bounded() -> None:
    assert held_by(turning(*((float(at), 1.0) for at in range(1000)))) <= 101


def test_times_that_go_back_begin_anew() -> None:
    assert turning((900.0, 1.0), (1.0, 0.0)).place("base_link", "map", 900.0) == pytest.approx(Transform())


def test_names_of_frames_are_shown_if_asked_for() -> None:
    assert "·laser" not in shown(on_grid(frame("laser", "map", 5.0)))
    assert "·laser" in shown(on_grid(frame("laser", "map", 5.0, asked=True)))


def test_names_of_frames_leave_the_robot_in_sight() -> None:
    """A frame a little behind the robot has its dot where the robot's arrow is."""
    behind = (frame(f"laser{number}", "map", 5.0 - number * 0.05, asked=True) for number in range(9))
    assert shown(on_grid(frame("base_link", "map", 5.0), *behind)).count("▶") == 2, "on the map, and in the legend"


def test_robot_whose_transform_is_old_is_named() -> None:
    view = on_grid(frame("base_link", "map"))
    fresh = view.draw(WISH)
    view.now = 60.0
    old = view.draw(WISH)
    assert not any(has_text(note, MapProblem.OLD) for note in fresh.notes)
    assert any(has_text(note, MapProblem.OLD, frame="base_link") for note in old.notes)
    static = on_grid(frame("base_link", "map", topic="/tf_static"))
    static.now = 60.0
    assert not any(has_text(note, MapProblem.OLD) for note in static.draw(WISH).notes)
