"""Images as rows of a terminal's characters."""

from __future__ import annotations

import io
import warnings
from importlib.util import find_spec
from itertools import groupby
from typing import Literal, NamedTuple, TypeAlias

from rsb_extras.pictures.picture import MOST_COLUMNS, MOST_ROWS, Pixels

RAMP = " .:-=+*#%@"
"""Characters for an image on a terminal without colours, from dark to light."""
_UPPER_HALF = "▀"
COLOURS = {None: 0, "standard": 16, "windows": 16, "256": 256, "truecolor": 1 << 24}
"""The number of a terminal's colours, by rich's name of its colour system."""
_FEW = 16
_GREYS = ("#000000", "#555555", "#aaaaaa", "#ffffff")
"""The greys of a terminal with 16 colours. Its other colours would make blotches of an image."""
_BAYER = ((0, 8, 2, 10), (12, 4, 14, 6), (3, 11, 1, 9), (15, 7, 13, 5))
"""Thresholds of ordered dithering, in sixteenths of a step: unlike diffused errors they do not flicker from picture to
picture."""
_SIDE = len(_BAYER)
Sign: TypeAlias = Literal["quadrants", "sextants"]
"""Block characters beyond the half blocks that a terminal's font has: quarters, or sixths (Unicode 13)."""
QUADRANTS: frozenset[Sign] = frozenset({"quadrants"})


def _shades(threshold: int) -> bytes:
    """Return the index of the grey for each brightness, where a pixel has a threshold."""
    steps = len(_GREYS) - 1
    return bytes(min(steps, (grey * steps * 16 // 255 + threshold) // 16) for grey in range(256))


_SHADES = tuple(tuple(map(_shades, row)) for row in _BAYER)


class Part(NamedTuple):
    """Some cells of one row.

    Attributes:
        style: a style of `rsb_extras.pictures.picture.STYLES`, or the characters' colour as ``#rrggbb``.
        background: a colour as ``#rrggbb``, or an empty string for the terminal's own.
    """

    text: str
    style: str = ""
    background: str = ""


Row: TypeAlias = tuple[Part, ...]


def wished_pixels(colours: int, signs: frozenset[Sign]) -> tuple[int, int]:
    """Return the pixels across and down a cell that `image_rows` makes use of: always twice as many down."""
    return 1, 2


def image_rows(
    pixels: Pixels, width: int, height: int, *, colours: int = 256, signs: frozenset[Sign] = QUADRANTS
) -> list[Row]:
    """Return an image's rows.

    Args:
        width: cells that it fills at most.
        height: cells that it fills at most.
        colours: the terminal's. With few, images are dithered in greys; without, they are drawn in ASCII by brightness.

    Raises:
        UnreadableError: the other side's image is damaged, or larger than any that blocks are asked for.
    """
    # A larger image comes from a hostile side, and would hold the app up.
    if pixels.width > MOST_COLUMNS or pixels.height > 2 * MOST_ROWS:
        raise UnreadableError("an image is larger than any that blocks are asked for")
    if colours > _FEW:
        return _half_blocks(pixels)
    return _dithered(pixels) if colours else _brightness(pixels)


class UnreadableError(ValueError):
    """The bytes of an image are not what they should be."""


def reads_webp() -> bool:
    """Whether images in WebP can be shown."""
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
        if image.size == (pixels.width, pixels.height):
            return image.convert("RGB").tobytes()
    except UnidentifiedImageError:  # its text names an object of Python
        raise UnreadableError("an image cannot be read: it has no header") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise UnreadableError(f"an image cannot be read: {error}") from None
    raise UnreadableError("an image has another size than it says")


def _half_blocks(pixels: Pixels) -> list[Row]:
    width, rgb, line = pixels.width, rgb_of(pixels), 3 * pixels.width
    rows: list[Row] = []
    for y in range(0, pixels.height, 2):
        upper = rgb[y * line : (y + 1) * line]
        # The last row of an odd height has no lower half.
        lower = rgb[(y + 1) * line : (y + 2) * line].ljust(line, b"\0")
        both = [(upper[at : at + 3], lower[at : at + 3]) for at in range(0, 3 * width, 3)]
        # One part for cells of one colour: each part is an escape sequence on the line.
        runs = ((colours, len([*same])) for colours, same in groupby(both))
        rows.append(
            tuple(Part(_UPPER_HALF * count, f"#{fore.hex()}", f"#{back.hex()}") for (fore, back), count in runs)
        )
    return rows


def _dithered(pixels: Pixels) -> list[Row]:
    """Draw an image in the few greys of a terminal."""
    width, grey = pixels.width, _grey(pixels)
    lines = []
    for y in range(pixels.height):
        line = bytearray(grey[y * width : (y + 1) * width])
        for x, shades in enumerate(_SHADES[y % _SIDE]):
            # All pixels of a row with one threshold in one call, not in a loop of Python.
            line[x::_SIDE] = line[x::_SIDE].translate(shades)
        lines.append(line)
    rows: list[Row] = []
    for y in range(0, pixels.height, 2):
        lower = lines[y + 1] if y + 1 < len(lines) else bytes(width)
        runs = ((shades, len([*same])) for shades, same in groupby(zip(lines[y], lower, strict=True)))
        rows.append(tuple(Part(_UPPER_HALF * count, _GREYS[fore], _GREYS[back]) for (fore, back), count in runs))
    return rows


def _grey(pixels: Pixels) -> bytes:
    """Return the brightness of each pixel."""
    rgb = rgb_of(pixels)
    return bytes((54 * rgb[at] + 183 * rgb[at + 1] + 19 * rgb[at + 2]) >> 8 for at in range(0, len(rgb), 3))  # Rec. 709


def _brightness(pixels: Pixels) -> list[Row]:
    width, grey = pixels.width, _grey(pixels)
    rows: list[Row] = []
    for y in range(0, pixels.height, 2):
        upper = grey[y * width : (y + 1) * width]
        lower = grey[(y + 1) * width : (y + 2) * width] or upper
        means = ((above + below) // 2 for above, below in zip(upper, lower, strict=True))
        rows.append((Part("".join(RAMP[mean * len(RAMP) // 256] for mean in means)),))
    return rows
