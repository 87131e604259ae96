"""Pictures of messages as files: PNG, SVG, CSV and text."""

from __future__ import annotations

import struct
import zlib
from html import escape
from typing import TYPE_CHECKING

from rsb_bridge.model.pictures import Cells, Pixels, Series
from rsb_console.look.picture_rows import rgb_of

if TYPE_CHECKING:
    from collections.abc import Callable

_CELL_WIDTH, _CELL_HEIGHT = 9, 18
_RGB, _DEPTH = 2, 8


def picture_file(content: Cells | Pixels | Series, suffix: str) -> bytes:
    """Return a picture as the content of a file.

    Args:
        content: of the picture.
        suffix: one of `FORMATS`.

    Raises:
        ValueError: such a picture cannot be written in this format.
    """
    write = _WRITERS.get((type(content), suffix))
    if write is None:
        raise ValueError(f"this picture can be written as {', '.join(formats_of(content))}")
    return write(content)


def _png(pixels: Pixels) -> bytes:
    """Return an image as PNG (ISO/IEC 15948)."""
    line = 3 * pixels.width
    rgb = rgb_of(pixels)
    rows = b"".join(b"\0" + rgb[at : at + line] for at in range(0, len(rgb), line))
    head = struct.pack(">IIBBBBB", pixels.width, pixels.height, _DEPTH, _RGB, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def _svg(cells: Cells) -> bytes:
    """Return characters as SVG."""
    width = max(map(len, cells.rows), default=1) * _CELL_WIDTH
    height = len(cells.rows) * _CELL_HEIGHT
    lines, at = [], 0
    for row, text in enumerate(cells.rows):
        spans = []
        for character in text:
            style = cells.palette[cells.styles[at]] if cells.styles else ""
            at += 1
            colour = style if style.startswith("#") else "#d0d0d0"
            spans.append((character, colour))
        shown = "".join(f'<tspan fill="{colour}">{escape(character)}</tspan>' for character, colour in spans)
        lines.append(f'<text x="0" y="{(row + 1) * _CELL_HEIGHT - 4}" xml:space="preserve">{shown}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="monospace" '
        f'font-size="15"><rect width="100%" height="100%" fill="#101010"/>{"".join(lines)}</svg>\n'
    ).encode()


def _csv(series: Series) -> bytes:
    """Return numbers over time as CSV: the lowest and the highest value of each column of the plot."""
    head = ["time"] + [f"{curve.name}.{which}" for curve in series.curves for which in ("low", "high")]
    lines = [",".join(f'"{each}"' for each in head)]
    columns = max((len(curve.lows) for curve in series.curves), default=0)
    for column in range(columns):
        values = [value for curve in series.curves for value in (curve.lows[column], curve.highs[column])]
        texts = ["" if value is None else repr(value) for value in values]
        if any(texts):
            lines.append(",".join([f"{series.start + column * series.step:.6f}", *texts]))
    return ("\n".join(lines) + "\n").encode()


def _text(cells: Cells) -> bytes:
    return "".join(f"{row.rstrip()}\n" for row in cells.rows).encode()


_WRITERS: dict[tuple[type, str], Callable[..., bytes]] = {
    (Pixels, ".png"): _png,
    (Cells, ".svg"): _svg,
    (Cells, ".txt"): _text,
    (Series, ".csv"): _csv,
}


def formats_of(content: Cells | Pixels | Series) -> list[str]:
    """Return the suffixes of the files that a picture can be written to; the first one is usual."""
    return [suffix for kind, suffix in _WRITERS if kind is type(content)]


FORMATS = tuple(dict.fromkeys(suffix for _, suffix in _WRITERS))
"""Suffixes of the files."""
