"""Pictures of messages as rows of a terminal: styled characters, or plots in braille."""

from __future__ import annotations

import io
import math
import warnings
from importlib.util import find_spec
from itertools import cycle, groupby
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_extras.pictures.picture import Series

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_extras.pictures.picture import Cells, Curve, Pixels

_FEW = 16
_COST = "·"
"""A cell with a cost, on a terminal without colours."""
CURVE_STYLES = ("curve", "goal", "ok", "scan", "strong", "path", "error", "dim")
"""Those that all themes colour differently."""
_DOT_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BRAILLE = 0x2800
_DOTS_ACROSS, _DOTS_DOWN = 2, 4
AXIS = 10
"""Cells of a plot's labels of values, with the axis: a label such as -1.23e-05 has nine."""
_TICK_ROWS, _TICK_COLUMNS = 4, 16
"""Least rows and columns from one label to the next. A label of time takes up to eleven columns."""
_TICK_STEPS = (1, 2, 5)
_MINUTE, _IN_MINUTES = 60.0, 240.0
"""s; and length of a time axis, from which on it has minutes."""


class Part(NamedTuple):
    """Some cells of one row.

    Attributes:
        style: a style of `rsb_extras.pictures.picture.STYLES`, or a colour as ``#rrggbb`` or ``color(7)``, or after an
            ``@`` a tint (`rsb_extras.pictures.paper`).
        background: a colour, or after an ``@`` a tint, or an empty string for the terminal's own.
    """

    text: str
    style: str = ""
    background: str = ""


Row = tuple[Part, ...]


def picture_rows(
    content: Cells | Series, width: int, height: int, *, colours: int = 256, cursor: int | None = None
) -> list[Row]:
    """Return a picture's rows; those of an image are in `rsb_extras.pictures.blocks`.

    Args:
        width: cells that a plot fills.
        height: cells that a plot fills.
        colours: the terminal's.
        cursor: column of a plot, from the left edge of its curves, whose values the legend shows, or None.
    """
    return plot_rows(content, width, height, cursor) if isinstance(content, Series) else _cells(content, colours)


def with_mark(rows: list[Row], column: int, row: int, part: Part, width: int) -> list[Row]:
    """Return a picture's rows with one cell replaced; outside of the picture nothing changes.

    Args:
        rows: of a picture whose characters take one cell each.
        part: a character and its style.
        width: cells of the picture, whose rows may be shorter.
    """
    if not (0 <= column < width and 0 <= row < len(rows)):
        return rows
    before: list[Part] = []
    after: list[Part] = []
    at = 0
    for each in rows[row]:
        if at <= column < at + len(each.text) and each.background.startswith("@"):
            part = part._replace(background=each.background)  # the ground of a map goes on below the mark
        before.append(each._replace(text=each.text[: max(0, column - at)]))
        after.append(each._replace(text=each.text[max(0, column + 1 - at) :]))
        at += len(each.text)
    gap = Part(" " * max(0, column - at))
    parts = (*before, gap, part, *after)
    return [*rows[:row], tuple(each for each in parts if each.text), *rows[row + 1 :]]


class UnreadableError(ValueError):
    """The bytes of an image are not what they should be."""


def has_pillow() -> bool:
    """Whether images in WebP can be read, and maps and plots drawn as images."""
    return find_spec("PIL") is not None


def rgb_of(pixels: Pixels) -> bytes:
    """Return an image's pixels, three bytes each.

    Raises:
        UnreadableError: the other side's WebP file is damaged.
    """
    if pixels.coding == "rgb":
        return pixels.data
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 -- optional, and needed only for images

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked before it is read
            image = Image.open(io.BytesIO(pixels.data), formats=["WEBP"])  # no other decoder for a stranger's bytes
        factor = 2 if pixels.coding == "webp-doubled" else 1
        if image.size == (factor * pixels.width, factor * pixels.height):
            rgb = image.convert("RGB")
            return (rgb.reduce(factor) if factor > 1 else rgb).tobytes()
    except UnidentifiedImageError:  # its text names an object of Python
        raise UnreadableError("an image cannot be read: it has no header") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise UnreadableError(f"an image cannot be read: {error}") from None
    raise UnreadableError("an image has another size than it says")


def scaled(rgb: bytes, width: int, height: int, new_width: int, new_height: int) -> bytes:
    """Return an image in another size, by the nearest of its pixels, three bytes each."""
    if (width, height) == (new_width, new_height):
        return rgb
    places = [3 * ((2 * x + 1) * width // (2 * new_width)) for x in range(new_width)]
    lines = {}
    rows = [(2 * y + 1) * height // (2 * new_height) for y in range(new_height)]
    for row in {*rows}:
        line = rgb[3 * width * row : 3 * width * (row + 1)]
        lines[row] = b"".join(line[at : at + 3] for at in places)
    return b"".join(lines[row] for row in rows)


def _cells(cells: Cells, colours: int) -> list[Row]:
    rows: list[Row] = []
    at = 0
    palette = cells.palette or ("",)
    tints = [f"@{tint}" if _is_shown(tint := style.removeprefix("@"), colours) else "" for style in palette]
    for text in cells.rows:
        styles = cells.styles[at : at + len(text)] or bytes(len(text))
        backgrounds = cells.backgrounds[at : at + len(text)] or bytes(len(text))
        at += len(text)
        parts: list[Part] = []
        begin = 0
        for (style, background), same in groupby(zip(styles, backgrounds, strict=True)):
            end = begin + len([*same])
            name, tint = palette[style], tints[background] if cells.backgrounds else ""
            shown = text[begin:end]
            begin = end
            if name.startswith("@") and not tints[style]:
                shown, name = " " * len(shown), ""  # half of a cell in a colour that this terminal lacks
            elif name == "free" and tint:
                shown, name = " " * len(shown), ""  # the dots say what the colour says
            elif not colours and cells.backgrounds and not shown.strip() and palette[background].startswith("#"):
                shown = _COST * len(shown)
            if parts and parts[-1][1:] == (name, tint):
                shown = parts.pop().text + shown
            parts.append(Part(shown, name, tint))
        rows.append(tuple(parts))
    return rows


def _is_shown(tint: str, colours: int) -> bool:
    """Whether a terminal has colours for a tint; 16 are too few for those between background and foreground."""
    return tint != "" and (colours > _FEW or (colours == _FEW and tint.startswith("#")))


class PlotFrame(NamedTuple):
    """The part of a plot that has the curves.

    Attributes:
        columns: cells, behind those of the axis.
        rows: cells.
        low: value at its lower edge.
        high: value at its upper edge.
    """

    columns: int
    rows: int
    low: float
    high: float

    def part(self, value: float) -> float:
        """Return the distance of a value from the upper edge, in parts of the height."""
        return (self.high - value) / (self.high - self.low)


def plot_frame(series: Series, width: int, height: int) -> PlotFrame:
    """Return the frame of a plot in so many cells; a pane may be smaller than its legend and axes."""
    rows = max(1, height - len(series.curves) - 2)
    return PlotFrame(max(1, width - AXIS), rows, *_value_range(series))


def plot_rows(series: Series, width: int, height: int, cursor: int | None, *, with_curves: bool = True) -> list[Row]:
    """Draw curves, axes, and a legend with the newest, lowest, mean and highest values; two columns fill one cell.

    Args:
        cursor: as in `picture_rows`.
        with_curves: whether to draw the curves and the cursor, too.
    """
    styles_of = cycle(CURVE_STYLES)
    legend = [_legend(curve, next(styles_of), width, cursor) for curve in series.curves]
    across, rows, low, high = plot_frame(series, width, height)
    drawn = series if with_curves else msgspec.structs.replace(series, curves=())
    dots, styles = _dots(drawn, across, rows, low, high)
    ticks = _ticks(low, high, max(2, rows // _TICK_ROWS))
    labels = {_row_of_value(tick, low, high, rows): _number(tick) for tick in ticks}
    lines: list[Row] = []
    for row in range(rows):
        label = labels.get(row, "")
        parts = [Part(f"{label:>{AXIS - 1}}", "axis"), Part("┤" if label else "│", "axis")]
        for column in range(across):
            style = styles[row][column]
            character = chr(_BRAILLE + dots[row][column]) if dots[row][column] else " "
            if with_curves and column == cursor and not dots[row][column]:
                character, style = "│", "dim"
            # The first two parts are the label and the axis, which stay apart.
            if parts[-1].style == style and len(parts) > 2:
                parts[-1] = Part(parts[-1].text + character, style)
            else:
                parts.append(Part(character, style))
        lines.append(tuple(parts))
    return [*lines, *_time_axis(series, across), *legend][:height]


def _value_range(series: Series) -> tuple[float, float]:
    """Return the lowest and the highest value, some way apart."""
    values = [value for curve in series.curves for value in (*curve.lows, *curve.highs) if value is not None]
    low, high = min(values, default=0.0), max(values, default=1.0)
    # A constant curve: all further figures divide by the range.
    if high - low < 1e-9 * max(1.0, abs(high)):
        margin = max(abs(high) * 0.1, 1e-3)
        return low - margin, high + margin
    return low, high


def _row_of_value(value: float, low: float, high: float, rows: int) -> int:
    return min(rows - 1, max(0, round((high - value) / (high - low) * (rows * _DOTS_DOWN - 1)) // _DOTS_DOWN))


def _dots(series: Series, across: int, rows: int, low: float, high: float) -> tuple[list[list[int]], list[list[str]]]:
    dots = [[0] * across for _ in range(rows)]
    styles = [[""] * across for _ in range(rows)]
    last = rows * _DOTS_DOWN - 1
    for at, curve in enumerate(series.curves):
        style, before = CURVE_STYLES[at % len(CURVE_STYLES)], None
        columns = list(zip(curve.lows, curve.highs, strict=False))
        for x in range(across * _DOTS_ACROSS):
            column = int(x * len(columns) / (across * _DOTS_ACROSS))
            least, most = columns[column] if column < len(columns) else (None, None)
            if least is None or most is None:
                continue
            top, bottom = (round((high - value) / (high - low) * last) for value in (most, least))
            if before is not None:  # connect a curve's steps, which would be dots with gaps
                top, bottom = min(top, before[1]), max(bottom, before[0])
            before = tuple(round((high - value) / (high - low) * last) for value in (most, least))
            for y in range(max(0, top), min(last, bottom) + 1):
                dots[y // _DOTS_DOWN][x // _DOTS_ACROSS] |= _DOT_BITS[y % _DOTS_DOWN][x % _DOTS_ACROSS]
                styles[y // _DOTS_DOWN][x // _DOTS_ACROSS] = style
    return dots, styles


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Return round values between two, at most so many."""
    rough = (high - low) / most
    power = 10 ** math.floor(math.log10(rough))
    step = next((each * power for each in _TICK_STEPS if each * power >= rough), 10 * power)
    first = math.ceil(low / step)
    return [(first + at) * step for at in range(most + 1) if (first + at) * step <= high]


def _time_axis(series: Series, across: int) -> list[Row]:
    """Return the line of the time axis, and its labels in seconds before the newest message."""
    columns = max((len(curve.lows) for curve in series.curves), default=0) or 1
    seconds = series.step * columns
    unit, name = (_MINUTE, "min") if seconds >= _IN_MINUTES else (1.0, "s")
    line, labels = ["─"] * across, [" "] * across
    for tick in _ticks(-seconds / unit, 0.0, max(1, across // _TICK_COLUMNS)):
        at = min(across - 1, round((tick * unit + seconds) / seconds * (across - 1)))
        text = "now" if abs(tick) < 1e-9 else f"{_number(tick)} {name}"
        line[at] = "┴"
        begin = max(0, min(across - len(text), at - len(text) // 2))
        labels[begin : begin + len(text)] = text
    margin = " " * (AXIS - 1)
    return [(Part(f"{margin}└{''.join(line)}", "axis"),), (Part(f"{margin} {''.join(labels[:across])}", "axis"),)]


def _legend(curve: Curve, style: str, width: int, cursor: int | None) -> Row:
    if cursor is not None and curve.lows:
        column = min(len(curve.lows) - 1, cursor * len(curve.lows) // max(1, width - AXIS))
        low, high = curve.lows[column], curve.highs[column]
        if low is not None and high is not None:
            shown = _number(low) if low == high else f"{_number(low)} to {_number(high)}"
            return Part("▪ ", style), Part(f"{curve.name}  at the cursor {shown}"[: width - 2])
    lows = [value for value in curve.lows if value is not None]
    highs = [value for value in curve.highs if value is not None]
    if curve.last is None or not lows:
        return Part("▪ ", style), Part(f"{curve.name}  no value"[: width - 2], "dim")
    newest, lowest, highest = _number(curve.last), f"min {_number(min(lows))}", f"max {_number(max(highs))}"
    mean = () if curve.mean is None else (f"mean {_number(curve.mean)}",)
    return Part("▪ ", style), Part(_figures(curve.name, newest, (lowest, *mean, highest), (lowest, highest), width - 2))


def _figures(name: str, newest: str, all_others: Sequence[str], few: Sequence[str], width: int) -> str:
    """Return a number's name and figures, as many of these as have room."""
    for others in (all_others, few, ()):
        text = "  ".join((name, newest, *others))
        if len(text) <= width:
            return text
    return f"{name[: max(0, width - len(newest) - 2)]}  {newest}"[:width]


def _number(value: float) -> str:
    """Format a value in few characters."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}"
    # Without the plus, the largest numbers have no more characters than a small negative one.
    return f"{value:.2e}".replace("e+", "e")
