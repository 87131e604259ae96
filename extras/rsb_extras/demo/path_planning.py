"""Paths through the rooms: A* over the map's cells, further from obstacles where there is room."""

from __future__ import annotations

import heapq
import math
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from rsb_extras.demo.rooms import RADIUS, RESOLUTION, SIDE, TOUR, clearance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rsb_extras.demo.rooms import Floats

_Cell: TypeAlias = "tuple[int, int]"
_STRIDE = 2
"""Cells of the map to one of the planner: the whole plan takes 20 ms."""
STEP = RESOLUTION * _STRIDE
"""m between two poses of a path, about."""
_CLEAR = RADIUS + 0.03
_NARROW, _WIDE = 4.0, 0.2
"""Cost of a cell next to an obstacle, besides its length, and the distance in m within which it falls to a third."""
_SMOOTH = 7
"""Poses over which a path is averaged: so the robot does not turn at each cell."""
_NEIGHBOURS = [(row, column, math.hypot(row, column)) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def plan(start: tuple[float, float], goal: tuple[float, float]) -> Floats:
    """Return the path to the place nearest to a goal that the robot can reach, a row for each x and y."""
    end = _nearest(*goal)
    cells = _search(_nearest(*start), end)
    ends_at_goal = math.dist(_place(end), goal) < STEP
    places = [start, *map(_place, cells), goal if ends_at_goal else _place(end)]
    return _smoothed(np.array(places))


@cache
def _prices() -> list[list[float]]:
    """Return the cost of a metre in each cell, or infinity where the robot does not fit."""
    far = clearance()[::_STRIDE, ::_STRIDE]
    prices: list[list[float]] = np.where(far < _CLEAR, np.inf, 1 + _NARROW * np.exp((_CLEAR - far) / _WIDE)).tolist()
    return prices


@cache
def _reachable() -> NDArray[np.intp]:
    """Return the row and column of each cell that the robot can reach."""
    fits = np.isfinite(_prices())
    found = np.zeros_like(fits)
    found[_cell(*TOUR[0][:2])] = True
    while True:
        grown = found.copy()
        for axis in (0, 1):
            for way in (-1, 1):
                grown |= np.roll(found, way, axis)
        grown &= fits
        if (grown == found).all():
            return np.argwhere(found)
        found = grown


def _cell(x: float, y: float) -> _Cell:
    return round(y / STEP + (SIDE // 2 - 0.5) / _STRIDE), round(x / STEP + (SIDE // 2 - 0.5) / _STRIDE)


def _place(cell: _Cell) -> tuple[float, float]:
    row, column = cell
    middle = (SIDE // 2 - 0.5) / _STRIDE
    return (column - middle) * STEP, (row - middle) * STEP


def _nearest(x: float, y: float) -> _Cell:
    cells = _reachable()
    row, column = cells[np.square(cells - _cell(x, y)).sum(axis=1).argmin()]
    return int(row), int(column)


def _search(start: _Cell, goal: _Cell) -> list[_Cell]:
    """Return the cells from start to goal. Both are reachable, so there is a path."""
    prices, came, paid = _prices(), {start: start}, {start: 0.0}
    done: set[_Cell] = set()
    queue = [(0.0, start)]
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            break
        if cell in done:
            continue
        done.add(cell)
        row, column = cell
        for down, across, length in _NEIGHBOURS:
            near = row + down, column + across
            price = paid[cell] + length * prices[near[0]][near[1]]
            if price < paid.get(near, math.inf):
                paid[near], came[near] = price, cell
                heapq.heappush(queue, (price + math.dist(near, goal), near))
    path = [goal]
    while path[-1] != start:
        path.append(came[path[-1]])
    return path[::-1]


def _smoothed(places: Floats) -> Floats:
    half = _SMOOTH // 2
    padded = np.pad(places, ((half, half), (0, 0)), mode="edge")
    inner = sum(padded[at : at + len(places)] for at in range(_SMOOTH)) / _SMOOTH
    return np.vstack([places[:1], inner, places[-1:]])
