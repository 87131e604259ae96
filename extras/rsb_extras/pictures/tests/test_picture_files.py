"""Pictures as files, read back by others' readers."""

from __future__ import annotations

import csv
import io
import math
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_extras.pictures.picture import STYLES, Cells, Curve, Picture, Pixels, Series, decode_picture
from rsb_extras.pictures.picture import encode_picture as encoded
from rsb_extras.pictures.picture_files import FORMATS, formats_of, picture_file

_SVG = "{http://www.w3.org/2000/svg}"
PIXELS = Pixels(3, 2, bytes(range(0, 180, 10)))
CELLS = Cells(("a<b", "&  "), bytes((0, 1, 1, 2, 2, 2)), ("", "robot", "#12ab34"))
SERIES = Series(
    100.0, 0.5, (Curve("x", (1.0, None, -2.5), (1.5, None, 3e20), 3.0), Curve("y[1]", (None,) * 3, (None,) * 3))
)


def spans(content: Cells) -> list[list[tuple[str, str]]]:
    """Return the texts and colours of an SVG's lines."""
    root = ElementTree.fromstring(picture_file(content, ".svg"))
    return [[(span.text or "", span.get("fill", "")) for span in line] for line in root.iter(f"{_SVG}text")]


@pytest.mark.parametrize("pixels", [PIXELS, Pixels(1, 1, b"abc"), Pixels(400, 300, bytes(360_000))])
def test_png_has_the_pixels(pixels: Pixels) -> None:
    image = pytest.importorskip("PIL.Image", reason="needs Pillow")
    read = image.open(io.BytesIO(picture_file(pixels, ".png")))
    read.load()
    assert (read.format, read.mode, read.size) == ("PNG", "RGB", (pixels.width, pixels.height))
    assert read.tobytes() == pixels.data


def test_png_of_webp_has_its_pixels() -> None:
    image = pytest.importorskip("PIL.Image", reason="needs Pillow")
    file = io.BytesIO()
    image.frombytes("RGB", (3, 2), PIXELS.data).save(file, "WEBP", lossless=True)
    read = image.open(io.BytesIO(picture_file(Pixels(3, 2, file.getvalue(), "webp"), ".png")))
    assert read.tobytes() == PIXELS.data


@pytest.mark.parametrize(
    ("shape", "size"), [(2.0, (40, 60)), (0.5, (80, 30)), (1.02, (40, 31)), (128.0, (20, 1920)), (1 / 64, (1920, 22))]
)
def test_png_has_square_pixels(shape: float, size: tuple[int, int]) -> None:
    """Of an image that was made for cells of another shape, and within the limit of all images."""
    image = pytest.importorskip("PIL.Image", reason="needs Pillow")
    pixels = Pixels(40, 30, (b"\0\0\0" * 20 + b"\xff\xff\xff" * 20) * 30, shape=shape)
    read = image.open(io.BytesIO(picture_file(pixels, ".png")))
    assert read.size == size
    half, bottom = size[0] // 2, size[1] - 1
    assert (read.getpixel((half - 1, bottom)), read.getpixel((half, 0))) == ((0, 0, 0), (255, 255, 255))


def test_svg_has_the_characters_and_their_colours() -> None:
    (first, second), (third,) = spans(CELLS)
    assert [text for text, _ in (first, second, third)] == ["a", "<b", "&  "]
    assert third[1] == "#12ab34"
    assert len({first[1], second[1], third[1]}) == 3


def test_svg_is_as_large_as_its_characters() -> None:
    root = ElementTree.fromstring(picture_file(CELLS, ".svg"))
    small = ElementTree.fromstring(picture_file(Cells(("x",)), ".svg"))
    assert int(root.get("width", "0")) == 3 * int(small.get("width", "0"))
    assert int(root.get("height", "0")) == 2 * int(small.get("height", "0"))


@given(rows=st.lists(st.text(max_size=12), max_size=4), data=st.data())
def test_any_characters_are_an_svg(rows: list[str], data: st.DataObject) -> None:
    palette = (*STYLES, "#0a0b0c")
    count = sum(map(len, rows))
    styles = bytes(data.draw(st.lists(st.integers(0, len(palette) - 1), min_size=count, max_size=count)))
    content = decode_picture(encoded(Picture(Cells(tuple(rows), styles, palette)))).content
    assert isinstance(content, Cells)
    texts = ["".join(text for text, _ in line) for line in spans(content)]
    assert texts == [row.replace("\ufffe", "\ufffd").replace("\uffff", "\ufffd") for row in content.rows]


def test_svg_has_no_characters_that_xml_lacks() -> None:
    assert spans(Cells(("a\ufffe\uffffb",))) == [[("a\ufffd\ufffdb", "#d0d0d0")]]


def test_text_has_no_blanks_at_ends_of_lines() -> None:
    assert picture_file(Cells(("é ▀  ", "", "x")), ".txt").decode() == "é ▀\n\nx\n"
    assert picture_file(Cells(()), ".txt") == b""


def test_csv_has_the_columns_with_values() -> None:
    head, *rows = csv.reader(io.StringIO(picture_file(SERIES, ".csv").decode()))
    assert head == ["time", "x.low", "x.high", "y[1].low", "y[1].high"]
    assert [[float(value) if value else None for value in row] for row in rows] == [
        [100.0, 1.0, 1.5, None, None],
        [101.0, -2.5, 3e20, None, None],
    ]


@pytest.mark.parametrize("name", ['a"b', "a,b", '=HYPERLINK("x")', "@x", "+1", "-1"])
def test_name_in_csv_is_one_harmless_cell(name: str) -> None:
    series = Series(0.0, 1.0, (Curve(name, (1.0,), (1.0,)),))
    head, row = csv.reader(io.StringIO(picture_file(series, ".csv").decode()))
    assert len(head) == len(row) == 3
    assert head[1].lstrip("'") == f"{name}.low"
    assert head[1][0] not in "=+-@"


@given(st.lists(st.one_of(st.none(), st.floats(-1e300, 1e300)), min_size=1, max_size=6).map(tuple))
def test_any_values_in_csv_are_exact(values: tuple[float | None, ...]) -> None:
    series = Series(0.0, 1.0, (Curve("x", values, values),))
    _, *rows = csv.reader(io.StringIO(picture_file(series, ".csv").decode()))
    assert [float(row[1]) for row in rows] == [value for value in values if value is not None]
    assert all(math.isfinite(float(row[0])) for row in rows)


def test_a_plot_without_curves_is_a_head() -> None:
    assert picture_file(Series(0.0, 1.0, ()), ".csv").decode().split() == ["time"]


@pytest.mark.parametrize("content", [PIXELS, CELLS, SERIES])
def test_picture_is_written_in_its_formats_only(content: Cells | Pixels | Series) -> None:
    own = formats_of(content)
    assert own
    for suffix in FORMATS:
        if suffix in own:
            assert picture_file(content, suffix)
        else:
            with pytest.raises(ValueError, match=own[0]):
                picture_file(content, suffix)
