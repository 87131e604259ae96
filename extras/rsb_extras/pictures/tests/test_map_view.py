"""Layers of a map, each in its own frame."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from sensor_msgs.msg import LaserScan
from tests.support.wording import has_text

from rsb_bridge.cdr.decoder import Items, Message
from rsb_extras.pictures.drawing import Canvas, Drawn, TakenMessage
from rsb_extras.pictures.map_view import MapProblem, MapView, Transform
from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.tests.samples import cells_of, task
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
    """Return the rows in which each style is."""
    cells, at = cells_of(of), 0
    found: dict[str, list[int]] = {}
    for row, text in enumerate(cells.rows):
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
    scan = LaserScan(angle_min=0.0, angle_increment=0.01, range_min=0.1, range_max=9.0, ranges=[2.0] * 3)
    scan.header.frame_id = "base_link"
    result = picture(grid(), odometry, scan)
    assert result.problem == ""
    cells = cells_of(result)
    assert cells.scale is not None
    row = styles(result)["scan"][0]
    assert abs(cells.scale.top - (row + 0.5) * cells.scale.row - 2.0) < 1.0


def test_frame_of_tf_is_not_moved_by_odometry() -> None:
    view = MapView()
    transform: Message = {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"}
    shown: tuple[tuple[str, Message], ...] = (
        ("tf2_msgs/msg/TFMessage", {"transforms": Items("", 1, [transform])}),
        ("nav_msgs/msg/Odometry", {"header": {"frame_id": "other"}, "child_frame_id": "base_link"}),
        ("geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "base_link"}}),
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
    assert has_text(picture(message).problem, MapProblem.BAD_GRID)


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
    assert found.keys() == {"free", "occupied", "axis"}
    assert max(found["occupied"]) <= max(found["free"]) + 1, "below are the unknown ones"


def test_repeated_path_is_drawn_in_bounded_time() -> None:
    canvas = Canvas(400, 150)
    for _ in range(5000):
        canvas.line(0, 0, 799, 599, "path")
    assert canvas.dots[0]
    assert canvas.dots[-1]
    before = bytes(canvas.dots)
    canvas.line(0, 599, 799, 0, "path")
    assert sum(a != b for a, b in zip(before, bytes(canvas.dots), strict=True)) <= 2  # its ends
