"""Images as sequences of terminals that show pixels.

By kitty's graphics protocol (sw.kovidgoyal.net/kitty/graphics-protocol), or as sixels (DEC STD 070, chapter 9). An
image is cut into bands of some rows, so that those that have not changed are not sent again, and those that a box
covers are not drawn.
"""

from __future__ import annotations

import base64
import io
import math
import re
import secrets
from importlib.util import find_spec
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

from textual.geometry import Region

from rsb_console.library_internals.textual_image_internals import sixels_of
from rsb_extras.pictures.picture_rows import rgb_of

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from PIL.Image import Image

    from rsb_console.terminal.terminal_facts import Pixels as Protocol
    from rsb_console.terminal.terminal_facts import TerminalFacts
    from rsb_extras.pictures.picture import Pixels, Wish

BANDS = 8
"""Bands of an image at most: each band of sixels has a palette of its own, of up to 4 kB."""
IDS = 2 * BANDS
"""Numbers of kitty's images: a band that comes has another one than the band in sight."""
_WIDEST = 1000
"""Pixels of an image in sixels. A wider one is missing in xterm, whose usual `maxGraphicSize` is 1000x1000."""
USUAL_CELL = 10.0, 20.0
"""Pixels of a cell, for terminals that do not tell theirs: most fonts are twice as high as wide."""
_CHUNK = 4096
"""Bytes that kitty's protocol allows in one sequence."""
_DEFINED_COLOUR = re.compile(r"#([0-9]+);2;[0-9]+;[0-9]+;[0-9]+")
"""The definition of a colour, which in xterm does not select it, too. textual-image 0.13 and newer does select it."""
_PNG_LEVEL = 3  # of zlib: a higher one takes three times as long for a tenth of the bytes


class Band(NamedTuple):
    """Some rows of an image.

    Attributes:
        top: its first row, from the image's upper edge.
        rows: cells in height.
        columns: cells in width.
        pixels: its content, to be compared.
        sequence: draws it at the cursor.
        image_id: kitty's number of it.
        left: its first column, from the image's left edge.
    """

    top: int
    rows: int
    columns: int
    pixels: bytes
    sequence: str
    image_id: int
    left: int = 0

    @property
    def range(self) -> range:
        return range(self.top, self.top + self.rows)

    def is_under(self, covered: Container[int]) -> bool:
        """Whether other things stand on one of its rows."""
        return any(row in covered for row in self.range)


def why_no_graphics(protocol: str) -> str:
    """Return the reason why this program cannot show images in a way, or an empty string."""
    needs = {"kitty": ("PIL",), "sixel": ("textual_image", "PIL")}.get(protocol, ())
    if all(find_spec(each) for each in needs):
        return ""
    return f"{protocol} images need Pillow and textual-image: pip install 'rsb-console[look]'"


def protocol_of(facts: TerminalFacts) -> Protocol:
    """Return how this program shows images on a terminal, or an empty string if in characters."""
    return "" if why_no_graphics(facts.pixels) else facts.pixels


class Extent(NamedTuple):
    """The place of an image on the screen.

    Attributes:
        columns: cells, the last of which may be filled in part.
        rows: the same.
        width: exact width in cells.
        height: exact height in cells.
    """

    columns: int
    rows: int
    width: float
    height: float


def frame_of(pixels: Pixels, wish: Wish) -> Extent:
    """Return the place of an image that fills the wished area in its own proportions."""
    width, height = float(pixels.width), pixels.height * pixels.shape / wish.shape
    factor = min(wish.width / width, wish.height / height)
    width, height = width * factor, height * factor
    return Extent(max(1, math.ceil(width - 0.01)), max(1, math.ceil(height - 0.01)), width, height)


def bands_of(
    pixels: Pixels,
    frame: Extent,
    cell: tuple[float, float],
    protocol: Protocol,
    first_id: int,
    paper: tuple[int, int, int],
    before: Sequence[Band] = (),
    *,
    few_colours: bool = False,
) -> list[Band]:
    """Cut an image into bands. This takes some 10 ms, so call it on a thread.

    Args:
        cell: pixels of the terminal in a cell.
        first_id: kitty's first number of `IDS`.
        paper: colour of the rest of the cells at the right and lower edge.
        before: the bands that are shown, whose sequences are used again.
        few_colours: whether 256 colours have to do, which take a quarter of the bytes in kitty.

    Raises:
        UnreadableError: the other side's image is damaged.
    """
    from PIL import Image  # noqa: PLC0415 -- optional

    columns, rows, width, height = frame
    image = Image.frombytes("RGB", (pixels.width, pixels.height), rgb_of(pixels))
    if protocol == "sixel":  # kitty scales images itself
        image = image.resize((max(1, round(width * cell[0])), max(1, round(height * cell[1]))))
    elif image.height < rows:  # each row of cells needs a row of pixels
        factor = math.ceil(rows / image.height)
        image = image.resize((image.width * factor, image.height * factor), Image.Resampling.NEAREST)
    sides = max(1, round(image.width * columns / width)), max(1, round(image.height * rows / height))
    sheet = Image.new("RGB", sides, paper)
    sheet.paste(image)
    most = -(-rows // BANDS)
    pieces = -(-sheet.width // _WIDEST) if protocol == "sixel" else 1
    known = {(band.top, band.left, band.rows, band.columns, band.pixels): band for band in before}
    used = {band.image_id for band in before}
    bands = []
    for number, (top, left) in enumerate(product(range(0, rows, most), range(0, columns, -(-columns // pieces)))):
        band_rows, band_columns = min(most, rows - top), min(-(-columns // pieces), columns - left)
        upper, lower = (round(row * sheet.height / rows) for row in (top, top + band_rows))
        begin, end = (round(column * sheet.width / columns) for column in (left, left + band_columns))
        part = sheet.crop((begin, upper, end, lower))
        content = part.tobytes()
        band = known.get((top, left, band_rows, band_columns, content))
        if band is None and protocol == "sixel":
            band = Band(top, band_rows, band_columns, content, sixels(part), 0, left)
        elif band is None:
            # kitty takes the image of a number away as soon as another one of the same number begins to come.
            image_id = next(each for each in (first_id + number, first_id + BANDS + number) if each not in used)
            sequence = kitty(png(part, few_colours=few_colours), image_id, band_columns, band_rows)
            band = Band(top, band_rows, band_columns, content, sequence, image_id)
        bands.append(band)
    return bands


def png(image: Image, *, few_colours: bool) -> bytes:
    file = io.BytesIO()
    if few_colours:
        image = image.quantize()
    image.save(file, "png", compress_level=_PNG_LEVEL)
    return file.getvalue()


def kitty(image: bytes, image_id: int, columns: int, rows: int) -> str:
    """Return the sequence that transmits a PNG file and displays it."""
    encoded = base64.b64encode(image).decode()
    chunks = [encoded[at : at + _CHUNK] for at in range(0, len(encoded), _CHUNK)]
    # C=1 leaves the cursor where it is. q=2 keeps the terminal from answers, which would be read as keys.
    keys = f"a=T,f=100,i={image_id},p=1,c={columns},r={rows},C=1,q=2,"
    parts = []
    for number, chunk in enumerate(chunks, 1):
        parts.append(f"\x1b_G{keys}m={int(number < len(chunks))};{chunk}\x1b\\")
        keys = ""  # only the first chunk may have them
    return "".join(parts)


def kitty_freed(image_id: int) -> str:
    """Return the sequence that takes an image away, and frees the terminal's memory."""
    return f"\x1b_Ga=d,d=I,i={image_id},q=2\x1b\\"


def sixels(image: Image) -> str:
    return _DEFINED_COLOUR.sub(r"\g<0>#\1", sixels_of(image))


class Painter:
    """Shows an image in a region of the screen, and sends only the bands that the terminal lacks.

    Attributes:
        first_id: kitty's first number of its bands, by chance: images of others stay on the screen.
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.first_id = secrets.randbelow(1 << 27) * IDS + 1
        self._at = (0, 0)
        self._shown: dict[int, Band] = {}
        self._overwritten: set[int] = set()
        """Bands of those shown on which text stands in part."""
        self._is_lost = False

    def overwritten(self, rows: Container[int]) -> None:
        """Note that text was drawn over rows of the image; kitty's images stay on it."""
        if self.protocol == "sixel":
            self._overwritten |= {number for number, band in self._shown.items() if band.is_under(rows)}

    def lost(self) -> None:
        """Note that the terminal may have been cleared, or has missed some of what was written."""
        self._is_lost = True

    def lacking(self, bands: Sequence[Band]) -> list[Band]:
        """Return the bands that are not shown."""
        return [band for number, band in enumerate(bands) if self._shown.get(number) is not band]

    def painted(self, bands: Sequence[Band], at: tuple[int, int], covered: Container[int]) -> str:
        """Return what shows bands, or an empty string if all is there.

        Args:
            at: column and row of the image's upper left corner, from 0.
            covered: rows of the image on which other things stand.
        """
        parts = [self.taken_away()] if self._at != at else []
        self._at = at
        before, self._shown = self._shown, {}
        for number, band in enumerate(bands):
            if not band.is_under(covered):
                self._shown[number] = band
                if before.get(number) is not band or self._is_lost or number in self._overwritten:
                    parts.append(f"\x1b[{at[1] + band.top + 1};{at[0] + band.left + 1}H{band.sequence}")
        # After the new ones are in sight, so that nothing flickers.
        parts += [self._freed(band) for number, band in before.items() if self._shown.get(number) is not band]
        self._is_lost = False
        self._overwritten.clear()
        drawn = "".join(parts)
        return f"\x1b7{drawn}\x1b8" if drawn else ""

    def lifted(self, bands: Sequence[Band], at: tuple[int, int], covered: Container[int]) -> list[Region]:
        """Return where sixels lie that are to go: only text that is drawn over them takes them away.

        Args:
            bands: that are to be shown instead, as of `painted`.
        """
        if self.protocol != "sixel":
            return []
        places = {
            (band.top, band.left, band.rows, band.columns)
            for band in bands
            if not band.is_under(covered) and at == self._at
        }
        gone = {
            number: band
            for number, band in self._shown.items()
            if (band.top, band.left, band.rows, band.columns) not in places
        }
        for number in gone:
            del self._shown[number]
        x, y = self._at
        # In xterm, an image may reach a pixel into the next column.
        return [Region(x + band.left, y + band.top, band.columns + 1, band.rows) for band in gone.values()]

    def taken_away(self) -> str:
        """Return what takes kitty's image away."""
        shown, self._shown = self._shown, {}
        return "".join(map(self._freed, shown.values()))

    def _freed(self, band: Band) -> str:
        return kitty_freed(band.image_id) if self.protocol == "kitty" else ""
