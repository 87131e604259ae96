"""Grids of a map: occupied, free and unknown cells, and costs, as the ground behind a picture's characters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, UndrawableError, nested, number, raw
from rsb_extras.pictures.transforms import FAR, Transform, pose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.transforms import Floats

    Kinds = NDArray[np.uint8]

MOST_CELLS = 64 << 20
"""Cells of a grid that is drawn at most. A round figure: copies of it must fit into `worker.MEMORY_LIMIT`."""
_OCCUPIED = 65
"""Lowest value of an occupied cell (nav2_map_server's default, as a percentage)."""
_INSCRIBED, _LETHAL, _HIGHEST = 99, 100, 127
"""Values of nav2's costmaps as nav_msgs/msg/OccupancyGrid: next to an obstacle, at an obstacle, and the highest."""
_COSTMAP_INSCRIBED, _COSTMAP_LETHAL, _COSTMAP_UNKNOWN = 253, 254, 255
"""The same of nav2_msgs/msg/Costmap."""
_COSTMAP = "costmap"
"""Part of the names of nav2's topics of costs."""
_NONE, _UNKNOWN, _FREE, _FIRST_COST = range(4)
"""Kinds of cells, in the order in which the highest of several gives a character's ground."""
_RAMP = ("#0000ff", "#3300cc", "#660099", "#990066", "#cc0033", "#ff0000")
"""Tints of low to high costs, as RViz has them."""
_INSCRIBED_KIND = _FIRST_COST + len(_RAMP)
_LETHAL_KIND, _OCCUPIED_KIND = _INSCRIBED_KIND + 1, _INSCRIBED_KIND + 2
INSCRIBED_TINT = "#00ffff"
_TINTS = ("", "unknown", "free", *_RAMP, INSCRIBED_TINT, "lethal", "occupied")
"""By kind."""
_QUARTERS = 2
"""Quarters of a cell in each direction."""
_MOST_OF_A_CELL = 2
"""Quarters with a wall, from which on dots in a cell have the wall behind them."""
_STRAIGHT = 1e-3
"""rad: a grid that is turned by less is drawn as if it were not: over 1,000 cells, that shifts it by one."""


class GridProblem(Wording):
    """The reason why a grid cannot be drawn."""

    BAD_GRID = "the grid of {width:,}×{height:,} cells has {got:,} values"


class Grid(NamedTuple):
    """A grid.

    Attributes:
        kinds: kinds of its cells by row, from the origin.
        resolution: m a cell.
        origin: pose of the first cell's corner.
        known: corners of the part that is not unknown, in the grid's frame: x and y.
        has_costs: whether it is laid over other grids.
    """

    kinds: Kinds
    resolution: float
    origin: Transform
    known: tuple[Floats, Floats]
    has_costs: bool


def read_grid(message: Message, topic: str) -> Grid:
    """Return the grid in a nav_msgs/msg/OccupancyGrid or a nav2_msgs/msg/Costmap.

    Raises:
        UndrawableError: its size is wrong.
    """
    is_costmap = nested(message, "metadata") is not None
    about = "metadata" if is_costmap else "info"
    sizes = ("size_x", "size_y") if is_costmap else ("width", "height")
    width, height = (int(number(message, f"{about}.{name}")) for name in sizes)
    content, _ = raw(message, "data")
    if width * height > min(MOST_CELLS, len(content)) or not width * height:
        raise UndrawableError(GridProblem.BAD_GRID(width=width, height=height, got=len(content)))
    values = np.frombuffer(content, np.uint8, width * height)
    has_costs = is_costmap or _COSTMAP in topic or _are_costs(values)
    table = _COSTMAP_TABLE if is_costmap else _COSTS_TABLE if has_costs else _MAP_TABLE
    kinds = table[values].reshape(height, width)
    resolution = number(message, f"{about}.resolution")
    # Cells of no size would be divided by.
    if not 0 < resolution < FAR:
        resolution = 1.0
    origin = pose(message, f"{about}.origin")
    return Grid(kinds, resolution, origin, _known_part(kinds, resolution, origin), has_costs)


def _are_costs(values: NDArray[np.uint8]) -> bool:
    """Whether the values are costs: most cells have none, and some are next to an obstacle."""
    counts = np.bincount(values, minlength=256)
    return bool(counts[_INSCRIBED] and counts[_LETHAL] and 2 * counts[0] > counts[: _HIGHEST + 1].sum())


def _table(inscribed: int, lethal: int, unknown: range, *, is_map: bool = False) -> Kinds:
    """Return the kind of each value of a byte."""
    table = np.full(256, _FREE, np.uint8)
    if is_map:
        table[_OCCUPIED:] = _OCCUPIED_KIND
    else:
        costs = np.arange(1, inscribed)
        table[1:inscribed] = _FIRST_COST + (costs - 1) * len(_RAMP) // (inscribed - 1)
        table[inscribed], table[lethal:] = _INSCRIBED_KIND, _LETHAL_KIND
    table[unknown.start : unknown.stop] = _UNKNOWN
    return table


_NEGATIVE = range(_HIGHEST + 1, 256)
_MAP_TABLE = _table(0, 0, _NEGATIVE, is_map=True)
_COSTS_TABLE = _table(_INSCRIBED, _LETHAL, _NEGATIVE)
_COSTMAP_TABLE = _table(_COSTMAP_INSCRIBED, _COSTMAP_LETHAL, range(_COSTMAP_UNKNOWN, _COSTMAP_UNKNOWN + 1))


def _known_part(kinds: Kinds, resolution: float, origin: Transform) -> tuple[Floats, Floats]:
    known = kinds > _UNKNOWN
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    height, width = kinds.shape
    left, right = (columns[0], columns[-1] + 1) if len(columns) else (0, width)
    bottom, top = (rows[0], rows[-1] + 1) if len(rows) else (0, height)
    x = np.array([left, right, right, left]) * resolution
    y = np.array([bottom, bottom, top, top]) * resolution
    return origin.apply(x, y)


class Sheet(NamedTuple):
    """The part of the plane that a canvas shows.

    Attributes:
        left: m, x of its left edge.
        top: m, y of its upper edge.
        metres: m a dot.
    """

    left: float
    top: float
    metres: float


def ground(grids: Sequence[tuple[Grid, Transform]], sheet: Sheet, width: int, height: int) -> Kinds:
    """Return the kinds of the quarters of a canvas's cells, row by row: costs over maps, and walls over costs.

    Args:
        grids: with the poses of their frames.
        width: cells of the canvas.
        height: cells of the canvas.
    """
    shape = height * _QUARTERS, width * _QUARTERS
    result = np.full(shape, _UNKNOWN, np.uint8)
    for grid, place in sorted(grids, key=lambda each: each[0].has_costs):
        at = place.after(grid.origin)
        turned = math.remainder(at.yaw, math.tau)
        read = _straight if abs(turned) < _STRAIGHT else _turned
        kinds = read(grid, at, sheet, shape)
        over = kinds >= _FREE
        if grid.has_costs:
            over = (kinds >= _FIRST_COST) | ((kinds == _FREE) & (result == _UNKNOWN))
            over &= result != _OCCUPIED_KIND
        result = np.where(over, kinds, result)
    return result


def has_inscribed(kinds: Kinds) -> bool:
    """Whether a canvas shows where the robot's middle must not be, as it would hit an obstacle."""
    return bool((kinds == _INSCRIBED_KIND).any())


def _straight(grid: Grid, at: Transform, sheet: Sheet, shape: tuple[int, int]) -> Kinds:
    """Return the highest kind in each quarter, exactly: no thin wall gets lost."""
    down, across = shape
    height, width = grid.kinds.shape
    # Dots: a quarter is one wide and two high. Rows of a grid go up.
    metres_x, metres_y = sheet.metres, 2 * sheet.metres
    columns = (sheet.left - at.x + np.arange(across + 1) * metres_x) / grid.resolution
    rows = (sheet.top - at.y + np.arange(-down, 1) * metres_y) / grid.resolution
    result = np.zeros(shape, np.uint8)
    first_row, starts_y = _starts(rows, height)
    first_column, starts_x = _starts(columns, width)
    if not (len(starts_x) and len(starts_y)):
        return result
    top, right = (min(size, max(1, math.ceil(edges[first + len(starts)]))) for edges, first, starts, size in (
        (rows, first_row, starts_y, height), (columns, first_column, starts_x, width)))  # fmt: skip
    window = grid.kinds[: max(top, starts_y[-1] + 1), : max(right, starts_x[-1] + 1)]
    highest = np.maximum.reduceat(window, starts_y, axis=0)
    highest = np.maximum.reduceat(highest, starts_x, axis=1)
    result[first_row : first_row + len(starts_y), first_column : first_column + len(starts_x)] = highest
    return result[::-1]


def _starts(edges: NDArray[Any], size: int) -> tuple[int, NDArray[np.int64]]:
    """Return the first of the ranges between edges that has cells, and the first cell of each range from there on."""
    inside = np.flatnonzero((edges[:-1] < size) & (edges[1:] > 0))
    if not len(inside):
        return 0, np.empty(0, np.int64)
    starts = np.clip(np.floor(edges[inside] + 1e-9), 0, size - 1).astype(np.int64)
    return int(inside[0]), starts


def _turned(grid: Grid, at: Transform, sheet: Sheet, shape: tuple[int, int]) -> Kinds:
    """Return the kinds in the middle of quarters, and the walls between them."""
    height, width = grid.kinds.shape
    back = at.inverse()
    down, across = np.mgrid[0 : shape[0], 0 : shape[1]]
    x, y = back.apply(sheet.left + (across + 0.5) * sheet.metres, sheet.top - (down + 0.5) * 2 * sheet.metres)
    with np.errstate(all="ignore"):
        column, row = np.floor(x / grid.resolution), np.floor(y / grid.resolution)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    result = np.zeros(shape, np.uint8)
    result[inside] = grid.kinds[row[inside].astype(np.int64), column[inside].astype(np.int64)]
    if (block := int(sheet.metres / grid.resolution)) > 0:  # cells of a quarter, in each direction
        highest = np.maximum.reduceat(grid.kinds, np.arange(0, height, block), axis=0)
        highest = np.maximum.reduceat(highest, np.arange(0, width, block), axis=1)
        rows, columns = np.nonzero(highest >= _LETHAL_KIND)
        x, y = at.apply((columns + 0.5) * block * grid.resolution, (rows + 0.5) * block * grid.resolution)
        across, down = np.floor((x - sheet.left) / sheet.metres), np.floor((sheet.top - y) / (2 * sheet.metres))
        inside = (across >= 0) & (across < shape[1]) & (down >= 0) & (down < shape[0])
        result[down[inside].astype(np.int64), across[inside].astype(np.int64)] = highest[rows[inside], columns[inside]]
    return result


def lay_under(canvas: Canvas, kinds: Kinds) -> None:
    """Put the ground behind what a canvas has, and draw walls where it has nothing yet."""
    height, width = canvas.height, canvas.width
    quarters = kinds.reshape(height, _QUARTERS, width, _QUARTERS).transpose(0, 2, 1, 3).reshape(height * width, 4)
    is_wall = quarters >= _LETHAL_KIND
    walls = is_wall.sum(axis=1)
    pattern = (is_wall * np.array([1, 2, 4, 8])).sum(axis=1)
    floor = np.where(is_wall, _NONE, quarters)
    upper, lower = floor[:, :2].max(axis=1), floor[:, 2:].max(axis=1)
    highest, below = quarters.max(axis=1), np.maximum(upper, lower)
    tints = np.array([canvas.style(tint) for tint in _TINTS], np.uint8)
    halves = np.array([canvas.style(tint and f"@{tint}") for tint in _TINTS], np.uint8)
    blocks, styles = np.frombuffer(canvas.blocks, np.uint8), np.frombuffer(canvas.styles, np.uint8)
    backgrounds = np.frombuffer(canvas.backgrounds, np.uint8)
    empty = np.frombuffer(canvas.dots, np.uint8) == 0
    empty[[*canvas.characters()]] = False
    # Behind dots: the wall if it fills half of the cell, else the floor.
    backgrounds[:] = tints[np.where(~empty & (walls >= _MOST_OF_A_CELL), highest, below)]
    split = empty & (walls == 0) & (upper != lower)
    backgrounds[split] = tints[lower[split]]
    blocks[split], styles[split] = Canvas.BLOCKS.index("▀"), halves[upper[split]]
    free = empty & (walls == 0) & (upper == lower) & (upper == _FREE)
    blocks[free], styles[free] = Canvas.A_DOT, canvas.style("free")
    walled = empty & (walls > 0)
    blocks[walled], styles[walled] = pattern[walled], tints[highest[walled]]
