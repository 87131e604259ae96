"""No picture of a hostile peer does anything to a viewer's terminal, or stops its console."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from rsb_extras.pictures.drawing import Canvas
from rsb_extras.pictures.goal_on_map import Goal
from rsb_extras.pictures.map_view import _Paper
from rsb_extras.pictures.picture import (
    STYLES,
    Cells,
    Curve,
    Picture,
    PictureError,
    Scale,
    Series,
    Wish,
    decode_picture,
    encode_picture,
)
from rsb_extras.pictures.picture_files import picture_file
from rsb_extras.pictures.picture_rows import Part, picture_rows, with_mark

INVALID = (math.nan, math.inf, -math.inf)


def encoded(content: Cells | Series) -> bytes:
    return msgspec.msgpack.encode(Picture(content))


@pytest.mark.parametrize("name", ["blink", "link x", '#"/><g>', "#12345", "#1234567", "on red", "#12345g", "STRONG"])
def test_a_style_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(PictureError):
        decode_picture(encoded(Cells(("x",), b"\0", (name,))))


def test_styles_and_colours_are_taken() -> None:
    palette = (*STYLES, "#0a1B2c")
    picture = decode_picture(encoded(Cells(("x" * len(palette),), bytes(range(len(palette))), palette)))
    assert isinstance(picture.content, Cells)
    assert picture.content.palette == palette


@pytest.mark.parametrize(
    "row", ["漢字漢字", "e\N{COMBINING ACUTE ACCENT}x", "a\N{PILE OF POO}b", "\t\x1b[2J", "ｗｉｄｅ"]
)
def test_each_character_takes_one_cell(row: str) -> None:
    picture = decode_picture(encoded(Cells((row,), bytes(len(row)), ("",))))
    assert isinstance(picture.content, Cells)
    assert cell_len(picture.content.rows[0]) == len(row) == len(picture.content.rows[0])


def test_each_character_of_a_plot_takes_one_cell() -> None:
    picture = decode_picture(encoded(Series(0.0, 1.0, (Curve("漢字" * 20, (1.0,), (1.0,), 1.0),))))
    assert isinstance(picture.content, Series)
    for row in picture_rows(picture.content, 40, 12):
        assert sum(cell_len(part.text) for part in row) <= 40


def test_usual_characters_stay() -> None:
    row = "├──┤ 5 m ▲▶◆·… ⣿⠁ ×3 Zürich Привет"
    picture = decode_picture(encoded(Cells((row,))))
    assert isinstance(picture.content, Cells)
    assert picture.content.rows == (row,)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("left", "top", "column", "row") for value in INVALID),
        ("left", 1e300),
        ("top", -1e300),
        *((name, each) for name in ("column", "row") for each in (0.0, -1.0, 5e-324)),
    ],
)
def test_each_place_of_a_scale_has_a_cell(name: str, value: float) -> None:
    """Steps of nothing and places beyond all numbers would end a console that counts its cells."""
    scale = msgspec.structs.replace(Scale("map", 0.0, 0.0, 1.0, 1.0), **{name: value})
    with pytest.raises(PictureError):
        decode_picture(encoded(Cells(("x",), scale=scale)))


@pytest.mark.parametrize("zoom", [0.01, 1000.0])
def test_widest_and_nearest_view_have_scale(zoom: float) -> None:
    for extent in ((-1e7, -1e7, 1e7, 1e7), (0.0, 0.0, 0.0, 0.0)):
        wish = Wish(zoom=zoom, x=1e9, y=-1e9)
        scale = _Paper(extent, wish, Canvas.of(wish)).scale("map")
        decode_picture(encoded(Cells(("x",), scale=scale)))
        assert with_mark([(Part("x"),)], *Goal("map", -1e7, 1e7).cell(scale), Part("X"), 80)


NUMBERS = st.one_of(
    st.none(), st.sampled_from([0.0, 5e-324, -1.7e308, 1.7e308, *INVALID]), st.floats(), st.floats(-10, 10)
)
CURVES = st.builds(
    Curve,
    st.just("x"),
    st.lists(NUMBERS, max_size=6).map(tuple),
    st.lists(NUMBERS, max_size=6).map(tuple),
    NUMBERS,
    NUMBERS,
)


@given(
    start=st.floats(), step=st.floats(), curves=st.lists(CURVES, max_size=3).map(tuple),
    width=st.integers(1, 60), height=st.integers(1, 20), cursor=st.one_of(st.none(), st.integers(0, 60)),
)  # fmt: skip
def test_any_plot_is_drawn_or_refused(
    start: float, step: float, curves: tuple[Curve, ...], width: int, height: int, cursor: int | None
) -> None:
    try:
        picture = decode_picture(encode_picture(Picture(Series(start, step, curves))))
    except PictureError:
        return
    assert isinstance(picture.content, Series)
    assert len(picture_rows(picture.content, width, height, cursor=cursor)) <= height
    picture_file(picture.content, ".csv")
