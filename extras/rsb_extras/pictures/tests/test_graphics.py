"""Images in the terminal's pixels: bands, what is sent again, and the sequences for kitty and sixel."""

from __future__ import annotations

import base64
import io
import os
import re

import pytest
from PIL import Image
from tests.support import surroundings
from textual.geometry import Region

from rsb_extras.pictures.graphics import BANDS, Painter, bands_of, frame_of, why_no_graphics
from rsb_extras.pictures.picture import Pixels, Wish
from rsb_extras.pictures.tests import picture_places

RED, PAPER = b"\xff\0\0", (1, 2, 3)
_CELL = (10.0, 20.0)
_COMMAND = re.compile(r"\x1b_G([^;\x1b]*)(?:;([^\x1b]*))?\x1b\\")
_PLACE = re.compile(r"\x1b\[(\d+);(\d+)H")


def noise(width: int, height: int) -> Pixels:
    return Pixels(width, height, os.urandom(3 * width * height))


def wish(columns: int, rows: int) -> Wish:
    return Wish(columns, rows, across=10, down=20)


def test_graphics_without_their_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_no_graphics("sixel") == ""
    surroundings.hide_modules(monkeypatch, "textual_image")
    assert why_no_graphics("sixel")
    assert why_no_graphics("kitty") == ""
    surroundings.hide_modules(monkeypatch, "PIL")
    assert why_no_graphics("kitty")
    assert why_no_graphics("blocks") == ""


@pytest.mark.parametrize(
    ("size", "area", "expected"),
    [((640, 480), (80, 40), (80, 30)), ((100, 400), (80, 40), (20, 40)), ((5, 5), (80, 40), (80, 40)),
     ((1600, 100), (8, 4), (8, 1))],
)  # fmt: skip
def test_image_fills_its_area_in_its_proportions(
    size: tuple[int, int], area: tuple[int, int], expected: tuple[int, int]
) -> None:
    frame = frame_of(Pixels(*size, b""), wish(*area))
    assert (frame.columns, frame.rows) == expected
    assert frame.width * 10 / (frame.height * 20) == pytest.approx(size[0] / size[1])


def test_kitty_gets_each_band_in_pieces() -> None:
    pixels = noise(100, 80)
    bands = bands_of(pixels, frame_of(pixels, wish(50, 20)), _CELL, "kitty", 7, PAPER)
    assert len(bands) == 7
    rebuilt = b""
    for number, band in enumerate(bands):
        commands = _COMMAND.findall(band.sequence)
        assert all(len(payload) <= picture_places.GRAPHICS_CHUNK.value for _, payload in commands)
        first = dict(pair.split("=") for pair in commands[0][0].split(","))
        assert (first["a"], first["f"], first["c"], first["r"]) == ("T", "100", "50", str(band.rows))
        assert (first["i"], first["C"], first["q"]) == (str(7 + number), "1", "2")
        assert [keys for keys, _ in commands[1:]] == ["m=1"] * (len(commands) - 2) + ["m=0"] * (len(commands) > 1)
        image = Image.open(io.BytesIO(base64.b64decode("".join(payload for _, payload in commands))))
        rebuilt += image.convert("RGB").tobytes()
    assert rebuilt == pixels.data
    assert sum(band.rows for band in bands) == 20


def test_rest_of_last_cells_has_colour_of_paper() -> None:
    pixels = Pixels(15, 20, RED * 300)
    bands = bands_of(pixels, frame_of(pixels, Wish(2, 1, across=10, down=20)), _CELL, "sixel", 1, PAPER)
    ((data),) = [band.pixels for band in bands]
    assert data[: 15 * 3] == RED * 15
    assert data[15 * 3 : 20 * 3] == bytes(PAPER) * 5


def test_sixels_select_each_colour_that_they_define() -> None:
    """Some terminals select it with its definition, xterm does not."""
    pixels = Pixels(4, 2, RED * 8)
    (band,) = bands_of(pixels, frame_of(pixels, Wish(10, 1, across=1, down=2)), (10.0, 5.0), "sixel", 1, PAPER)
    assert re.match(r'\x1bP[0-9;]*q"1;1;', band.sequence)
    assert re.search(r"#([0-9]+);2;100;0;0(#\1)+!", band.sequence)
    assert band.sequence.endswith("\x1b\\")


def test_wide_sixels_are_in_pieces_that_xterm_takes() -> None:
    pixels = noise(300, 30)
    bands = bands_of(pixels, frame_of(pixels, wish(150, 10)), _CELL, "sixel", 1, PAPER)
    assert {(band.left, band.columns) for band in bands} == {(0, 75), (75, 75)}
    widths = [int(re.findall(r'"1;1;(\d+);', band.sequence)[0]) for band in bands]
    assert set(widths) == {750}
    drawn = Painter("sixel").painted(bands, (2, 3), ())
    assert re.findall(r"\x1b\[(\d+);(\d+)H", drawn)[:2] == [("4", "3"), ("4", "78")]
    (kitty, *_) = bands_of(pixels, frame_of(pixels, wish(150, 10)), _CELL, "kitty", 1, PAPER)
    assert kitty.columns == 150


def changed(pixels: Pixels, row: int) -> Pixels:
    """Return an image with another row of cells."""
    line = 3 * pixels.width * 20
    before, after = pixels.data[: row * line], pixels.data[(row + 1) * line :]
    return Pixels(pixels.width, pixels.height, before + bytes(line) + after)


@pytest.mark.parametrize("protocol", ["kitty", "sixel"])
def test_only_bands_that_differ_are_sent(protocol: str) -> None:
    pixels, area = noise(160, 320), wish(16, 16)
    painter, frame = Painter(protocol), frame_of(pixels, area)  # type: ignore[arg-type]
    bands = bands_of(pixels, frame, _CELL, protocol, 1, PAPER)  # type: ignore[arg-type]
    assert len(bands) == BANDS
    first = painter.painted(bands, (3, 5), ())
    assert [(int(row), int(column)) for row, column in _PLACE.findall(first)] == [(6 + 2 * at, 4) for at in range(8)]
    assert first.startswith("\x1b7")
    assert first.endswith("\x1b8")
    assert painter.painted(bands, (3, 5), ()) == ""
    after = bands_of(changed(pixels, 9), frame, _CELL, protocol, 1, PAPER, bands)  # type: ignore[arg-type]
    assert [place[0] for place in _PLACE.findall(painter.painted(after, (3, 5), ()))] == ["14"]


def test_kitty_band_goes_after_its_successor_came() -> None:
    pixels = noise(160, 320)
    painter, frame = Painter("kitty"), frame_of(pixels, wish(16, 16))
    bands = bands_of(pixels, frame, _CELL, "kitty", 1, PAPER)
    painter.painted(bands, (0, 0), ())
    after = bands_of(changed(pixels, 9), frame, _CELL, "kitty", 1, PAPER, bands)
    keys = [keys for keys, _ in _COMMAND.findall(painter.painted(after, (0, 0), ())) if "a=" in keys]
    assert [each.partition(",")[0] for each in keys] == ["a=T", "a=d"]
    assert f"i={after[4].image_id}," in keys[0]
    assert keys[1] == f"a=d,d=I,i={bands[4].image_id},q=2"


def test_covered_bands_are_taken_away_and_come_back() -> None:
    pixels = noise(160, 320)
    painter = Painter("kitty")
    bands = bands_of(pixels, frame_of(pixels, wish(16, 16)), _CELL, "kitty", 1, PAPER)
    painter.painted(bands, (0, 0), ())
    covered = painter.painted(bands, (0, 0), {2, 3, 4})
    assert [keys for keys, _ in _COMMAND.findall(covered)] == [f"a=d,d=I,i={each},q=2" for each in (2, 3)]
    back = painter.painted(bands, (0, 0), ())
    assert [place[0] for place in _PLACE.findall(back)] == ["3", "5"]
    assert len(_COMMAND.findall(painter.taken_away())) == BANDS


def test_sixels_under_text_are_drawn_again() -> None:
    pixels = noise(160, 320)
    bands = bands_of(pixels, frame_of(pixels, wish(16, 16)), _CELL, "sixel", 1, PAPER)
    painter = Painter("sixel")
    painter.painted(bands, (0, 0), ())
    painter.overwritten(range(3, 5))
    assert [place[0] for place in _PLACE.findall(painter.painted(bands, (0, 0), ()))] == ["3", "5"]
    painter.lost()
    assert len(_PLACE.findall(painter.painted(bands, (0, 0), ()))) == BANDS
    assert painter.taken_away() == ""


def test_text_takes_sixels_away_that_are_to_go() -> None:
    """No sequence does, and where text and text below them are the same, nothing else would write it."""
    pixels = noise(160, 320)
    bands = bands_of(pixels, frame_of(pixels, wish(16, 16)), _CELL, "sixel", 1, PAPER)
    rows = bands[0].rows
    painter = Painter("sixel")
    painter.painted(bands, (4, 3), ())
    assert painter.lifted(bands, (4, 3), ()) == []
    painter.overwritten(range(rows))  # by a box, which covers a part of the first band
    assert painter.lifted(bands, (4, 3), (0,)) == [Region(4, 3, 17, rows)]
    assert len(painter.lifted(bands, (5, 3), ())) == BANDS - 1
    assert painter.lifted((), (5, 3), ()) == []
    kitty = Painter("kitty")
    kitty.painted(bands, (4, 3), ())
    assert kitty.lifted((), (4, 3), ()) == []


def test_image_at_another_place_is_drawn_anew() -> None:
    pixels = noise(160, 320)
    bands = bands_of(pixels, frame_of(pixels, wish(16, 16)), _CELL, "kitty", 1, PAPER)
    painter = Painter("kitty")
    painter.painted(bands, (0, 0), ())
    moved = painter.painted(bands, (20, 0), ())
    assert sum(keys.startswith("a=d") for keys, _ in _COMMAND.findall(moved)) == BANDS
    assert len(_PLACE.findall(moved)) == BANDS
