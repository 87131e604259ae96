"""Images as characters: shapes, colours by the terminal's palette, brightness."""

from __future__ import annotations

import unicodedata
from itertools import product

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.color import Color, ColorSystem
from rich.segment import Segment
from rich.style import Style
from tests.support import surroundings
from textual._ansi_theme import MONOKAI
from textual.color import Color as TextualColor
from textual.filter import ANSIToTruecolor

from rsb_extras.pictures.blocks import _XTERM_16 as XTERM_16
from rsb_extras.pictures.blocks import RAMP, image_rows, wished_pixels
from rsb_extras.pictures.graphics import frame_of
from rsb_extras.pictures.picture import LONGEST_SIDE, Pixels, Wish
from rsb_extras.pictures.picture_rows import Part

np = pytest.importorskip("numpy")

RED, GREEN, BLUE, WHITE, BLACK = b"\xff\0\0", b"\0\xff\0", b"\0\0\xff", b"\xff\xff\xff", b"\0\0\0"
TRUE = 1 << 24
QUARTERS = ("UPPER LEFT", "UPPER RIGHT", "LOWER LEFT", "LOWER RIGHT")


def area(pixels: Pixels, colours: int, *, sextants: bool = False) -> tuple[Pixels, Wish]:
    """Return an image with the shape of the pixels that blocks have, and an area of as many cells as it takes."""
    across, down = wished_pixels(colours, sextants=sextants)
    wish = Wish(-(-pixels.width // across), -(-pixels.height // down))
    return msgspec.structs.replace(pixels, shape=across * wish.shape / down), wish


def drawn(pixels: Pixels, colours: int, *, sextants: bool = False) -> list[tuple[Part, ...]]:
    return image_rows(*area(pixels, colours, sextants=sextants), colours=colours, sextants=sextants)


def text(pixels: Pixels, colours: int, *, sextants: bool = False) -> list[str]:
    return ["".join(part.text for part in row) for row in drawn(pixels, colours, sextants=sextants)]


def shown_as(style: str, colours: int) -> int | None:
    """Return the number in the palette as which rich shows a colour, after Textual's filter of a plain theme."""
    (segment,) = ANSIToTruecolor(MONOKAI).apply([Segment(" ", Style(color=style))], TextualColor(0, 0, 0))
    assert segment.style is not None
    assert segment.style.color is not None
    return segment.style.color.downgrade(ColorSystem.STANDARD if colours == 16 else ColorSystem.EIGHT_BIT).number


def rgb_of(style: str, colours: int) -> tuple[int, ...]:
    """Return how the terminal shows a colour."""
    number = shown_as(style, colours)
    assert number is not None
    return palette_colour(number)


def palette_colour(number: int) -> tuple[int, ...]:
    return XTERM_16[number] if number < 16 else tuple(Color.parse(f"color({number})").get_truecolor())


def quarters(*colours: bytes) -> Pixels:
    """Return one cell of four quarters, of 2 × 4 pixels."""
    upper_left, upper_right, lower_left, lower_right = colours
    return Pixels(2, 4, (upper_left + upper_right) * 2 + (lower_left + lower_right) * 2)


def front(character: str) -> set[str]:
    """Return the quarters that a character draws in the foreground, by its name in Unicode."""
    name = unicodedata.name(character)
    sides = {"UPPER LEFT", "UPPER RIGHT", "LOWER LEFT", "LOWER RIGHT"}
    if name.startswith("QUADRANT "):
        return set(name.removeprefix("QUADRANT ").split(" AND "))
    return {side for side in sides if name.partition(" ")[0] in side.split()} if "HALF" in name else set()


@pytest.mark.parametrize("bits", product((0, 1), repeat=4))
@pytest.mark.parametrize("colours", [16, 256, TRUE])
def test_each_quarter_has_its_colour(bits: tuple[int, ...], colours: int) -> None:
    ((part,),) = drawn(quarters(*(WHITE if bit else BLACK for bit in bits)), colours)
    white = {name for name, bit in zip(QUARTERS, bits, strict=True) if bit}
    is_white = {style: Color.parse(style).get_truecolor().red > 128 for style in (part.style, part.background)}
    found = {name for name in QUARTERS if is_white[part.style if name in front(part.text) else part.background]}
    assert found == white


@pytest.mark.parametrize("bits", range(64))
def test_each_sixth_has_its_colour(bits: int) -> None:
    """By the names of Unicode, which number the six from the upper left."""
    sixths = [WHITE if bits >> at & 1 else BLACK for at in range(6)]
    pixels = Pixels(2, 6, b"".join((sixths[2 * row] + sixths[2 * row + 1]) * 2 for row in range(3)))
    ((part,),) = drawn(pixels, TRUE, sextants=True)
    name = unicodedata.name(part.text)
    known = {
        "SPACE": set(), "LEFT HALF BLOCK": {1, 3, 5}, "RIGHT HALF BLOCK": {2, 4, 6}, "FULL BLOCK": {1, 2, 3, 4, 5, 6},
    }  # fmt: skip
    fore = known.get(name, set(map(int, name.rpartition("-")[2])) if "SEXTANT" in name else {0})
    white = {at + 1 for at in range(6) if bits >> at & 1}
    is_white_in_front = part.style == "#fcfcfc"
    if name == "SPACE":
        assert white == (set(range(1, 7)) if part.background == "#fcfcfc" else set())
    else:
        assert (fore if is_white_in_front else set(range(1, 7)) - fore) == white


def test_neighbours_of_same_colours_are_one_part() -> None:
    (row,) = drawn(Pixels(8, 4, (RED * 8) * 2 + (BLUE * 8) * 2), TRUE)
    assert [part.text for part in row] == ["▀▀▀▀"]


@pytest.mark.parametrize(
    ("colour", "expected"),
    [(BLUE, 21), (RED, 196), (WHITE, 231), (BLACK, 16), (bytes((128,) * 3), 244), (bytes((135, 95, 0)), 94)],
)
def test_palette_of_256_has_nearest_colour(colour: bytes, expected: int) -> None:
    """Rich would make violet of a blue, and olive of wood."""
    ((part,),) = drawn(Pixels(2, 4, colour * 8), 256)
    assert shown_as(part.background, 256) == expected


@pytest.mark.parametrize("colours", [16, 256])
@pytest.mark.parametrize("brightness", [0, 30, 60, 85, 128, 170, 200, 255])
def test_dithering_keeps_brightness_of_greys(brightness: int, colours: int) -> None:
    side = 16
    part_of = {"░": 0.25, "▒": 0.5, "▓": 0.75, " ": 0.0}
    light = []
    for row in drawn(Pixels(2 * side, 4 * side, bytes([brightness] * 3) * 8 * side * side), colours):
        for part in row:
            fore, back = ((sum(rgb_of(each, colours)) / 3 / 255) ** 2.2 for each in part[1:])
            light += [part_of[each] * fore + (1 - part_of[each]) * back for each in part.text]
    found = 255 * (sum(light) / len(light)) ** (1 / 2.2)
    assert len(light) == side * side
    assert found == pytest.approx(brightness, abs=12 if colours == 256 else 35)


def test_palettes_give_only_their_own_colours() -> None:
    noise = Pixels(40, 40, np.random.default_rng(1).integers(0, 256, 4800, np.uint8).tobytes())
    for colours, allowed in ((16, range(16)), (256, range(16, 256))):
        used = {each for row in drawn(noise, colours) for part in row for each in (part.style, part.background)}
        numbers = {shown_as(each, colours) for each in used}
        assert numbers <= set(allowed)
        assert len(numbers) > 5


@pytest.mark.parametrize("colours", [16, 256])
def test_colours_that_rich_and_textual_show_are_the_nearest(colours: int) -> None:
    """For each colour of the palette as the terminal has it, but the greys of the cube, which rich never shows."""
    for code in range(16) if colours == 16 else {*range(16, 256)} - {59, 102, 145, 188}:
        (row,) = drawn(Pixels(2, 4, bytes(palette_colour(code)) * 8), colours)
        assert {shown_as(row[0].background, colours)} == {code}


@given(
    width=st.integers(1, 20),
    height=st.integers(1, 9),
    colours=st.sampled_from((0, 16, 256, TRUE)),
    sextants=st.booleans(),
    data=st.data(),
)
def test_any_image_fills_its_cells(width: int, height: int, colours: int, sextants: bool, data: st.DataObject) -> None:
    rgb = data.draw(st.binary(min_size=3 * width * height, max_size=3 * width * height))
    pixels, wish = area(Pixels(width, height, rgb), colours, sextants=sextants)
    frame = frame_of(pixels, wish)
    found = text(pixels, colours, sextants=sextants)
    assert list(map(len, found)) == [frame.columns] * frame.rows


COLOURS = [0, 16, 256, TRUE]


def edges(rows: list[tuple[Part, ...]]) -> list[int]:
    """Return the column of each row from which on an image is brighter."""
    shown = [[part[1:] if part.style else each for part in row for each in part.text] for row in rows]
    return [next(at for at, cell in enumerate(row) if cell != row[0]) for row in shown]


@pytest.mark.parametrize("colours", COLOURS)
@pytest.mark.parametrize("size", [(640, 480), (320, 240), (80, 60), (LONGEST_SIDE, LONGEST_SIDE * 3 // 4), (4, 3)])
def test_image_of_any_resolution_is_shown_whole(size: tuple[int, int], colours: int) -> None:
    """As one for the terminal's pixels, some rows of which are in characters."""
    width, height = size
    rows = image_rows(
        Pixels(width, height, (BLACK * (width // 2) + WHITE * (width - width // 2)) * height),
        Wish(40, 40, across=10, down=20),
        colours=colours,
        sextants=False,
    )
    assert [sum(len(part.text) for part in row) for row in rows] == [40] * 15
    assert edges(rows) == [20] * 15


@pytest.mark.parametrize("colours", COLOURS)
@pytest.mark.parametrize("cell", [(10, 20), (2, 4), (2, 6), (1, 2), (4, 9)])
def test_characters_take_the_place_of_pixels(cell: tuple[int, int], colours: int) -> None:
    """Also while the terminal is slow, for which an image has fewer pixels a cell."""
    across, down = cell
    wish = Wish(60, 18, across=across, down=down, shape=2.1)
    pixels = Pixels(20 * across, 9 * down, bytes(540 * across * down), shape=across * wish.shape / down)
    frame = frame_of(pixels, msgspec.structs.replace(wish, across=16, down=32))
    assert (frame.columns, frame.rows) == (40, 18)
    rows = image_rows(pixels, wish, colours=colours, sextants=False)
    assert [sum(len(part.text) for part in row) for row in rows] == [40] * 18


# -- without numpy, or without colours


def test_without_numpy_there_are_half_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "numpy")
    assert wished_pixels(256, sextants=True) == (1, 2)
    assert drawn(Pixels(4, 2, RED * 3 + GREEN + BLUE * 4), 256) == [
        (Part("▀▀▀", "#ff0000", "#0000ff"), Part("▀", "#00ff00", "#0000ff"))
    ]
    odd = drawn(Pixels(1, 3, RED + GREEN + BLUE), 256)
    assert odd == [(Part("▀", "#ff0000", "#00ff00"),), (Part("▀", "#0000ff", "#000000"),)]


def test_character_without_colours_keeps_brightness() -> None:
    greys = bytes(level for level in range(0, 260, 26) for _ in range(3))
    assert text(Pixels(10, 2, greys * 2), 0) == [RAMP]
    assert text(Pixels(2, 2, BLACK + WHITE + BLACK + WHITE), 0) == [RAMP[0] + RAMP[-1]]
    assert text(Pixels(1, 2, WHITE + BLACK), 0) == [RAMP[len(RAMP) // 2 - 1]]


def test_green_outshines_red_outshines_blue() -> None:
    (row,) = text(Pixels(3, 1, GREEN + RED + BLUE), 0)
    assert [*row] == sorted(row, key=RAMP.index, reverse=True)
    assert len(set(row)) == 3


def test_odd_last_row_is_bright_as_its_pixels() -> None:
    assert text(Pixels(2, 3, BLACK * 4 + WHITE * 2), 0) == [RAMP[0] * 2, RAMP[-1] * 2]


def test_without_colours_ascii_has_no_style() -> None:
    parts = [part for row in drawn(Pixels(16, 9, bytes(range(216)) * 2), 0) for part in row]
    assert all(part.text.isascii() and part[1:] == ("", "") for part in parts)
