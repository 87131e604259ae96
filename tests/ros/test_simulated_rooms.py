"""The demo's rooms: what a laser measures in them, their map and costs, and what a camera sees."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from rsb_bridge.ros.simulation.room_camera import EYE, FIELD, room_picture
from rsb_bridge.ros.simulation.rooms import (
    CEILING,
    FREE,
    OCCUPIED,
    RADIUS,
    RESOLUTION,
    TOUR,
    UNKNOWN,
    Box,
    cell_of,
    clearance,
    costs,
    crossings,
    edges_of,
    is_free,
    measured_ranges,
    occupancy,
)
from rsb_bridge.ros.simulation.textures import furniture

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDTH, HEIGHT = 320, 240
BOX = edges_of([Box(2.0, -1.0, 3.0, 1.0)])


@pytest.mark.parametrize(
    ("angle", "enters", "leaves"),
    [
        (0.0, 2.0, 3.0),
        (math.atan2(0.5, 2.0), math.hypot(2.0, 0.5), math.hypot(3.0, 0.75)),
        (math.atan2(1.0, 2.5), math.hypot(2.0, 0.8), math.hypot(2.5, 1.0)),
        (math.pi / 2, math.inf, None),
        (math.pi, math.inf, None),
    ],
)
def test_ray_crosses_box(angle: float, enters: float, leaves: float | None) -> None:
    rays = np.array([[math.cos(angle), math.sin(angle)]])
    near, far, _ = crossings(0.0, 0.0, rays, BOX)
    assert near[0, 0] == pytest.approx(enters)
    assert leaves is None or far[0, 0] == pytest.approx(leaves)


def test_laser_measures_walls_of_hall() -> None:
    ranges = measured_ranges(1.5, 0.1, np.array([0.0, math.pi / 2, -math.pi / 2, math.pi]))
    assert ranges == pytest.approx([6.5, 1.0, 1.2, 9.5])


@pytest.mark.parametrize("pose", TOUR)
def test_measured_points_are_occupied(pose: tuple[float, float, float]) -> None:
    angles = np.linspace(-math.pi, math.pi, 360)
    ranges = measured_ranges(*pose[:2], angles)
    points = np.stack([pose[0] + ranges * np.cos(angles), pose[1] + ranges * np.sin(angles)], axis=1)
    for x, y in points:
        row, column = cell_of(x, y)
        assert OCCUPIED in occupancy()[row - 1 : row + 2, column - 1 : column + 2]


@pytest.mark.parametrize(
    ("place", "value"), [((0.0, 0.0), FREE), ((2.5, 4.0), OCCUPIED), ((8.5, 0.0), UNKNOWN), ((-6.0, 5.0), OCCUPIED)]
)
def test_map_shows_rooms(place: tuple[float, float], value: int) -> None:
    assert occupancy()[cell_of(*place)] == value


def test_costs_fall_with_distance() -> None:
    beside_wall = [int(costs()[cell_of(1.5, y)]) for y in np.arange(1.12, 0.0, -RESOLUTION)]
    assert beside_wall[0] == OCCUPIED
    assert beside_wall == sorted(beside_wall, reverse=True)
    assert beside_wall[-1] == FREE
    assert 99 in beside_wall
    assert costs()[cell_of(9.0, 0.0)] == UNKNOWN


def test_cheap_places_are_free() -> None:
    """Where a robot fits by the costs, it fits among the boxes, up to a cell."""
    rows, columns = np.nonzero((costs() >= 0) & (costs() < 99))
    for row, column in zip(rows[::7], columns[::7], strict=True):
        x, y = ((at + 0.5 - len(costs()) / 2) * RESOLUTION for at in (column, row))
        assert is_free(x, y, RADIUS - 1.5 * RESOLUTION)


def test_clearance_is_distance_to_obstacle() -> None:
    assert clearance()[cell_of(1.5, 0.62)] == pytest.approx(1.1 - 0.62, abs=RESOLUTION)


def is_near(picture: NDArray[np.uint8], look: str) -> NDArray[np.bool_]:
    """Whether each pixel has the hue of a piece of furniture's commonest colour."""
    colour = int(np.median(furniture(look)))
    wanted = np.array([colour >> 16, colour >> 8 & 0xFF, colour & 0xFF], float)
    pixels = picture.astype(float) + 1
    likeness = (pixels / np.linalg.norm(pixels, axis=2)[:, :, None]) @ (wanted / np.linalg.norm(wanted))
    found: NDArray[np.bool_] = likeness > 0.995
    return found


@pytest.mark.parametrize("distance", [2.0, 2.5, 3.0, 3.5])
def test_foot_of_wall_obeys_perspective(distance: float) -> None:
    """The brown board of a blue wall ends as far below the horizon as the distance says."""
    column = room_picture(2.575 + distance, 3.4, math.pi, WIDTH, HEIGHT)[:, WIDTH // 2].astype(float)
    foot = HEIGHT / 2 + EYE * WIDTH / 2 / FIELD / distance
    board = column[:, 0] > column[:, 2] + 10  # all else is rather blue
    assert np.flatnonzero(board[HEIGHT // 2 :]).max() + HEIGHT // 2 == pytest.approx(min(foot, HEIGHT), abs=4)


def test_crate_is_where_it_stands() -> None:
    picture = is_near(room_picture(2.2, -2.5, -math.pi / 2, WIDTH, HEIGHT), "orange crate")
    columns = np.flatnonzero(picture.sum(axis=0) > 20)  # a rack's boards in the next room have the same colour
    focal, depth = WIDTH / 2 / FIELD, 4.4 - 2.5
    assert len(columns) == pytest.approx(0.6 / depth * focal, rel=0.1)
    assert columns.mean() == pytest.approx(WIDTH / 2, abs=3)


def test_nearer_crate_looks_larger() -> None:
    far, near = (is_near(room_picture(2.2, y, -math.pi / 2, WIDTH, HEIGHT), "orange crate").sum() for y in (-2.0, -2.9))
    assert near > 1.5 * far > 100


def test_wall_hides_what_is_behind() -> None:
    assert not is_near(room_picture(2.2, 0.0, -math.pi / 2, WIDTH, HEIGHT), "orange crate").any()


def test_goal_stands_in_picture() -> None:
    empty, with_goal = (room_picture(0.0, 0.0, 0.0, WIDTH, HEIGHT, goal) for goal in (None, (2.0, 0.5)))
    columns = np.flatnonzero((empty != with_goal).any(axis=(0, 2)))
    assert columns.mean() == pytest.approx(WIDTH / 2 - 0.5 / 2.0 * WIDTH / 2 / FIELD, abs=4)


def test_ceiling_is_above_floor() -> None:
    picture = room_picture(-5.5, -2.6, 0.5, WIDTH, HEIGHT).astype(float)
    assert CEILING > EYE
    assert picture[:20].mean() > picture[-20:].mean()
