"""Numbers over time as rows of a terminal, in braille."""

from __future__ import annotations

import math
from itertools import cycle
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.pictures import Curve, Series

Parts = list[tuple[str, str]]

CURVE_STYLES = ("scan", "path", "goal", "ok", "warning", "error", "robot", "strong")
_DOT_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BRAILLE = 0x2800
_ACROSS, _DOWN = 2, 4
AXIS = 10
"""Cells of the labels of values, with the axis: a label such as -1.23e-05 has nine."""
_TICK_ROWS, _TICK_COLUMNS = 4, 16
"""Least rows and columns from one label to the next. A label of time takes up to eleven columns."""
_STEPS = (1, 2, 5)


def plot_rows(series: Series, width: int, height: int, *, cursor: int | None = None) -> list[Parts]:
    """Return the rows of a plot: curves, axes, and a legend with the newest, lowest, mean and highest values.

    Args:
        series: the numbers; two columns fill one cell.
        width: cells.
        height: cells.
        cursor: column of cells, from the left edge of the curves, whose values the legend shows, or None.
    """
    styles_of = cycle(CURVE_STYLES)
    legend = [_legend(curve, next(styles_of), width, cursor) for curve in series.curves]
    # A pane may be smaller than its legend and axes.
    rows = max(1, height - len(legend) - 2)
    across = max(1, width - AXIS)
    low, high = _range(series)
    dots, styles = _dots(series, across, rows, low, high)
    ticks = _ticks(low, high, max(2, rows // _TICK_ROWS))
    labels = {_row_of(tick, low, high, rows): number(tick) for tick in ticks}
    lines: list[Parts] = []
    for row in range(rows):
        label = labels.get(row, "")
        parts: Parts = [(f"{label:>{AXIS - 1}}", "axis"), ("┤" if label else "│", "axis")]
        for column in range(across):
            style = styles[row][column]
            character = chr(_BRAILLE + dots[row][column]) if dots[row][column] else " "
            if column == cursor and not dots[row][column]:
                character, style = "│", "dim"
            # The first two parts are the label and the axis, which stay apart.
            if parts[-1][1] == style and len(parts) > 2:
                parts[-1] = (parts[-1][0] + character, style)
            else:
                parts.append((character, style))
        lines.append(parts)
    return [*lines, *_time_axis(series, across), *legend][:height]


def number(value: float) -> str:
    """Format a value in few characters."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}"
    # Without the plus, the largest numbers have no more characters than a small negative one.
    return f"{value:.2e}".replace("e+", "e")


def _range(series: Series) -> tuple[float, float]:
    """Return the lowest and the highest value, some way apart."""
    values = [value for curve in series.curves for value in (*curve.lows, *curve.highs) if value is not None]
    low, high = min(values, default=0.0), max(values, default=1.0)
    # A constant curve: all further figures divide by the range.
    if high - low < 1e-9 * max(1.0, abs(high)):
        margin = max(abs(high) * 0.1, 1e-3)
        return low - margin, high + margin
    return low, high


def _row_of(value: float, low: float, high: float, rows: int) -> int:
    return min(rows - 1, max(0, round((high - value) / (high - low) * (rows * _DOWN - 1)) // _DOWN))


def _dots(series: Series, across: int, rows: int, low: float, high: float) -> tuple[list[list[int]], list[list[str]]]:
    dots = [[0] * across for _ in range(rows)]
    styles = [[""] * across for _ in range(rows)]
    last = rows * _DOWN - 1
    for at, curve in enumerate(series.curves):
        style, before = CURVE_STYLES[at % len(CURVE_STYLES)], None
        columns = list(zip(curve.lows, curve.highs, strict=False))
        for x in range(across * _ACROSS):
            column = int(x * len(columns) / (across * _ACROSS))
            least, most = columns[column] if column < len(columns) else (None, None)
            if least is None or most is None:
                continue
            top, bottom = (round((high - value) / (high - low) * last) for value in (most, least))
            if before is not None:  # connect a curve's steps, which would be dots with gaps
                top, bottom = min(top, before[1]), max(bottom, before[0])
            before = tuple(round((high - value) / (high - low) * last) for value in (most, least))
            for y in range(max(0, top), min(last, bottom) + 1):
                dots[y // _DOWN][x // _ACROSS] |= _DOT_BITS[y % _DOWN][x % _ACROSS]
                styles[y // _DOWN][x // _ACROSS] = style
    return dots, styles


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Return round values between two, at most so many."""
    rough = (high - low) / most
    power = 10 ** math.floor(math.log10(rough))
    step = next((each * power for each in _STEPS if each * power >= rough), 10 * power)
    first = math.ceil(low / step)
    return [(first + at) * step for at in range(most + 1) if (first + at) * step <= high]


def _time_axis(series: Series, across: int) -> list[Parts]:
    """Return the line of the time axis, and its labels in seconds before the newest message."""
    columns = max((len(curve.lows) for curve in series.curves), default=0) or 1
    seconds = series.step * columns
    line, labels = ["─"] * across, [" "] * across
    for tick in _ticks(-seconds, 0.0, max(1, across // _TICK_COLUMNS)):
        at = min(across - 1, round((tick + seconds) / seconds * (across - 1)))
        text = "now" if abs(tick) < 1e-9 else f"{number(tick)} s"
        line[at] = "┴"
        begin = max(0, min(across - len(text), at - len(text) // 2))
        labels[begin : begin + len(text)] = text
    margin = " " * (AXIS - 1)
    return [[(f"{margin}└{''.join(line)}", "axis")], [(f"{margin} {''.join(labels[:across])}", "axis")]]


def _legend(curve: Curve, style: str, width: int, cursor: int | None) -> Parts:
    if cursor is not None and curve.lows:
        column = min(len(curve.lows) - 1, cursor * len(curve.lows) // max(1, width - AXIS))
        low, high = curve.lows[column], curve.highs[column]
        if low is not None and high is not None:
            shown = number(low) if low == high else f"{number(low)} to {number(high)}"
            return [("▪ ", style), (f"{curve.name}  at the cursor {shown}"[: width - 2], "")]
    lows = [value for value in curve.lows if value is not None]
    highs = [value for value in curve.highs if value is not None]
    if curve.last is None or not lows:
        return [("▪ ", style), (f"{curve.name}  no value"[: width - 2], "dim")]
    mean = "" if curve.mean is None else f"  mean {number(curve.mean)}"
    text = f"{curve.name}  {number(curve.last)}  min {number(min(lows))}{mean}  max {number(max(highs))}"
    return [("▪ ", style), (text[: width - 2], "")]
