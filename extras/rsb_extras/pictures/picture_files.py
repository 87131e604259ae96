"""Pictures of messages as files: PNG, SVG, CSV and text."""

from __future__ import annotations

import csv
import io
import struct
import zlib
from html import escape
from typing import TYPE_CHECKING

from rich.color import Color

from rsb_console.session.exports import cell
from rsb_extras.pictures.paper import Paper
from rsb_extras.pictures.picture import LONGEST_SIDE, Cells, Pixels, Series
from rsb_extras.pictures.picture_rows import picture_rows, rgb_of, scaled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_extras.pictures.picture_rows import Row

# A character of a monospace font of 15 px (below) is about 9 px wide.
_CELL_WIDTH, _CELL_HEIGHT = 9, 18
SVG_SHAPE = _CELL_HEIGHT / _CELL_WIDTH
"""Height of a cell over its width in SVG."""
_RGB, _DEPTH = 2, 8
_COLOURS = {
    "dim": "#808080", "strong": "#ffffff", "axis": "#808080", "ok": "#50c850", "warning": "#e0c040", "error": "#ff6060",
    "robot": "#60ffff", "path": "#40b0c0", "scan": "#d070d0", "free": "#606060", "goal": "#ffff60", "lethal": "#ff6060",
}  # fmt: skip
"""The styles of pictures in SVG."""
_PAPER = "#101010"
_ON = Paper.of(_PAPER, "#d0d0d0")


def picture_file(content: Cells | Pixels | Series, suffix: str) -> bytes:
    """Return a picture as the content of a file.

    Args:
        suffix: one of `FORMATS`.

    Raises:
        ValueError: such a picture cannot be written in this format.
    """
    write = _WRITERS.get((type(content), suffix))
    if write is None:
        raise ValueError(f"this picture can be written as {', '.join(formats_of(content))}")
    return write(content)


def squared(pixels: Pixels) -> Pixels:
    """Return an image with pixels as high as wide, as files have them, and at most `LONGEST_SIDE` of them on a side.

    Raises:
        UnreadableError: the other side's image is damaged.
    """
    if pixels.shape == 1.0:
        return pixels
    width, height = pixels.width * max(1.0, 1 / pixels.shape), pixels.height * max(1.0, pixels.shape)
    factor = min(1.0, LONGEST_SIDE / max(width, height))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    return Pixels(*size, scaled(rgb_of(pixels), pixels.width, pixels.height, *size))


def png(pixels: Pixels) -> bytes:
    """Return an image as PNG (ISO/IEC 15948)."""
    pixels = squared(pixels)
    line = 3 * pixels.width
    rgb = rgb_of(pixels)
    # Each line begins with the number of its filter; 0 is none.
    rows = b"".join(b"\0" + rgb[at : at + line] for at in range(0, len(rgb), line))
    head = struct.pack(">IIBBBBB", pixels.width, pixels.height, _DEPTH, _RGB, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def _svg(cells: Cells) -> bytes:
    return svg(picture_rows(cells, 0, 0))


def svg(rows: Sequence[Row]) -> bytes:
    """Return rows of characters as SVG."""
    width = max((sum(len(part.text) for part in row) for row in rows), default=1) * _CELL_WIDTH
    lines = []
    for number, row in enumerate(rows, 1):
        column, top = 0, (number - 1) * _CELL_HEIGHT
        for part in row:
            tint = part.background.removeprefix("@")
            if background := _ON.colour(tint) if tint != part.background else part.background and _colour(tint):
                place = f'x="{column * _CELL_WIDTH}" y="{top}" width="{len(part.text) * _CELL_WIDTH}"'
                lines.append(f'<rect {place} height="{_CELL_HEIGHT}" fill="{background}"/>')
            column += len(part.text)
        shown = "".join(f'<tspan fill="{_colour(part.style)}">{_escaped(part.text)}</tspan>' for part in row)
        lines.append(f'<text x="0" y="{number * _CELL_HEIGHT - 4}" xml:space="preserve">{shown}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{len(rows) * _CELL_HEIGHT}" '
        'font-family="monospace" font-size="15">'
        f'<rect width="100%" height="100%" fill="{_PAPER}"/>{"".join(lines)}</svg>\n'
    ).encode()


def _colour(style: str) -> str:
    if style.startswith("color("):
        return Color.parse(style).get_truecolor().hex
    if style.startswith("@"):
        return _ON.colour(style[1:]) or _PAPER
    return style if style.startswith("#") else _COLOURS.get(style, "#d0d0d0")


def _escaped(text: str) -> str:
    """Return text for XML, which has no U+FFFE and U+FFFF."""
    return escape(text.translate({0xFFFE: 0xFFFD, 0xFFFF: 0xFFFD}))


def _csv(series: Series) -> bytes:
    """Return numbers over time as CSV: the lowest and the highest value of each column of the plot."""
    made = io.StringIO()
    table = csv.writer(made, lineterminator="\n")
    table.writerow(["time", *(cell(f"{curve.name}.{which}") for curve in series.curves for which in ("low", "high"))])
    columns = zip(*(each for curve in series.curves for each in (curve.lows, curve.highs)), strict=True)
    for number, values in enumerate(columns):
        if any(value is not None for value in values):
            table.writerow([f"{series.start + number * series.step:.6f}", *values])
    return made.getvalue().encode()


def _text(cells: Cells) -> bytes:
    rows = ("".join(part.text for part in row) for row in picture_rows(cells, 0, 0, colours=0))
    return "".join(f"{row.rstrip()}\n" for row in rows).encode()


_WRITERS: dict[tuple[type, str], Callable[..., bytes]] = {
    (Pixels, ".png"): png,
    (Cells, ".svg"): _svg,
    (Cells, ".txt"): _text,
    (Series, ".csv"): _csv,
}


def formats_of(content: Cells | Pixels | Series) -> list[str]:
    """Return the suffixes of the files that a picture can be written to; the first one is usual."""
    return [suffix for kind, suffix in _WRITERS if kind is type(content)]


FORMATS = tuple(dict.fromkeys(suffix for _, suffix in _WRITERS))
"""Suffixes of the files."""
