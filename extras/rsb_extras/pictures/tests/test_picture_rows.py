"""Rows of a terminal for pictures: half blocks, ASCII by brightness, styled characters, plots."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_extras.pictures.blocks import RAMP, Part, UnreadableError, rgb_of
from rsb_extras.pictures.picture import LONGEST_SIDE, Cells, Curve, Pixels, Series
from rsb_extras.pictures.picture_rows import picture_rows, with_mark

Image = pytest.importorskip("PIL.Image", reason="needs Pillow")

RED, GREEN, BLUE, WHITE, BLACK = b"\xff\0\0", b"\0\xff\0", b"\0\0\xff", b"\xff\xff\xff", b"\0\0\0"


def rows(content: Cells | Pixels | Series, width: int = 80, height: int = 24, **how: int) -> list[str]:
    return ["".join(part.text for part in row) for row in picture_rows(content, width, height, **how)]


def webp(width: int, height: int, **how: object) -> bytes:
    file = io.BytesIO()
    Image.effect_noise((width, height), 90).convert("RGB").save(file, "WEBP", **how)
    return file.getvalue()


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (Pixels(2, 2, RED + GREEN + BLUE + WHITE),
         [(Part("▀", "#ff0000", "#0000ff"), Part("▀", "#00ff00", "#ffffff"))]),
        (Pixels(4, 2, RED * 3 + GREEN + BLUE * 4),
         [(Part("▀▀▀", "#ff0000", "#0000ff"), Part("▀", "#00ff00", "#0000ff"))]),
        (Pixels(1, 3, RED + GREEN + BLUE), [(Part("▀", "#ff0000", "#00ff00"),), (Part("▀", "#0000ff", "#000000"),)]),
    ],
    ids=["each", "of the same colours", "an odd last row"],
)  # fmt: skip
def test_a_cell_shows_one_pixel_above_another(pixels: Pixels, expected: list[tuple[Part, ...]]) -> None:
    assert picture_rows(pixels, 80, 24) == expected


def test_character_without_colours_keeps_brightness() -> None:
    greys = bytes(level for level in range(0, 260, 26) for _ in range(3))
    assert rows(Pixels(10, 2, greys * 2), colours=0) == [RAMP]
    assert rows(Pixels(2, 2, BLACK + WHITE + BLACK + WHITE), colours=0) == [RAMP[0] + RAMP[-1]]
    assert rows(Pixels(1, 2, WHITE + BLACK), colours=0) == [RAMP[len(RAMP) // 2 - 1]]


def test_green_outshines_red_outshines_blue() -> None:
    (row,) = rows(Pixels(3, 1, GREEN + RED + BLUE), colours=0)
    assert [*row] == sorted(row, key=RAMP.index, reverse=True)
    assert len(set(row)) == 3


def test_odd_last_row_is_bright_as_its_pixels() -> None:
    assert rows(Pixels(2, 3, BLACK * 4 + WHITE * 2), colours=0) == [RAMP[0] * 2, RAMP[-1] * 2]


def test_without_colours_ascii_has_no_style() -> None:
    drawn = picture_rows(Pixels(16, 9, bytes(range(216)) * 2), 80, 24, colours=0)
    assert all(part.text.isascii() and part[1:] == ("", "") for row in drawn for part in row)


@given(width=st.integers(1, 20), height=st.integers(1, 9), colours=st.sampled_from((0, 16, 256)), data=st.data())
def test_an_image_has_a_cell_for_two_pixels(width: int, height: int, colours: int, data: st.DataObject) -> None:
    rgb = data.draw(st.binary(min_size=3 * width * height, max_size=3 * width * height))
    assert list(map(len, rows(Pixels(width, height, rgb), colours=colours))) == [width] * ((height + 1) // 2)


def test_characters_have_their_styles() -> None:
    cells = Cells(("ab", "", "cde"), bytes((0, 1, 1, 1, 2)), ("", "robot", "#12ab34"))
    assert picture_rows(cells, 80, 24) == [
        (Part("a"), Part("b", "robot")),
        (),
        (Part("cd", "robot"), Part("e", "#12ab34")),
    ]


def test_characters_without_styles() -> None:
    assert picture_rows(Cells(("ab", "c")), 80, 24) == [(Part("ab"),), (Part("c"),)]
    assert picture_rows(Cells(("ab",), palette=("ok",)), 80, 24) == [(Part("ab", "ok"),)]
    assert picture_rows(Cells(()), 80, 24) == []


def test_a_plot_fills_its_area() -> None:
    curve = Curve("x", tuple(map(float, range(60))), tuple(map(float, range(60))), 59.0, 29.5)
    plot = rows(Series(0.0, 0.5, (curve,)), 40, 12)
    assert len(plot) == 12
    assert max(map(len, plot)) == 40
    assert any("\u2801" <= each <= "\u28ff" for each in "".join(plot))
    assert all(value in plot[-1] for value in ("59", "29.5"))


def test_a_cursor_shows_a_columns_values() -> None:
    lows, highs = (1.0, 3.0), (2.0, 3.0)
    series = Series(0.0, 1.0, (Curve("x", lows, highs, 3.0),))
    first, second = (picture_rows(series, 30, 10, cursor=cursor)[-1][-1].text for cursor in (0, 19))
    assert first.endswith(" 1 to 2")
    assert second.endswith(" 3")


def test_webp_becomes_pixels() -> None:
    assert rgb_of(Pixels(1, 1, RED)) == RED
    data = webp(16, 10, lossless=True)
    assert rgb_of(Pixels(16, 10, data, "webp")) == Image.open(io.BytesIO(data)).convert("RGB").tobytes()
    assert len(rows(Pixels(16, 10, data, "webp"))) == 5


@pytest.mark.parametrize("colours", [0, 16, 256])
def test_a_webp_image_of_another_size_is_refused(colours: int) -> None:
    with pytest.raises(UnreadableError):
        picture_rows(Pixels(16, 12, webp(16, 10), "webp"), 80, 24, colours=colours)


WHOLE = webp(64, 48)


@pytest.mark.parametrize(
    "data",
    [b"", b"RIFF", b"GIF89a" + bytes(100), WHOLE[:20], WHOLE[:40], WHOLE[: len(WHOLE) // 2], WHOLE[:-1], bytes(1000)],
)
def test_a_damaged_webp_image_is_refused(data: bytes) -> None:
    with pytest.raises(UnreadableError):
        rgb_of(Pixels(64, 48, data, "webp"))


@given(at=st.integers(8, len(WHOLE) - 1), instead=st.binary(min_size=1, max_size=40))
def test_any_webp_image_is_shown_or_refused(at: int, instead: bytes) -> None:
    try:
        rgb = rgb_of(Pixels(64, 48, WHOLE[:at] + instead + WHOLE[at + len(instead) :], "webp"))
    except UnreadableError:
        return
    assert len(rgb) == 3 * 64 * 48


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("side", [10_000, 14_000])
def test_huge_webp_image_is_refused_unread(side: int) -> None:
    file = io.BytesIO()
    Image.new("RGB", (1, 1)).save(file, "WEBP", lossless=True)
    bomb = bytearray(file.getvalue())
    at = bomb.index(b"VP8L") + 9  # 14 bits each, less 1: width and height
    bits = int.from_bytes(bomb[at : at + 4], "little") & ~0xFFFFFFF
    bomb[at : at + 4] = (bits | (side - 1) | (side - 1) << 14).to_bytes(4, "little")
    with pytest.raises(UnreadableError):
        rgb_of(Pixels(64, 48, bytes(bomb), "webp"))


def test_image_that_nobody_asked_for_takes_no_time() -> None:
    with pytest.raises(UnreadableError):
        picture_rows(Pixels(LONGEST_SIDE, LONGEST_SIDE, b"", "webp"), 80, 24)


# -- a mark

_ROWS = [(Part("ab", "dim"), Part("cd", "ok", "#000000")), (), (Part("ef"),)]


@pytest.mark.parametrize(
    ("column", "row", "expected"),
    [
        (0, 0, (Part("X", "goal"), Part("b", "dim"), Part("cd", "ok", "#000000"))),
        (1, 0, (Part("a", "dim"), Part("X", "goal"), Part("cd", "ok", "#000000"))),
        (2, 0, (Part("ab", "dim"), Part("X", "goal"), Part("d", "ok", "#000000"))),
        (3, 0, (Part("ab", "dim"), Part("c", "ok", "#000000"), Part("X", "goal"))),
        (5, 0, (*_ROWS[0], Part(" "), Part("X", "goal"))),
        (0, 1, (Part("X", "goal"),)),
        (3, 1, (Part("   "), Part("X", "goal"))),
    ],
)
def test_a_mark_replaces_one_cell(column: int, row: int, expected: tuple[Part, ...]) -> None:
    marked = with_mark(_ROWS, column, row, Part("X", "goal"), 6)
    assert marked[row] == expected
    assert [each for at, each in enumerate(marked) if at != row] == [each for at, each in enumerate(_ROWS) if at != row]


@pytest.mark.parametrize(("column", "row"), [(-1, 0), (6, 0), (10**30, 0), (0, -1), (0, 3), (0, -(10**30))])
def test_a_mark_outside_changes_nothing(column: int, row: int) -> None:
    """However far: zooming in takes a goal a long way off."""
    assert with_mark(_ROWS, column, row, Part("X", "goal"), 6) == _ROWS


@pytest.mark.parametrize("brightness", [0, 30, 85, 128, 170, 200, 255])
def test_few_colours_keep_brightness_of_greys(brightness: int) -> None:
    side = 16
    drawn = picture_rows(Pixels(side, side, bytes([brightness] * 3) * side * side), 80, 24, colours=16)
    greys = [
        int(colour[1:3], 16)
        for row in drawn
        for part in row
        for colour in (part.style, part.background)
        for _ in part.text
    ]
    assert len(greys) == side * side
    assert set(greys) <= {0, 85, 170, 255}
    assert sum(greys) / len(greys) == pytest.approx(brightness, abs=8)


def test_few_colours_keep_brightness_of_colours() -> None:
    def brightness(colour: bytes) -> float:
        (row,) = picture_rows(Pixels(4, 2, colour * 8), 80, 24, colours=16)
        return sum(int(colour[1:3], 16) * len(part.text) for part in row for colour in (part.style, part.background))

    assert brightness(GREEN) > brightness(RED) > brightness(BLUE)
