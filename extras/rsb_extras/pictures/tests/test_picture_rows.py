"""Rows of a terminal for pictures: styled characters, plots; and the reading of images."""

from __future__ import annotations

import io
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_extras.pictures.picture import Cells, Curve, Pixels, Series
from rsb_extras.pictures.picture_rows import Part, UnreadableError, picture_rows, rgb_of, with_mark

Image = pytest.importorskip("PIL.Image", reason="needs Pillow")

RED, GREEN = b"\xff\0\0", b"\0\xff\0"


def rows(content: Cells | Series, width: int = 80, height: int = 24, **how: int) -> list[str]:
    return ["".join(part.text for part in row) for row in picture_rows(content, width, height, **how)]


def webp(width: int, height: int, **how: object) -> bytes:
    file = io.BytesIO()
    Image.effect_noise((width, height), 90).convert("RGB").save(file, "WEBP", **how)
    return file.getvalue()


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


GROUND = Cells(
    ("a ▀ ⠠",), bytes((0, 0, 3, 0, 1)), ("", "free", "#0000ff", "@#0000ff", "@free"), None, bytes((1, 2, 1, 0, 1))
)


def test_tints_lie_behind_characters() -> None:
    expected = (Part("a", "", "@free"), Part(" ", "", "@#0000ff"), Part("▀", "@#0000ff", "@free"), Part(" "))
    (shown,) = picture_rows(GROUND, 80, 24)
    assert shown == (*expected, Part(" ", "", "@free")), "the colour says what the dot says"


def test_few_colours_show_only_saturated_tints() -> None:
    (shown,) = picture_rows(GROUND, 80, 24, colours=16)
    assert shown == (Part("a"), Part(" ", "", "@#0000ff"), Part("▀", "@#0000ff"), Part(" "), Part("⠠", "free"))


def test_without_colours_characters_say_what_tints_say() -> None:
    assert rows(GROUND, colours=0) == ["a·  ⠠"]
    halves = Cells(("▀",), b"\1", ("", "@free"), None, b"\0")
    assert rows(halves, colours=16) == [" "]


def test_a_mark_stands_on_the_ground() -> None:
    (shown,) = with_mark(picture_rows(GROUND, 80, 24), 1, 0, Part("X", "goal"), 5)
    assert shown[1] == Part("X", "goal", "@#0000ff")


def test_a_plot_fills_its_area() -> None:
    curve = Curve("x", tuple(map(float, range(60))), tuple(map(float, range(60))), 59.0, 29.5)
    plot = rows(Series(0.0, 0.5, (curve,)), 40, 12)
    assert len(plot) == 12
    assert max(map(len, plot)) == 40
    assert any("\u2801" <= each <= "\u28ff" for each in "".join(plot))
    assert all(value in plot[-1] for value in ("59", "29.5"))


@pytest.mark.parametrize(
    ("width", "legend"),
    [
        (60, "▪ speed.x  59  min 0  mean 29.5  max 59"),
        (30, "▪ speed.x  59  min 0  max 59"),
        (26, "▪ speed.x  59"),
        (10, "▪ spee  59"),
    ],
)
def test_a_legend_has_whole_figures(width: int, legend: str) -> None:
    curve = Curve("speed.x", tuple(map(float, range(60))), tuple(map(float, range(60))), 59.0, 29.5)
    assert rows(Series(0.0, 0.5, (curve,)), width, 12)[-1] == legend


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


def test_doubled_webp_keeps_colours_of_neighbours() -> None:
    """WebP halves the resolution of colours."""
    pixels = ((RED + GREEN) * 8) * 8

    def wrong(coding: Literal["webp", "webp-doubled"], factor: int) -> int:
        image = Image.frombytes("RGB", (16, 8), pixels).resize((16 * factor, 8 * factor), Image.Resampling.NEAREST)
        file = io.BytesIO()
        image.save(file, "WEBP", quality=90)
        found = rgb_of(Pixels(16, 8, file.getvalue(), coding))
        return sum(abs(have - want) for have, want in zip(found, pixels, strict=True))

    assert wrong("webp-doubled", 2) < wrong("webp", 1) / 2


@pytest.mark.parametrize("coding", ["webp", "webp-doubled"])
def test_a_webp_image_of_another_size_is_refused(coding: Literal["webp", "webp-doubled"]) -> None:
    with pytest.raises(UnreadableError):
        rgb_of(Pixels(16, 12, webp(16, 10), coding))


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
