"""Pictures of the other side, and the rows, files and pixels that are made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser, check_text

from rsb_bridge.model.text import is_clean
from rsb_extras.pictures.blocks import image_rows
from rsb_extras.pictures.picture import (
    MOST_COLUMNS,
    Cells,
    Curve,
    FieldNumber,
    Picture,
    PictureError,
    Pixels,
    Scale,
    Series,
    Wish,
    decode_picture,
    encode_picture,
)
from rsb_extras.pictures.picture_files import formats_of, picture_file
from rsb_extras.pictures.picture_rows import UnreadableError, picture_rows

if TYPE_CHECKING:
    from rsb_extras.pictures.picture_rows import Row

_WIDTH, _HEIGHT = 40, 12


def rows_of(content: Cells | Pixels | Series, colours: int) -> list[Row]:
    if isinstance(content, Pixels):
        return image_rows(content, Wish(_WIDTH, _HEIGHT), colours=colours, sextants=colours > 16)
    return picture_rows(content, _WIDTH, _HEIGHT)


def _read_picture(data: bytes) -> None:
    """Any bytes, as a picture that a console shows and writes to files."""
    try:
        picture = decode_picture(data)
    except PictureError:
        return
    assert decode_picture(encode_picture(picture)) == picture
    check_text(picture.problem, 500)
    if picture.content is None:
        return
    for colours in (0, 16, 256):
        try:
            rows = rows_of(picture.content, colours)
        except UnreadableError:
            continue
        for row in rows:
            assert all(is_clean(part.text) for part in row)
            assert sum(len(part.text) for part in row) <= MOST_COLUMNS
    for suffix in formats_of(picture.content):
        try:
            assert picture_file(picture.content, suffix)
        except UnreadableError:
            continue


_PICTURES = (
    Picture(Pixels(2, 2, bytes(12)), taken=1, stamp=1, messages=2, size=9, type_name="a/msg/B", notes=("2×2",)),
    Picture(Pixels(1, 1, b"RIFF\x1a\0\0\0WEBPVP8L", "webp")),
    Picture(Cells(("ab", "⣿▲"), bytes((0, 1, 0, 2)), ("", "dim", "#102030"), Scale("map", 0.0, 1.0, 0.1, 0.2))),
    Picture(Cells(("▀⠠█",), bytes((1, 2, 3)), ("", "@#102030", "free", "occupied"), None, bytes((2, 2, 1)))),
    Picture(numbers=(FieldNumber("/odom", "twist.x", 0.5), FieldNumber("/odom", '["ö"]'))),
    Picture(Series(1.0, 0.5, (Curve("x", (1.0, None), (2.0, None), 1.5, 1.5),)), problem="late"),
)

PARSERS = (Parser("picture", _read_picture, tuple(map(encode_picture, _PICTURES)), edit_msgpack),)
