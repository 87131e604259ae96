"""The room of the simulated robot: walls and boxes, seen by its laser scanner, its camera and its map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_WALL, _BOX, _CRATE, _DOOR = (178, 172, 160), (196, 92, 60), (70, 118, 176), (120, 150, 80)
_LEFT, _RIGHT, _BOTTOM, _TOP = -8.0, 8.0, -6.0, 6.0
_BOXES = (
    (3.5, 2.5, 5.0, 4.0, _BOX),
    (-6.0, -4.5, -4.0, -3.0, _CRATE),
    (-5.0, 3.0, -4.2, 3.8, _DOOR),
    (4.5, -3.5, 5.1, -2.9, _BOX),
)
"""Left, bottom, right and top in m, and colour."""
_EYE, _HEIGHT = 0.6, 2.4
"""m: of the camera, and of the walls."""
_FIELD = 0.9
"""Half of the camera's field of view, as a tangent."""
_TILE = 1.0
_OCCUPIED, _UNKNOWN = 100, -1


def _edges(left: float, bottom: float, right: float, top: float) -> list[tuple[float, float, float, float]]:
    return [
        (left, bottom, right, bottom),
        (right, bottom, right, top),
        (right, top, left, top),
        (left, top, left, bottom),
    ]


_SEGMENTS = np.array([*_edges(_LEFT, _BOTTOM, _RIGHT, _TOP), *(e for box in _BOXES for e in _edges(*box[:4]))])
_COLOURS = np.array([_WALL] * 4 + [box[4] for box in _BOXES for _ in range(4)], dtype=float)
_SHADES = np.array([0.9, 0.75, 1.0, 0.65] * (1 + len(_BOXES)))


def is_free(x: float, y: float, margin: float) -> bool:
    """Whether a robot fits at a place in m: no wall and no box is nearer than `margin` m."""
    if not (_LEFT + margin < x < _RIGHT - margin and _BOTTOM + margin < y < _TOP - margin):
        return False
    boxes = (box[:4] for box in _BOXES)
    return not any(a - margin < x < c + margin and b - margin < y < d + margin for a, b, c, d in boxes)


def _cast(x: float, y: float, directions: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distance at which each ray hits, in lengths of its direction, and the segment that it hits."""
    start, across = _SEGMENTS[:, :2] - (x, y), _SEGMENTS[:, 2:] - _SEGMENTS[:, :2]
    turned = directions[:, None, 0] * across[None, :, 1] - directions[:, None, 1] * across[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (start[:, 0] * across[:, 1] - start[:, 1] * across[:, 0]) / turned
        part = (start[None, :, 0] * directions[:, None, 1] - start[None, :, 1] * directions[:, None, 0]) / turned
    hit = np.where((along > 1e-6) & (part >= 0) & (part <= 1), along, np.inf)
    return hit.min(axis=1), hit.argmin(axis=1)


def ranges(x: float, y: float, heading: float, angles: Floats) -> Floats:
    """Return the distances in m that a laser scanner measures.

    Args:
        x: m.
        y: m.
        heading: rad.
        angles: rad, of the beams to the heading.
    """
    turned = heading + angles
    return _cast(x, y, np.stack([np.cos(turned), np.sin(turned)], axis=1))[0]


def image(x: float, y: float, heading: float, width: int, height: int) -> bytes:
    """Return what a camera sees, as rgb8, row by row.

    Args:
        x: m.
        y: m.
        heading: rad.
    """
    ahead = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([np.sin(heading), -np.cos(heading)])
    across = np.linspace(-_FIELD, _FIELD, width)
    rays = ahead + across[:, None] * right
    depth, segment = _cast(x, y, rays)
    focal = width / 2 / _FIELD
    rows = np.arange(height)[:, None] - height / 2 + 0.5
    picture = np.empty((height, width, 3))
    below = np.maximum(rows, 0.5)
    floor_x, floor_y = x + rays[:, 0] * _EYE * focal / below, y + rays[:, 1] * _EYE * focal / below
    tiles = (np.floor(floor_x / _TILE) + np.floor(floor_y / _TILE)) % 2
    fog = np.clip(1.2 - _EYE * focal / below / 12, 0.25, 1)
    picture[:] = ((80 + 45 * tiles) * fog)[:, :, None] * (1.0, 0.97, 0.9)
    picture[: height // 2] = (np.linspace(210, 150, height)[: height // 2, None] * np.ones(width))[:, :, None]
    is_wall = (rows < _EYE * focal / depth) & (rows > -(_HEIGHT - _EYE) * focal / depth)
    light = _SHADES[segment] * np.clip(1.25 - depth / 12, 0.2, 1)
    picture = np.where(is_wall[:, :, None], (_COLOURS[segment] * light[:, None])[None], picture)
    return picture.clip(0, 255).astype(np.uint8).tobytes()


def grid(side: int, resolution: float) -> list[int]:
    """Return a square map around the origin: 0 free, 100 occupied, -1 unknown.

    Args:
        side: cells.
        resolution: m a cell.
    """
    at = (np.arange(side) + 0.5 - side / 2) * resolution
    column, row = np.meshgrid(at, at)
    cells = np.full((side, side), _UNKNOWN)
    margin = 2 * resolution
    cells[(column > _LEFT - margin) & (column < _RIGHT + margin) & (row > _BOTTOM - margin) & (row < _TOP + margin)] = (
        100
    )
    cells[(column > _LEFT) & (column < _RIGHT) & (row > _BOTTOM) & (row < _TOP)] = 0
    for left, bottom, right, top, _ in _BOXES:
        cells[(column > left) & (column < right) & (row > bottom) & (row < top)] = _OCCUPIED
    values: list[int] = cells.ravel().tolist()
    return values
