"""Images as characters: blocks in two colours a cell, of the shapes and colours that differ least from the image.

Colours are compared in Oklab (Ottosson, 2020), where equal distances look equal. No library does this for a console
that runs for months: term-image and textual-image have half blocks only, and chafa.py 1.2 never frees its pictures, 0.3
MB each (docs/picture-costs.md). Without numpy, which the extra ``look`` brings, there are half blocks.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_extras.pictures.graphics import frame_of
from rsb_extras.pictures.picture_rows import Part, rgb_of, scaled

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rsb_extras.pictures.graphics import Extent
    from rsb_extras.pictures.picture import Pixels, Wish
    from rsb_extras.pictures.picture_rows import Row

    Array = NDArray[Any]

RAMP = " .:-=+*#%@"
"""Characters for an image on a terminal without colours, from dark to light."""
_QUADRANTS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"
_SHADES = "░▒▓"
"""A quarter, a half and three quarters of the foreground."""
_FEW = 16
_BAYER = ((0, 8, 2, 10), (12, 4, 14, 6), (3, 11, 1, 9), (15, 7, 13, 5))
"""Thresholds of ordered dithering, in sixteenths of a step: unlike diffused errors they do not flicker from picture to
picture."""
_MIXED = 0
"""The palette of mixtures of the sixteen."""
_ALIKE = {256: 0.11, _MIXED: 0.4}
"""Distance in Oklab up to which two colours of a palette are mixed by dithering. With more, a grey road gets red dots;
with less, sixteen colours lose the shades of grey."""
_XTERM_16 = (
    (0, 0, 0), (205, 0, 0), (0, 205, 0), (205, 205, 0), (0, 0, 238), (205, 0, 205), (0, 205, 205), (229, 229, 229),
    (127, 127, 127), (255, 0, 0), (0, 255, 0), (255, 255, 0), (92, 92, 255), (255, 0, 255), (0, 255, 255),
    (255, 255, 255),
)  # fmt: skip
"""The sixteen colours as xterm has them; other terminals' differ a little."""
_RICH_16 = (
    (0, 0, 0), (170, 0, 0), (0, 170, 0), (170, 85, 0), (0, 0, 170), (170, 0, 170), (0, 170, 170), (170, 170, 170),
    (85, 85, 85), (255, 85, 85), (85, 255, 85), (255, 255, 85), (85, 85, 255), (255, 85, 255), (85, 255, 255),
    (255, 255, 255),
)  # fmt: skip
"""What rich takes for the sixteen colours."""
_GREYS_OF_16 = {0, 7, 8, 15}
_LEVELS = (0, 95, 135, 175, 215, 255)
"""Of each primary in the 6 × 6 × 6 colours of a palette of 256."""
_FIRST_GREY = 232
_NO_CUBE_GREYS = (59, 102, 145, 188)
"""Greys of those colours, which rich makes neighbours of; other greys are as near."""
_LUT_BITS = 5
"""Bits of red, green and blue by which a nearest colour is looked up."""


class _Shapes(NamedTuple):
    """Characters, by their foreground's part of a cell.

    Attributes:
        masks: one row a character; 1 where a pixel of the cell has the foreground.
        across: pixels of a cell in width.
        down: pixels of a cell in height.
    """

    characters: str
    masks: Array
    across: int
    down: int


def wished_pixels(colours: int, *, sextants: bool) -> tuple[int, int]:
    """Return how many pixels across and down a cell an image should have for `image_rows`."""
    if not colours or find_spec("numpy") is None:
        return 1, 2
    return (2, 6) if sextants else (2, 4)


def image_rows(pixels: Pixels, wish: Wish, *, colours: int, sextants: bool) -> list[Row]:
    """Return an image as rows of characters, in the place that it has in pixels, too (`frame_of`).

    It may have been made for other cells: for pixels, or for the size before.

    Args:
        wish: gives the area and the shape of its cells.
        colours: the terminal's. With 16, shades mix them; without, characters show the brightness.
        sextants: whether its font has the blocks of Unicode 13, six to a cell.

    Raises:
        UnreadableError: the other side's image is damaged.
    """
    frame = frame_of(pixels, wish)
    if not colours or find_spec("numpy") is None:
        height = max(1, round(2 * frame.height))
        rgb = scaled(rgb_of(pixels), pixels.width, pixels.height, frame.columns, height)
        return (_half_blocks if colours else _brightness)(rgb, frame.columns, height)
    shapes = _shapes(sextants=sextants)
    cells = _cells(pixels, frame, shapes)
    return _few_colours(cells, shapes) if colours <= _FEW else _many_colours(cells, shapes, colours)


# -- shapes -----------------------------------------------------------------------------------------------------------


@cache
def _shapes(*, sextants: bool) -> _Shapes:
    """Return the shapes that a font has; of two that are each other's inverse, one is enough."""
    import numpy as np  # noqa: PLC0415 -- optional, as in the functions below

    across, down = (2, 6) if sextants else (2, 4)
    found: dict[bytes, str] = {}

    def add(character: str, mask: Array) -> None:
        key, inverse = mask.tobytes(), (1 - mask).tobytes()
        if mask.any() and not mask.all() and key not in found and inverse not in found:
            found[key] = character

    for bits, character in enumerate(_QUADRANTS):
        mask = np.zeros((down, across), np.float32)
        for at in range(4):
            if bits >> at & 1:
                mask[(at // 2) * down // 2 : (at // 2 + 1) * down // 2, at % 2] = 1
        add(character, mask)
    if sextants:
        for bits in range(1, 63):
            mask = np.zeros((down, across), np.float32)
            for at in range(6):
                if bits >> at & 1:
                    mask[(at // 2) * 2 : (at // 2 + 1) * 2, at % 2] = 1
            add(_sextant(bits), mask)
    else:
        for eighths, character in ((2, "▂"), (6, "▆")):
            mask = np.zeros((down, across), np.float32)
            mask[down - eighths * down // 8 :] = 1
            add(character, mask)
    masks = np.array([np.frombuffer(key, np.float32) for key in found])
    return _Shapes("".join(found.values()), masks, across, down)


def _sextant(bits: int) -> str:
    """Return the character of Unicode 13's block of sextants, which leaves out those that Unicode had before."""
    return {0b010101: "▌", 0b101010: "▐"}.get(bits) or chr(0x1FB00 + bits - 1 - (bits > 0b010101) - (bits > 0b101010))


def _cells(pixels: Pixels, frame: Extent, shapes: _Shapes) -> Array:
    """Return the pixels of each cell: rows, columns, pixels, and red, green and blue."""
    import numpy as np  # noqa: PLC0415

    image = np.frombuffer(rgb_of(pixels), np.uint8).reshape(pixels.height, pixels.width, 3)
    across, down, columns, rows = shapes.across, shapes.down, frame.columns, frame.rows
    size = max(1, round(frame.height * down)), max(1, round(frame.width * across))
    for axis, count in enumerate(size):
        image = _averaged(image, axis, count)
    # The rest of the last cells is like their edge.
    rest = ((0, rows * down - image.shape[0]), (0, columns * across - image.shape[1]), (0, 0))
    image = np.pad(image, rest, mode="edge")
    return image.reshape(rows, down, columns, across, 3).swapaxes(1, 2).reshape(rows, columns, down * across, 3)


def _averaged(image: Array, axis: int, count: int) -> Array:
    """Return an image with so many rows (axis 0) or columns, which repeat it, or are the means of several."""
    import numpy as np  # noqa: PLC0415

    length = image.shape[axis]
    if length == count:
        return image
    starts = np.arange(count) * length // count
    widths = np.maximum(1, np.diff(starts, append=length))
    shape = [1] * image.ndim
    shape[axis] = count
    means: Array = np.add.reduceat(image, starts, axis, dtype=np.float32) / widths.reshape(shape)
    return means


def _fitted(cells: Array, masks: Array) -> tuple[Array, Array, Array, Array]:
    """Return, for each cell, the shape that fits best, its two mean colours, and the error that remains."""
    import numpy as np  # noqa: PLC0415

    values = cells.astype(np.float32)
    ones = masks.sum(axis=1)[:, None]
    zeros = masks.shape[1] - ones
    total = values.sum(axis=2)
    fore = np.einsum("kp,rcpi->rcki", masks, values, optimize=True)
    back = total[:, :, None] - fore
    explained = (fore**2 / ones + back**2 / zeros).sum(axis=-1)
    best = explained.argmax(axis=-1)
    at = best[..., None, None]
    fore = np.take_along_axis(fore / ones, at, 2)[:, :, 0]
    back = np.take_along_axis(back / zeros, at, 2)[:, :, 0]
    error = (values**2).sum(axis=(2, 3)) - np.take_along_axis(explained, best[..., None], -1)[..., 0]
    return best, fore, back, error


# -- colours ----------------------------------------------------------------------------------------------------------


def _many_colours(cells: Array, shapes: _Shapes, colours: int) -> list[Row]:
    import numpy as np  # noqa: PLC0415

    best, fore, back, _ = _fitted(cells, shapes.masks)
    if colours > 256:
        # Two bits less, so that more neighbours have one colour, which takes one sequence.
        weights = np.array([1 << 16, 1 << 8, 1])
        codes = [(each.round().clip(0, 255).astype(np.int64) & 0xFC) @ weights for each in (fore, back)]
    else:
        codes = [_dithered(each, 256) + 16 for each in (fore, back)]
    characters = np.array([*shapes.characters, " "])
    shown = np.where(codes[0] == codes[1], len(shapes.characters), best)
    return _rows(characters[shown], codes[0], codes[1], _hex if colours > 256 else _named)


def _few_colours(cells: Array, shapes: _Shapes) -> list[Row]:
    """Draw in 16 colours: a cell has two of them in a shape, or mixed by a shade, whichever looks more alike."""
    import numpy as np  # noqa: PLC0415

    best, fore, back, error = _fitted(cells, shapes.masks)
    sharp = [_nearest(each, _FEW) for each in (fore, back)]
    mean = cells.mean(axis=2)
    mixed = _dithered(mean, _MIXED)
    mixtures, fores, backs, signs = _mixtures()
    palette, count = np.array(_XTERM_16, np.float32), cells.shape[2]
    parts = shapes.masks.sum(axis=1)[best][..., None]
    error_sharp = error + (
        parts * (palette[sharp[0]] - fore) ** 2 + (count - parts) * (palette[sharp[1]] - back) ** 2
    ).sum(-1)
    error_mixed = ((cells - mean[:, :, None]) ** 2).sum(axis=(2, 3)) + count * ((mixtures[mixed] - mean) ** 2).sum(-1)
    is_sharp = error_sharp < error_mixed
    characters = np.array([*shapes.characters, *_SHADES, " "])
    shown = np.where(is_sharp, best, len(shapes.characters) + signs[mixed])
    front, behind = np.where(is_sharp, sharp[0], fores[mixed]), np.where(is_sharp, sharp[1], backs[mixed])
    shown = np.where(front == behind, len(characters) - 1, shown)
    return _rows(characters[shown], front, behind, _named)


@cache
def _named(code: int) -> str:
    """Return a colour that rich makes this one of the palette.

    Textual makes true colours of ``color(9)`` before that, by a theme of its own, so that red would become magenta, and
    the light greys a step darker.
    """
    if code < _FEW:
        red, green, blue = _RICH_16[code]
    elif code < _FIRST_GREY:
        red, green, blue = (_LEVELS[(code - _FEW) // part % 6] for part in (36, 6, 1))
    else:
        red = green = blue = round(255 * (code - _FIRST_GREY + 1) / 25)  # the middle of what becomes this grey
    return f"#{red:02x}{green:02x}{blue:02x}"


def _hex(code: int) -> str:
    return f"#{code:06x}"


def _rows(characters: Array, fore: Array, back: Array, name: Callable[[int], str]) -> list[Row]:
    """Return rows in which neighbours of the same colours are one part: each is an escape sequence on the line."""
    rows = []
    for line in zip(characters.tolist(), fore.tolist(), back.tolist(), strict=True):
        parts = []
        for (front, behind), run in groupby(zip(*line, strict=True), key=lambda cell: cell[1:]):
            parts.append(Part("".join(cell[0] for cell in run), name(front), name(behind)))
        rows.append(tuple(parts))
    return rows


def _dithered(rgb: Array, palette: int) -> Array:
    """Return the indices of the nearest colours, or where a cell's threshold says so, of those on their other side."""
    import numpy as np  # noqa: PLC0415

    colours, near = _colours(palette), _nearest(rgb, palette)
    missing = rgb - colours[near]
    other = _nearest(rgb + missing, palette)
    way = colours[other] - colours[near]
    share = (missing * way).sum(-1) / np.maximum((way**2).sum(-1), 1e-6)
    lab = _lab(palette)
    is_alike = ((lab[near] - lab[other]) ** 2).sum(-1) < _ALIKE[palette] ** 2
    side = len(_BAYER)
    thresholds = (np.array(_BAYER) + 0.5) / side**2
    tiled = np.tile(thresholds, (-(-rgb.shape[0] // side), -(-rgb.shape[1] // side)))[: rgb.shape[0], : rgb.shape[1]]
    return np.where(is_alike & (share > tiled), other, near)


def _nearest(rgb: Array, palette: int) -> Array:
    """Return the index of the colour that looks most alike in a palette: 256 (from its 17th), 16, or `_MIXED`."""
    import numpy as np  # noqa: PLC0415

    values = (rgb.clip(0, 255) * (((1 << _LUT_BITS) - 1) / 255)).round().astype(np.int64)
    at: Array = (values[..., 0] << 2 * _LUT_BITS) + (values[..., 1] << _LUT_BITS) + values[..., 2]
    found: Array = _lookup(palette)[at]
    return found


@cache
def _colours(palette: int) -> Array:
    import numpy as np  # noqa: PLC0415

    if palette == _MIXED:
        return _mixtures()[0]
    cube = [(r, g, b) for r in _LEVELS for g in _LEVELS for b in _LEVELS]
    greys = [(8 + 10 * grey,) * 3 for grey in range(24)]
    return np.array(_XTERM_16 if palette == _FEW else [*cube, *greys], np.float32)


@cache
def _lab(palette: int) -> Array:
    lab = _oklab(_colours(palette))
    if palette == 256:
        lab[[code - _FEW for code in _NO_CUBE_GREYS]] = 9.0  # far from any colour
    return lab


@cache
def _lookup(palette: int) -> Array:
    import numpy as np  # noqa: PLC0415

    levels = np.linspace(0, 255, 1 << _LUT_BITS)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    known = _lab(palette)
    # In parts: the whole table of distances would take 50 MB.
    parts = np.split(_oklab(grid), 64)
    return np.concatenate([((part[:, None] - known) ** 2).sum(-1).argmin(1) for part in parts])


@cache
def _mixtures() -> tuple[Array, Array, Array, Array]:
    """Return the colours that shades make of two of the sixteen: red, green and blue; the two; and the shade."""
    import numpy as np  # noqa: PLC0415

    palette = np.array(_XTERM_16, np.float32)
    # Light mixes, not the numbers of the colours; a mixture of unlike colours looks like a pattern, and is left out.
    light, lab = palette / 255.0, _oklab(palette)
    rows = [
        (light[a] ** 2.2 * part + light[b] ** 2.2 * (1 - part), a, b, shade)
        for a in range(_FEW)
        for b in range(_FEW)
        for shade, part in enumerate((0.25, 0.5, 0.75))
        if a == b or (a < b and (((lab[a] - lab[b]) ** 2).sum() < 0.16 or {a, b} <= _GREYS_OF_16))
    ]
    mixed, fores, backs, signs = (np.array(each) for each in zip(*rows, strict=True))
    return (mixed ** (1 / 2.2) * 255).astype(np.float32), fores, backs, signs


def _oklab(rgb: Array) -> Array:
    import numpy as np  # noqa: PLC0415

    light = np.where(rgb <= 0.04045 * 255, rgb / 255 / 12.92, ((rgb / 255 + 0.055) / 1.055) ** 2.4)
    cones = np.cbrt(
        light
        @ np.array(
            [[0.4122214708, 0.2119034982, 0.0883024619], [0.5363325363, 0.6806995451, 0.2817188376],
             [0.0514459929, 0.1073969566, 0.6299787005]]
        )
    )  # fmt: skip
    lab: Array = cones @ np.array(
        [[0.2104542553, 1.9779984951, 0.0259040371], [0.7936177850, -2.4285922050, 0.7827717662],
         [-0.0040720468, 0.4505937099, -0.8086757660]]
    )  # fmt: skip
    return lab


# -- without numpy, or without colours --------------------------------------------------------------------------------


def _half_blocks(rgb: bytes, width: int, height: int) -> list[Row]:
    line = 3 * width
    rows: list[Row] = []
    for y in range(0, height, 2):
        upper = rgb[y * line : (y + 1) * line]
        # The last row of an odd height has no lower half.
        lower = rgb[(y + 1) * line : (y + 2) * line].ljust(line, b"\0")
        both = [(upper[at : at + 3], lower[at : at + 3]) for at in range(0, 3 * width, 3)]
        runs = ((colours, len([*same])) for colours, same in groupby(both))
        rows.append(tuple(Part("▀" * count, f"#{fore.hex()}", f"#{back.hex()}") for (fore, back), count in runs))
    return rows


def _brightness(rgb: bytes, width: int, height: int) -> list[Row]:
    """Draw by characters from dark to light."""
    grey = bytes((54 * rgb[at] + 183 * rgb[at + 1] + 19 * rgb[at + 2]) >> 8 for at in range(0, len(rgb), 3))  # Rec. 709
    rows: list[Row] = []
    for y in range(0, height, 2):
        upper = grey[y * width : (y + 1) * width]
        lower = grey[(y + 1) * width : (y + 2) * width] or upper
        means = ((above + below) // 2 for above, below in zip(upper, lower, strict=True))
        rows.append((Part("".join(RAMP[mean * len(RAMP) // 256] for mean in means)),))
    return rows
