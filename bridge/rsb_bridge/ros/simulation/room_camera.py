"""The picture that the simulated robot's camera takes of its rooms, by ray casting.

Floor, ceiling and walls come first, then furniture from far to near. The picture's columns share what a ray hits, so
that the work is a few operations of numpy on all pixels.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rsb_bridge.ros.simulation.rooms import BOTTOM, CEILING, FURNITURE, LEFT, ROOMS, WALLS, Box, crossings, edges_of
from rsb_bridge.ros.simulation.textures import (
    FLOOR_DEPTH,
    FLOOR_WIDTH,
    LAMPS,
    SIZE,
    TEXELS,
    WALL_WIDTH,
    furniture,
    surfaces,
    top_colour,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rsb_bridge.ros.simulation.rooms import Floats

EYE = 1.15
"""m: height of the camera."""
FIELD = 0.8
"""Half of its field of view, as a tangent."""
_FAR = 22.0
"""m from which half of the light comes."""
_FULL = 256
"""Light with which a colour stays as it is."""
_ALONG_X, _ALONG_Y = 0.86, 1.0
"""Light of sides, by their direction: so that corners show."""
_SHINE = {"window", "screen"}
_WALL_EDGES = edges_of(WALLS)
_GOAL_WIDTH, _GOAL_HEIGHT = 0.06, 1.0


class _View(NamedTuple):
    """What each column of a picture sees.

    Attributes:
        depth: m to the wall, along the camera's axis.
        focal: pixels that 1 m at 1 m takes.
    """

    x: float
    y: float
    rays: Floats
    depth: Floats
    focal: float
    rows: Floats


def room_picture(
    x: float, y: float, heading: float, width: int, height: int, goal: tuple[float, float] | None = None
) -> NDArray[np.uint8]:
    """Return rows of pixels, red, green and blue, as a camera takes them at a pose.

    Args:
        goal: place of a marker, or None for none.
    """
    ahead = np.array([math.cos(heading), math.sin(heading)])
    right = np.array([math.sin(heading), -math.cos(heading)])
    rays = ahead + np.linspace(-FIELD, FIELD, width)[:, None] * right
    enters, _, is_along_y = crossings(x, y, rays, _WALL_EDGES)
    nearest = enters.argmin(axis=1)
    columns = np.arange(width)
    depth = enters[columns, nearest]
    focal = width / 2 / FIELD
    view = _View(x, y, rays, depth, focal, np.arange(height) - height / 2 + 0.5)
    pixels = _room(view, is_along_y[columns, nearest])
    boxes = FURNITURE if goal is None else (*FURNITURE, _marker(*goal))
    _put_boxes(pixels, view, boxes, heading)
    picture = np.empty((height, width, 3), np.uint8)
    for channel, shift in enumerate((16, 8, 0)):
        picture[:, :, channel] = pixels >> shift  # a cast drops the higher bits
    return picture


def _marker(x: float, y: float) -> Box:
    half = _GOAL_WIDTH / 2
    return Box(x - half, y - half, x + half, y + half, _GOAL_HEIGHT, "goal")


def _room(view: _View, is_along_y: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Return the picture of the empty rooms."""
    colours, walls, floor, ceiling = surfaces()
    x, y, depth, rows = view.x, view.y, view.depth.astype(np.float32), view.rows
    height, half = len(rows), len(rows) // 2
    # Each pixel of floor and ceiling, or of the wall before it.
    plane = (np.where(rows > 0, EYE, EYE - CEILING) * view.focal / rows).astype(np.float32)
    near = np.minimum(plane[:, None], depth)
    across = near * ((view.rays[:, 0]) * TEXELS).astype(np.float32)
    along = near * ((view.rays[:, 1]) * TEXELS).astype(np.float32)
    across += np.float32((x - LEFT) * TEXELS)
    along += np.float32((y - BOTTOM) * TEXELS)
    index = along.astype(np.int32)
    np.clip(index, 0, FLOOR_DEPTH - 1, out=index)
    index *= FLOOR_WIDTH
    index += across.astype(np.int32)
    index[half:] += floor
    index[:half] += ceiling
    # The walls.
    hit_x, hit_y = x + view.rays[:, 0] * view.depth, y + view.rays[:, 1] * view.depth
    names = _walls_of(hit_x - view.rays[:, 0] * 0.1, hit_y - view.rays[:, 1] * 0.1, walls)
    column = (np.where(is_along_y, hit_y, hit_x) / WALL_WIDTH % 1 * SIZE).astype(np.int32) + names
    down = (rows * (SIZE / CEILING / view.focal)).astype(np.float32)[:, None] * depth
    down += np.float32((CEILING - EYE) / CEILING * SIZE)
    is_wall = depth <= plane[:, None]
    wall = down.astype(np.int32)
    np.clip(wall, 0, SIZE - 1, out=wall)
    wall *= SIZE
    wall += column.astype(np.int32)
    np.copyto(index, wall, where=is_wall)
    pixels = colours.take(index, mode="clip")
    side = np.where(is_along_y, _ALONG_X, _ALONG_Y) * _lamp_light(hit_x, hit_y)
    light = np.empty((height, len(depth)), np.uint32)
    light[:] = _light(plane)[:, None]
    np.copyto(light, (_light(view.depth) * side).astype(np.uint32), where=is_wall)
    return _lit(pixels, light)


def _walls_of(x: Floats, y: Floats, walls: dict[str, int]) -> NDArray[np.int64]:
    """Return where the textures of the rooms' walls begin, by places in the rooms."""
    found = np.zeros(len(x), np.int64)
    for room in ROOMS:
        inside = (x >= room.left) & (x < room.right) & (y >= room.bottom) & (y < room.top)
        found[inside] = walls[room.wall]
    return found


def _lamp_light(x: Floats, y: Floats) -> Floats:
    lamps = np.array(LAMPS)
    squares = (x[:, None] - lamps[:, 0]) ** 2 + (y[:, None] - lamps[:, 1]) ** 2
    light: Floats = 0.86 + 0.3 * np.exp(-squares.min(axis=1) / 9)
    return light


def _light(depth: Floats) -> NDArray[np.uint32]:
    return (_FULL / (1 + depth / _FAR)).astype(np.uint32)


def _lit(pixels: NDArray[np.uint32], light: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return colours in a light, red and blue at once."""
    both: NDArray[np.uint32] = pixels & np.uint32(0xFF00FF)
    both *= light
    both >>= np.uint32(8)
    both &= np.uint32(0xFF00FF)
    green = pixels & np.uint32(0xFF00)
    green *= light
    green >>= np.uint32(8)
    green &= np.uint32(0xFF00)
    both |= green
    return both


def _put_boxes(pixels: NDArray[np.uint32], view: _View, boxes: tuple[Box, ...], heading: float) -> None:
    edges = edges_of(boxes)
    middle = (edges[:, :2] + edges[:, 2:]) / 2 - (view.x, view.y)
    size = np.hypot(*(edges[:, 2:] - edges[:, :2]).T) / 2
    far = middle @ (math.cos(heading), math.sin(heading))
    aside = np.abs(middle @ (-math.sin(heading), math.cos(heading)))
    seen = np.flatnonzero((far + size > 0.05) & (aside - 1.3 * size < FIELD * (far + size)))
    enters, leaves, is_along_y = crossings(view.x, view.y, view.rays, edges[seen])
    is_seen = enters < view.depth[:, None]
    nearest = np.where(is_seen, enters, np.inf).min(axis=0)
    for at in np.argsort(-nearest):
        hit = np.flatnonzero(is_seen[:, at])
        if len(hit):
            box, columns = boxes[seen[at]], slice(hit[0], hit[-1] + 1)
            # A column between that does not see the box sees it nowhere: it is 0 m deep there.
            sides = np.where(is_seen[columns, at], enters[columns, at], 0.0)
            ends = np.minimum(leaves[columns, at], view.depth[columns]) * is_seen[columns, at]
            _put_side(pixels[:, columns], view, box, view.rays[columns], sides, is_along_y[columns, at])
            if (box.high < EYE or box.low > EYE) and box.look != "leaves":
                _put_top(pixels[:, columns], view, box, sides, ends)


def _put_side(
    pixels: NDArray[np.uint32], view: _View, box: Box, rays: Floats, sides: Floats, is_along_y: NDArray[np.bool_]
) -> None:
    """Draw what is seen of a box from aside.

    Args:
        sides: depth of the box in each column, or 0.
    """
    upper, lower = EYE - box.high, EYE - box.low  # m below the eye
    first, last = _span(view, upper, lower, sides)
    rows, part = view.rows[first:last].astype(np.float32), pixels[first:last]
    below = rows[:, None] * (sides / view.focal).astype(np.float32)
    front = below >= upper
    front &= below < lower
    front &= sides > 0
    below -= np.float32(upper)
    below *= np.float32(SIZE / (box.high - box.low))
    index = below.astype(np.int32)
    index *= SIZE
    place = np.where(
        is_along_y,
        (view.y + rays[:, 1] * sides - box.bottom) / (box.top - box.bottom),
        (view.x + rays[:, 0] * sides - box.left) / (box.right - box.left),
    )
    index += (place * SIZE).clip(0, SIZE - 1).astype(np.int32)
    colours = furniture(box.look).take(index, mode="clip")
    if box.look == "leaves":
        front &= colours > 0
    if box.look not in _SHINE:
        colours = _lit(colours, (_light(sides) * np.where(is_along_y, _ALONG_X, _ALONG_Y)).astype(np.uint32))
    np.copyto(part, colours, where=front)


def _put_top(pixels: NDArray[np.uint32], view: _View, box: Box, sides: Floats, ends: Floats) -> None:
    """Draw the upper side of a box that is lower than the eye, or the lower side of one that is higher."""
    below = EYE - box.high if box.high < EYE else EYE - box.low
    first, last = sorted((below / ends[sides > 0].max(), below / sides[sides > 0].min()))
    first, last = np.searchsorted(view.rows, (first * view.focal, last * view.focal))
    depth = below * view.focal / view.rows[first:last]
    colour = np.full(len(depth), top_colour(box.look), np.uint32)
    lit = _lit(colour, (_light(depth) * (1.0 if below > 0 else 0.7)).astype(np.uint32))
    np.copyto(pixels[first:last], lit[:, None], where=(depth[:, None] > sides) & (depth[:, None] <= ends))


def _span(view: _View, upper: float, lower: float, sides: Floats) -> tuple[int, int]:
    """Return the rows between which a side is seen, from `upper` to `lower` m below the eye."""
    seen = sides[sides > 0]
    nearest, farthest = seen.min(), seen.max()
    first, last = np.searchsorted(
        view.rows,
        (
            view.focal * upper / (nearest if upper < 0 else farthest),
            view.focal * lower / (nearest if lower > 0 else farthest),
        ),
    )
    return int(first), int(last)
