"""The rooms that the simulated robot drives through, as boxes: where it fits, what its laser measures, and its map.

Lengths are in m, and the origin is in the middle. Boxes stand along the axes.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

Floats: TypeAlias = "NDArray[np.floating[Any]]"
LEFT, RIGHT, BOTTOM, TOP = -8.0, 8.0, -6.0, 6.0
CEILING = 2.5
DOOR_HEIGHT = 2.05
_THICK, _DOOR, _FRAME = 0.075, 0.6, 0.05
"""Half of a wall's thickness and of a door's width, and the width of a door's frame."""
RADIUS = 0.3
"""Of the robot."""
LASER_HEIGHT, _TALL = 0.25, 1.3
"""Height of the laser, and of the robot."""
SIDE, RESOLUTION = 384, 0.05
"""Cells of the map's side, about the size of the thesis's table 3.1, and m a cell."""
OCCUPIED, FREE, UNKNOWN = 100, 0, -1
_INSCRIBED = 99
_INFLATION, _FALLS = 0.8, 6.0
"""Distance up to which an obstacle costs, and how fast the costs fall with it (1/m)."""


class Box(NamedTuple):
    """A wall or a piece of furniture.

    Attributes:
        low: height of its lower side.
        high: height of its upper side.
        look: name of what is on its sides (`rsb_extras.demo.textures`).
    """

    left: float
    bottom: float
    right: float
    top: float
    high: float = CEILING
    look: str = "wall"
    low: float = 0.0


class Room(NamedTuple):
    """A room, and the names of its wall and its floor."""

    left: float
    bottom: float
    right: float
    top: float
    wall: str
    floor: str


class Waypoint(NamedTuple):
    """A pose that the robot visits."""

    x: float
    y: float
    heading: float


ROOMS = (
    Room(-8.0, -1.175, 8.0, 1.175, "cream", "stone"),
    Room(-8.0, 1.175, -2.5, 6.0, "sand", "planks"),
    Room(-2.5, 1.175, 2.5, 6.0, "mint", "tiles"),
    Room(2.5, 1.175, 8.0, 6.0, "blue", "carpet"),
    Room(-8.0, -6.0, -3.0, -1.175, "rose", "planks"),
    Room(-3.0, -6.0, 3.0, -1.175, "grey", "concrete"),
    Room(3.0, -6.0, 8.0, -1.175, "grey", "concrete"),
)
_HALL_DOORS = ((1.175, (-5.2, 0.0, 5.2)), (-1.175, (-5.5, 0.8, 5.5)))
_ROOM_DOORS = ((-2.5, 1.25, 6.0, 3.0), (2.5, 1.25, 6.0, 2.6), (3.0, -6.0, -1.25, -3.6), (-3.0, -6.0, -1.25, None))
"""Walls across: x, lower and upper end, and the middle of the door, if there is one."""
DOCK = Waypoint(6.25, -5.2, 1.2)
TOUR = (
    Waypoint(-6.0, 0.0, 0.0),
    Waypoint(-4.6, 3.4, 2.7),
    Waypoint(-1.0, 3.4, 0.9),
    Waypoint(4.6, 3.6, 0.3),
    Waypoint(5.2, 0.0, math.pi),
    DOCK,
    Waypoint(0.8, -3.0, -2.4),
    Waypoint(0.0, 0.0, math.pi),
    Waypoint(-5.2, -3.0, -2.2),
)
"""The robot begins at the first place."""


def _outer_walls() -> Iterator[Box]:
    thick = 0.2
    yield Box(LEFT - thick, BOTTOM - thick, RIGHT + thick, BOTTOM)
    yield Box(LEFT - thick, TOP, RIGHT + thick, TOP + thick)
    yield Box(LEFT - thick, BOTTOM, LEFT, TOP)
    yield Box(RIGHT, BOTTOM, RIGHT + thick, TOP)


def _inner_walls() -> Iterator[Box]:
    for y, doors in _HALL_DOORS:
        begin = LEFT
        for door in (*doors, math.inf):
            end = min(door - _DOOR, RIGHT)
            yield Box(begin, y - _THICK, end, y + _THICK)
            begin = door + _DOOR
    for x, bottom, top, middle in _ROOM_DOORS:
        if middle is None:
            yield Box(x - _THICK, bottom, x + _THICK, top)
        else:
            yield Box(x - _THICK, bottom, x + _THICK, middle - _DOOR)
            yield Box(x - _THICK, middle + _DOOR, x + _THICK, top)


def _door_frames() -> Iterator[Box]:
    deep = _THICK + 0.02
    for y, doors in _HALL_DOORS:
        for x in doors:
            yield Box(x - _DOOR, y - deep, x - _DOOR + _FRAME, y + deep, DOOR_HEIGHT, "frame")
            yield Box(x + _DOOR - _FRAME, y - deep, x + _DOOR, y + deep, DOOR_HEIGHT, "frame")
            yield Box(x - _DOOR, y - _THICK, x + _DOOR, y + _THICK, CEILING, "lintel", DOOR_HEIGHT)
    for x, _, _, door in _ROOM_DOORS:
        if door is not None:
            yield Box(x - deep, door - _DOOR, x + deep, door - _DOOR + _FRAME, DOOR_HEIGHT, "frame")
            yield Box(x - deep, door + _DOOR - _FRAME, x + deep, door + _DOOR, DOOR_HEIGHT, "frame")
            yield Box(x - _THICK, door - _DOOR, x + _THICK, door + _DOOR, CEILING, "lintel", DOOR_HEIGHT)


def _plant(x: float, y: float) -> Iterator[Box]:
    yield Box(x - 0.15, y - 0.15, x + 0.15, y + 0.15, 0.4, "pot")
    yield Box(x - 0.24, y - 0.24, x + 0.24, y + 0.24, 1.25, "leaves", 0.4)


WALLS = (*_outer_walls(), *_inner_walls())
FURNITURE = (
    *_door_frames(),
    # Doors, which stand open.
    Box(-5.85, 1.27, -5.8, 2.35, DOOR_HEIGHT, "red door"),
    Box(0.6, 1.27, 0.65, 2.35, DOOR_HEIGHT, "green door"),
    Box(5.8, 1.27, 5.85, 2.35, DOOR_HEIGHT, "blue door"),
    Box(-4.9, -2.35, -4.85, -1.27, DOOR_HEIGHT, "yellow door"),
    Box(0.15, -2.35, 0.2, -1.27, DOOR_HEIGHT, "orange door"),
    Box(6.1, -2.35, 6.15, -1.27, DOOR_HEIGHT, "white door"),
    # The living room.
    Box(-7.6, 4.7, -5.2, 5.45, 0.45, "sofa"),
    Box(-7.6, 5.45, -5.2, 5.75, 0.85, "sofa back"),
    Box(-6.9, 3.4, -5.9, 3.95, 0.42, "wood"),
    Box(-7.95, 2.3, -7.6, 4.1, 1.9, "books"),
    Box(-7.7, 1.27, -6.3, 1.65, 0.5, "wood"),
    Box(-7.6, 1.28, -6.4, 1.34, 1.4, "screen", 0.65),
    *_plant(-3.0, 5.5),
    Box(-4.9, 5.97, -3.5, 6.0, 2.0, "window", 0.8),
    Box(-2.6, 4.2, -2.575, 5.1, 1.85, "painting 1", 1.15),
    # The kitchen.
    Box(-2.35, 5.35, 0.8, 5.95, 0.9, "cupboards"),
    Box(-2.35, 5.6, -1.2, 5.95, 2.1, "cupboards", 1.45),
    Box(0.95, 5.25, 1.65, 5.95, 1.85, "fridge"),
    Box(-1.0, 5.97, 0.6, 6.0, 2.0, "window", 1.1),
    Box(0.5, 3.5, 1.7, 4.3, 0.74, "wood"),
    Box(0.1, 3.7, 0.4, 4.05, 0.45, "stool"),
    Box(1.1, 3.0, 1.45, 3.3, 0.45, "stool"),
    # The office.
    Box(6.9, 2.5, 7.65, 4.5, 0.74, "wood"),
    Box(7.3, 2.9, 7.38, 3.9, 1.35, "screen", 0.82),
    Box(6.2, 3.2, 6.65, 3.65, 0.48, "chair"),
    Box(2.7, 5.5, 4.3, 5.92, 1.9, "books"),
    Box(5.0, 5.97, 7.2, 6.0, 2.0, "window", 0.8),
    *_plant(7.55, 5.5),
    Box(2.575, 3.7, 2.6, 4.9, 1.85, "painting 2", 1.1),
    # The bedroom.
    Box(-7.6, -5.7, -5.8, -3.7, 0.5, "bed"),
    Box(-7.5, -5.7, -5.9, -5.2, 0.62, "pillow", 0.5),
    Box(-7.65, -5.9, -5.75, -5.7, 1.05, "wood"),
    Box(-5.6, -5.85, -5.15, -5.4, 0.5, "wood"),
    Box(-4.6, -5.95, -3.15, -5.35, 2.1, "wardrobe"),
    Box(-8.0, -3.6, -7.97, -2.0, 2.0, "window", 0.8),
    Box(-3.1, -4.0, -3.075, -3.0, 1.85, "painting 3", 1.15),
    # The workshop.
    Box(-2.85, -5.95, 0.2, -5.25, 0.9, "workbench"),
    Box(-2.7, -6.0, 0.0, -5.97, 1.95, "tools", 1.15),
    Box(1.8, -5.6, 2.6, -4.9, 0.8, "blue crate"),
    Box(1.9, -4.8, 2.5, -4.4, 0.55, "orange crate"),
    Box(-1.5, -3.6, -1.15, -3.25, CEILING, "pillar"),
    # The store, with the robot's dock.
    Box(3.2, -5.95, 5.4, -5.35, 1.9, "rack"),
    Box(7.35, -5.0, 7.95, -2.0, 1.9, "rack"),
    Box(6.0, -5.98, 6.5, -5.8, 0.4, "dock"),
    Box(3.8, -2.1, 4.5, -1.45, 0.7, "blue crate"),
    # The hall.
    Box(-8.0, -0.7, -7.97, 0.7, 2.1, "window", 0.7),
    Box(7.97, -0.7, 8.0, 0.7, 2.1, "window", 0.7),
    *_plant(-7.5, -0.75),
    *_plant(7.5, 0.75),
    Box(-3.7, 0.8, -2.3, 1.08, 0.45, "wood"),
    Box(-3.6, 1.07, -2.4, 1.095, 1.85, "painting 2", 1.1),
    Box(2.1, 1.07, 3.1, 1.095, 1.85, "painting 1", 1.1),
    Box(-2.6, -1.095, -1.4, -1.07, 1.85, "painting 3", 1.1),
    Box(2.8, -1.095, 3.8, -1.07, 1.85, "painting 1", 1.1),
)


def edges_of(boxes: Iterable[Box]) -> Floats:
    """Return left, bottom, right and top of boxes, a row each."""
    return np.array([box[:4] for box in boxes], dtype=float)


_OBSTACLES = edges_of(box for box in (*WALLS, *FURNITURE) if box.low < _TALL)
_MEASURED = edges_of(box for box in (*WALLS, *FURNITURE) if box.low <= LASER_HEIGHT < box.high)


def is_free(x: float, y: float, margin: float = RADIUS) -> bool:
    """Whether a robot fits at a place: no obstacle is nearer than `margin`."""
    across = np.maximum(np.maximum(_OBSTACLES[:, 0] - x, x - _OBSTACLES[:, 2]), 0)
    along = np.maximum(np.maximum(_OBSTACLES[:, 1] - y, y - _OBSTACLES[:, 3]), 0)
    return bool((across * across + along * along).min() >= margin * margin)


def crossings(x: float, y: float, rays: Floats, edges: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return where rays from a place enter and leave boxes, in lengths of the ray, and whether by a side along y.

    A ray that misses a box enters it at infinity. Each result has a row for each ray, and a column for each box.
    """
    inverse = 1 / np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    left, right = ((edges[:, at] - x) * inverse[:, :1] for at in (0, 2))
    bottom, top = ((edges[:, at] - y) * inverse[:, 1:] for at in (1, 3))
    enters_x, enters_y = np.minimum(left, right), np.minimum(bottom, top)
    enters = np.maximum(enters_x, enters_y)
    leaves = np.minimum(np.maximum(left, right), np.maximum(bottom, top))
    return np.where((enters < leaves) & (enters > 0), enters, np.inf), leaves, enters_x > enters_y


def measured_ranges(x: float, y: float, angles: Floats) -> Floats:
    """Return the distances that a laser measures at a place, by the angles (rad) of its beams in the map."""
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nearest: Floats = crossings(x, y, rays, _MEASURED)[0].min(axis=1)
    return nearest


@cache
def occupancy() -> NDArray[np.int8]:
    """Return the map, row by row from the bottom."""
    cells = np.full((SIDE, SIDE), UNKNOWN, np.int8)
    _fill(cells, Box(LEFT, BOTTOM, RIGHT, TOP), FREE)
    for left, bottom, right, top in _MEASURED:
        _fill(cells, Box(left, bottom, right, top), OCCUPIED)
    return cells


@cache
def clearance() -> Floats:
    """Return the distance of each of the map's cells from the next obstacle, as far as it costs."""
    taken = np.ones((SIDE, SIDE), bool)
    _fill(taken, Box(LEFT, BOTTOM, RIGHT, TOP), False)
    for left, bottom, right, top in _OBSTACLES:
        _fill(taken, Box(left, bottom, right, top), True)
    reach = math.ceil(_INFLATION / RESOLUTION)
    squares = np.where(taken, 0.0, reach * reach)
    # Along each row, and then along each column of what that has found.
    for axis in (1, 0):
        near = squares.copy()
        for step in range(1, reach):
            for way in (step, -step):
                np.minimum(near, np.roll(squares, way, axis) + step * step, out=near)
        squares = near
    return np.sqrt(squares) * RESOLUTION


@cache
def costs() -> NDArray[np.int8]:
    """Return the costs of the map's cells, as nav2 publishes them: 100 is an obstacle, 99 touches one."""
    far = clearance()
    falling = (_INSCRIBED - 1) * np.exp(-_FALLS * (far - RADIUS))
    inflated = np.where(far < RADIUS, _INSCRIBED, np.where(far < _INFLATION, falling, FREE))
    known = np.where(far == 0, OCCUPIED, inflated)
    return np.where(occupancy() == UNKNOWN, UNKNOWN, known).astype(np.int8)


def cell_of(x: float, y: float) -> tuple[int, int]:
    """Return the row and the column of a place on the map, which may lie outside."""
    return math.floor(y / RESOLUTION) + SIDE // 2, math.floor(x / RESOLUTION) + SIDE // 2


def _fill(cells: NDArray[np.generic], box: Box, value: int) -> None:
    """Set all cells that a box touches."""
    (bottom, left), (top, right) = (
        (round(y / RESOLUTION) + SIDE // 2, round(x / RESOLUTION) + SIDE // 2)
        for x, y in ((box.left, box.bottom), (box.right, box.top))
    )
    cells[max(0, bottom) : max(top, bottom + 1), max(0, left) : max(right, left + 1)] = value
