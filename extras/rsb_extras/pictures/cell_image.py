"""Maps and plots as images, for terminals that show pixels.

The dots and blocks of a map's cells become pixels, a plot's curves are drawn in the resolution of the terminal, and
signs and text are drawn over them.
"""

from __future__ import annotations

import re
from itertools import cycle
from typing import TYPE_CHECKING, NamedTuple

from rsb_extras.pictures.drawing import Canvas
from rsb_extras.pictures.picture import Cells, Pixels, Series
from rsb_extras.pictures.picture_rows import AXIS, CURVE_STYLES, plot_frame, plot_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

    from rsb_extras.pictures.paper import Paper, Rgb
    from rsb_extras.pictures.picture_rows import Row

_BRAILLE = range(0x2800, 0x2900)
_QUARTERS = (0x01 | 0x02, 0x08 | 0x10, 0x04 | 0x40, 0x20 | 0x80)
"""Dots of a quarter of a cell, as `Canvas.BLOCKS` numbers them."""
_TEXT = re.compile(rf"[^\u2800-\u28ff{Canvas.BLOCKS}]")
_TEXT_PART = 0.7
"""Height of a font over a line's: as terminals have it."""
_PIXELS_A_DOT = 2.0
"""Pixels of a map's dot, at which thin lines are seen: with half as many, they get lost on a dense screen."""


_LONGEST = 4096
"""Pixels of an image in either direction. A round figure, more than a screen has."""


class Marked(NamedTuple):
    """An operator's own sign on a map, in characters from its upper left corner."""

    column: int
    row: int
    sign: str


class Inks(NamedTuple):
    """The colours and the cells of a terminal.

    Attributes:
        of: colour of each style that a picture has.
        cell: pixels of a character.
    """

    paper: Paper
    of: Mapping[str, Rgb]
    cell: tuple[float, float]


def fine_for(cell: tuple[float, float]) -> int:
    """Return the cells of a map in a character of so many pixels (`Wish.fine`)."""
    return max(1, min(4, int(cell[0] / Canvas.ACROSS / _PIXELS_A_DOT + 0.5)))


def is_drawn(content: object) -> bool:
    """Whether a picture is one of these in a terminal that shows pixels."""
    return isinstance(content, Series) or (isinstance(content, Cells) and content.fine > 1)


def styles_in(content: Cells | Series) -> set[str]:
    """Return the styles of a picture's dots and text."""
    named = {style for style in content.palette if not style.startswith("@")} if isinstance(content, Cells) else set()
    return {"", "axis", "dim", "goal", *CURVE_STYLES, *named}


def image_of(
    content: Cells | Series,
    size: tuple[int, int],
    shape: float,
    inks: Inks,
    *,
    cursor: int | None = None,
    mark: Marked | None = None,
) -> Pixels:
    """Return a picture as an image. This takes some 10 ms, so call it on a thread.

    Args:
        size: columns and rows that a plot fills.
        shape: height of a character over its width.
        cursor: as in `rsb_extras.pictures.picture_rows.picture_rows`.
        mark: an operator's sign, in the style ``goal``.
    """
    if isinstance(content, Series):
        image, cell = _plot(content, size, inks, cursor)
    else:
        image, cell = _map(content, inks, mark)
    # A pixel is as high as its part of a character.
    return Pixels(image.width, image.height, image.tobytes(), shape=shape * cell[0] / cell[1])


def _map(cells: Cells, inks: Inks, mark: Marked | None) -> tuple[Image, tuple[int, int]]:
    from PIL import Image, ImageDraw  # noqa: PLC0415 -- optional

    if not any(cells.rows):
        cells = Cells((" ",), fine=cells.fine)
    width, height, fine = max(map(len, cells.rows)), len(cells.rows), cells.fine
    across, down = Canvas.ACROSS * width, Canvas.DOWN * height
    palette = cells.palette or ("",)
    styles = _padded(cells, cells.styles, width)
    patterns = b"".join(row.translate(_PATTERNS).encode("latin-1").ljust(width, b"\0") for row in cells.rows)
    if "free" in palette:  # its dots are for terminals without the colour
        free = palette.index("free")
        patterns = bytes(0 if style == free else each for each, style in zip(patterns, styles, strict=True))
    ink = _coloured(styles, [_ink(style, inks) for style in palette], (width, height))
    ground = _coloured(
        _padded(cells, cells.backgrounds, width), [_tint(style, inks) for style in palette], (width, height)
    )
    dots = Image.frombytes("L", (across, down), bytes(_mask(patterns, width, height)))
    upper, lower = (each.resize((across, down), Image.Resampling.NEAREST) for each in (ink, ground))
    image = Image.composite(upper, lower, dots)
    # Whole pixels for each dot: the terminal does the rest.
    wide = _factor(inks.cell[0] / fine / Canvas.ACROSS, across)
    high = _factor(inks.cell[1] / fine / Canvas.DOWN, down)
    image = image.resize((across * wide, down * high), Image.Resampling.NEAREST)
    one = Canvas.ACROSS * wide, Canvas.DOWN * high
    cell = fine * one[0], fine * one[1]
    pen = _Pen(ImageDraw.Draw(image), cell, inks.paper.background)
    for column, row, style, text in _texts(cells, styles, width):
        pen.write(column * one[0], row * one[1], text, _ink(palette[style], inks))
    if mark is not None:
        pen.write(mark.column * cell[0], mark.row * cell[1], mark.sign, inks.of["goal"])
    return image, cell


def _factor(pixels: float, dots: int) -> int:
    """Return the pixels of a dot in one direction; a stranger's picture must not be huge."""
    return max(1, min(round(pixels), _LONGEST // max(1, dots)))


def _padded(cells: Cells, indices: bytes, width: int) -> bytes:
    """Return the index of each cell, also of rows that are shorter than the picture."""
    at, rows = 0, []
    for row in cells.rows:
        rows.append((indices[at : at + len(row)] or bytes(len(row))).ljust(width, b"\0"))
        at += len(row)
    return b"".join(rows)


class _Patterns(dict[int, str]):
    """The dots of each character as another character, by `str.translate`: none of text."""

    def __missing__(self, character: int) -> str:
        return "\0"


_PATTERNS = _Patterns({code: chr(code - _BRAILLE.start) for code in _BRAILLE})
_PATTERNS |= {
    ord(block): chr(sum(dots for number, dots in enumerate(_QUARTERS) if bits & 1 << number))
    for bits, block in enumerate(Canvas.BLOCKS[: Canvas.A_DOT])
}


def _mask(patterns: bytes, width: int, height: int) -> bytearray:
    """Return a byte for each dot, 255 if it is set."""
    line = Canvas.ACROSS * width
    mask = bytearray(line * Canvas.DOWN * height)
    for y, bits in enumerate(Canvas.BITS):
        for x, bit in enumerate(bits):
            plane = patterns.translate(bytes(255 if pattern & bit else 0 for pattern in range(256)))
            for row in range(height):
                at = (Canvas.DOWN * row + y) * line
                mask[at + x : at + line : Canvas.ACROSS] = plane[row * width : (row + 1) * width]
    return mask


def _coloured(indices: bytes, colours: Sequence[Rgb], size: tuple[int, int]) -> Image:
    from PIL import Image  # noqa: PLC0415 -- optional

    image = Image.frombytes("P", size, indices)
    image.putpalette([part for colour in colours for part in colour])
    return image.convert("RGB")


def _ink(style: str, inks: Inks) -> Rgb:
    return _tint(style[1:], inks) if style.startswith("@") else inks.of[style]


def _tint(style: str, inks: Inks) -> Rgb:
    from PIL.ImageColor import getrgb  # noqa: PLC0415 -- optional

    red, green, blue = getrgb(inks.paper.colour(style.removeprefix("@")) or inks.paper.own)[:3]
    return red, green, blue


def _texts(cells: Cells, styles: bytes, width: int) -> Iterator[tuple[int, int, int, str]]:
    """Yield column, row and style of each word, and the word; its characters are `Cells.fine` cells apart."""
    for row, line in enumerate(cells.rows):
        words: list[tuple[int, int, list[str]]] = []
        for found in _TEXT.finditer(line):
            column, style = found.start(), styles[row * width + found.start()]
            if words and words[-1][1] == style:
                gap, rest = divmod(column - words[-1][0] - cells.fine * len(words[-1][2]), cells.fine)
                if not rest and gap in (0, 1):  # a single space is a part of the text
                    words[-1][2].extend(" " * gap + found.group())
                    continue
            words.append((column, style, [found.group()]))
        for column, style, characters in words:
            yield column, row, style, "".join(characters)


# --- plots


def _plot(series: Series, size: tuple[int, int], inks: Inks, cursor: int | None) -> tuple[Image, tuple[int, int]]:
    from PIL import Image, ImageDraw  # noqa: PLC0415 -- optional

    columns, rows = size
    cell = max(1, round(inks.cell[0])), max(1, round(inks.cell[1]))
    image = Image.new("RGB", (columns * cell[0], rows * cell[1]), inks.paper.background)
    draw = ImageDraw.Draw(image)
    pen = _Pen(draw, cell, inks.paper.background)
    for row, line in enumerate(plot_rows(series, columns, rows, cursor, with_curves=False)):
        for column, style, word in _words(line):
            pen.write(column * cell[0], row * cell[1], word, inks.of[style])
    frame = plot_frame(series, columns, rows)
    left, width, height = AXIS * cell[0], frame.columns * cell[0], frame.rows * cell[1]
    if cursor is not None:
        x = left + (cursor + 0.5) * cell[0]
        draw.line((x, 0, x, height), inks.of["dim"])
    for curve, style in zip(series.curves, cycle(CURVE_STYLES), strict=False):
        count = len(curve.lows)
        before: tuple[float, float] | None = None
        for number, (low, high) in enumerate(zip(curve.lows, curve.highs, strict=False)):
            if low is None or high is None:
                continue
            x = left + (number + 0.5) * width / count
            ends = [(x, frame.part(value) * (height - 1)) for value in (low, high)]
            if before is not None:  # connected, also over columns without a message, from the nearer end
                ends.sort(key=lambda end, y=before[1]: abs(end[1] - y))  # type: ignore[misc]
                ends.insert(0, before)
            draw.line(ends, inks.of[style], width=max(1, cell[0] // 5))
            before = ends[-1]
    return image, cell


def _words(line: Row) -> Iterator[tuple[int, str, str]]:
    """Yield column and style of each word of a row of characters, and the word."""
    at = 0
    for part in line:
        for found in re.finditer(r"\S+(?: \S+)*", part.text):
            yield at + found.start(), part.style, found.group()
        at += len(part.text)


# --- signs and text


class _Pen:
    """Writes text into an image.

    Args:
        cell: pixels of a character.
        paper: colour round the characters, so that they can be read on any ground.
    """

    def __init__(self, draw: ImageDraw, cell: tuple[int, int], paper: Rgb) -> None:
        from PIL import ImageFont  # noqa: PLC0415 -- optional

        self._draw = draw
        self._cell = cell
        self._paper = paper
        self._font = ImageFont.load_default(max(6, cell[1] * _TEXT_PART))

    def write(self, x: int, y: int, text: str, colour: Rgb) -> None:
        """Write text from the upper left corner of its first character on."""
        begin = 0
        for number, character in enumerate(text):
            if (sign := _SIGNS.get(character)) is not None:
                self._letters(x, y, begin, text[begin:number], colour)
                width, height = self._cell
                sign(self._draw, x + number * width, y, width, height, colour)
                begin = number + 1
        self._letters(x, y, begin, text[begin:], colour)

    def _letters(self, x: int, y: int, first: int, text: str, colour: Rgb) -> None:
        if text:
            # Its letters may be wider than cells: "now" at the end of an axis.
            room = self._draw.im.size[0] - self._draw.textlength(text, self._font) - 1
            at = max(0, min(x + first * self._cell[0], room)), y + self._cell[1] // 2
            self._draw.text(at, text, colour, self._font, anchor="lm", stroke_width=1, stroke_fill=self._paper)


def _polygon(*corners: tuple[float, float], filled: bool = True) -> Callable[..., None]:
    """Return a sign of these corners, in parts of a cell across and down."""

    def sign(draw: ImageDraw, x: float, y: float, width: float, height: float, colour: Rgb) -> None:
        points = [(x + across * width, y + down * height) for across, down in corners]
        draw.polygon(points, fill=colour if filled else None, outline=colour)

    return sign


def _lines(*ends: tuple[float, float, float, float]) -> Callable[..., None]:
    """Return a sign of lines between two ends each, in parts of a cell across and down."""

    def sign(draw: ImageDraw, x: float, y: float, width: float, height: float, colour: Rgb) -> None:
        for x0, y0, x1, y1 in ends:
            draw.line((x + x0 * width, y + y0 * height, x + x1 * width, y + y1 * height), fill=colour)

    return sign


_SQUARE = (0.1, 0.3), (0.9, 0.3), (0.9, 0.7), (0.1, 0.7)
_LEFT, _RIGHT, _UP, _DOWN = (0, 0.5, 0.5, 0.5), (0.5, 0.5, 1, 0.5), (0.5, 0, 0.5, 0.5), (0.5, 0.5, 0.5, 1)
_SIGNS: dict[str, Callable[..., None]] = {
    "■": _polygon(*_SQUARE),
    "□": _polygon(*_SQUARE, filled=False),
    "▪": _polygon((0.25, 0.38), (0.75, 0.38), (0.75, 0.62), (0.25, 0.62)),
    "•": _polygon((0.3, 0.4), (0.7, 0.4), (0.7, 0.6), (0.3, 0.6)),
    "·": _polygon((0.4, 0.45), (0.6, 0.45), (0.6, 0.55), (0.4, 0.55)),
    "◆": _polygon((0.5, 0.15), (1, 0.5), (0.5, 0.85), (0, 0.5)),
    "▶": _polygon((0, 0.2), (1, 0.5), (0, 0.8)),
    "◀": _polygon((1, 0.2), (0, 0.5), (1, 0.8)),
    "▲": _polygon((0.5, 0.2), (1, 0.8), (0, 0.8)),
    "▼": _polygon((0.5, 0.8), (1, 0.2), (0, 0.2)),
    "─": _lines(_LEFT, _RIGHT),
    "│": _lines(_UP, _DOWN),
    "├": _lines(_UP, _DOWN, _RIGHT),
    "┤": _lines(_UP, _DOWN, _LEFT),
    "└": _lines(_UP, _RIGHT),
    "┴": _lines(_LEFT, _RIGHT, _UP),
    "→": _polygon((0, 0.42), (0.5, 0.42), (0.5, 0.25), (1, 0.5), (0.5, 0.75), (0.5, 0.58), (0, 0.58)),
    "←": _polygon((1, 0.42), (0.5, 0.42), (0.5, 0.25), (0, 0.5), (0.5, 0.75), (0.5, 0.58), (1, 0.58)),
    "↑": _polygon((0.35, 0.9), (0.35, 0.45), (0, 0.45), (0.5, 0.1), (1, 0.45), (0.65, 0.45), (0.65, 0.9)),
    "↓": _polygon((0.35, 0.1), (0.35, 0.55), (0, 0.55), (0.5, 0.9), (1, 0.55), (0.65, 0.55), (0.65, 0.1)),
    "↗": _polygon((1, 0.2), (1, 0.65), (0.2, 0.9), (0, 0.8), (0.25, 0.2)),
    "↖": _polygon((0, 0.2), (0, 0.65), (0.8, 0.9), (1, 0.8), (0.75, 0.2)),
    "↘": _polygon((1, 0.8), (1, 0.35), (0.2, 0.1), (0, 0.2), (0.25, 0.8)),
    "↙": _polygon((0, 0.8), (0, 0.35), (0.8, 0.1), (1, 0.2), (0.75, 0.8)),
}
"""Signs that a font may lack, by their characters."""
