"""Markers on a map: their shapes, their lives, and their limits."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from tests.support.wording import has_text
from visualization_msgs.msg import Marker, MarkerArray

from rsb_extras.pictures.drawing import TakenMessage
from rsb_extras.pictures.map_view import MapProblem, MapView
from rsb_extras.pictures.markers import MOST_MARKERS, Markers
from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.tests.samples import cells_of, task
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=40, height=20)


def marker(kind: int, *points: tuple[float, float], number: int = 1, **about: Any) -> Marker:
    message = Marker(type=kind, id=number, **about)
    message.header.frame_id = "map"
    message.scale.x = message.scale.y = 2.0
    message.pose.orientation.w = 1.0
    message.color = ColorRGBA(r=1.0, a=1.0)
    message.points = [Point(x=x, y=y) for x, y in points]
    return message


def picture(*messages: Any, now: float = 1000.0, artist: Artist | None = None) -> Picture:
    wanted = msgspec.structs.replace(task(WISH, *messages), now=int(now * 1e9))
    result = (artist or Artist()).do(wanted)
    assert result is not None
    return result


def coloured(of: Picture) -> dict[str, int]:
    """Return the number of cells of each colour."""
    cells = cells_of(of)
    names = [cells.palette[style] for style in cells.styles]
    return {name: names.count(name) for name in names if name.startswith("#")}


FRAME = marker(Marker.LINE_STRIP, (0.0, 0.0), (9.0, 0.0), (9.0, 9.0), number=99)


@pytest.mark.parametrize(
    "kind",
    [Marker.ARROW, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.MESH_RESOURCE],
)
def test_shapes_are_at_their_pose(kind: int) -> None:
    assert coloured(picture(marker(kind)))["#ff0000"] >= 1


@pytest.mark.parametrize(
    "kind",
    [Marker.LINE_STRIP, Marker.LINE_LIST, Marker.POINTS, Marker.CUBE_LIST, Marker.TRIANGLE_LIST],
)
def test_shapes_of_points(kind: int) -> None:
    few, many = (
        sum(coloured(picture(FRAME, marker(kind, *points))).values())
        for points in ([], [(1.0, 5.0), (4.0, 5.0), (4.0, 8.0), (2.0, 8.0)])
    )
    assert many > few


def test_text_is_shown_in_its_colour() -> None:
    text = marker(Marker.TEXT_VIEW_FACING, text="dock\x1b[2J\nmore")
    result = picture(FRAME, text)
    assert any("dock\N{REPLACEMENT CHARACTER}[2J" in row for row in cells_of(result).rows)
    assert not any("more" in row for row in cells_of(result).rows)


def test_points_have_colours_of_their_own() -> None:
    points = marker(Marker.POINTS, (1.0, 1.0), (5.0, 5.0))
    points.colors = [ColorRGBA(g=1.0), ColorRGBA(b=1.0)]
    assert {"#00ff00", "#0000ff"} <= coloured(picture(FRAME, points)).keys()


def test_any_colours_are_a_few_styles() -> None:
    points = marker(Marker.POINTS, *[(at / 100, at % 7) for at in range(1000)])
    points.colors = [ColorRGBA(r=at / 1000, g=at % 100 / 100, b=at % 17 / 17) for at in range(1000)]
    assert 8 < len(cells_of(picture(points)).palette) <= 80


def test_same_id_replaces_and_delete_removes() -> None:
    artist = Artist()
    first = picture(FRAME, marker(Marker.CUBE), artist=artist)
    moved = marker(Marker.CUBE)
    moved.color = ColorRGBA(b=1.0)
    second = picture(moved, artist=artist)
    third = picture(marker(Marker.CUBE, action=Marker.DELETE), artist=artist)
    assert "#0000ff" not in coloured(first)
    assert "#0000ff" in coloured(second)
    assert "#0000ff" not in coloured(third)
    assert "#ff0000" in coloured(third), "the other one stays"
    last = picture(MarkerArray(markers=[marker(Marker.CUBE, action=Marker.DELETEALL)]), artist=artist)
    assert last.content is None


def test_a_marker_lives_as_long_as_it_says() -> None:
    short = marker(Marker.CUBE)
    short.lifetime.sec = 2
    short.color = ColorRGBA(g=1.0)
    artist = Artist()
    alive = picture(FRAME, short, now=1001.0, artist=artist)
    gone = artist.do(msgspec.structs.replace(task(WISH, FRAME), now=1010 * 10**9, samples=()))
    assert gone is not None
    assert "#00ff00" in coloured(alive)
    assert "#00ff00" not in coloured(gone)


def test_marker_without_transform_is_named() -> None:
    lost = marker(Marker.CUBE, number=2)
    lost.header.frame_id = "moon"
    result = picture(FRAME, lost)
    assert has_text(result.problem, MapProblem.NO_TRANSFORM)
    assert result.content is not None


def test_markers_are_bounded() -> None:
    markers, view = Markers(), MapView()
    for at in range(2 * MOST_MARKERS):
        taken = TakenMessage("/m", "visualization_msgs/msg/Marker", {"id": at, "ns": "n"}, 1.0)
        markers.receive(taken)
        view.receive(taken)
    assert len(markers) == MOST_MARKERS
    assert view.draw(WISH).content is not None
