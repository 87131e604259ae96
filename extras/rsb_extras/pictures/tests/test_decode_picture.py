"""Pictures of the other side: the ones that fit are read as they were written, others are refused."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rsb_extras.pictures.picture import (
    LONGEST_SIDE,
    MOST_COLUMNS,
    MOST_NUMBERS,
    MOST_ROWS,
    MOST_VALUE,
    PICTURE_LIMIT,
    Cells,
    Curve,
    FieldNumber,
    Picture,
    PictureError,
    Pixels,
    Scale,
    Series,
    decode_picture,
    encode_picture,
)
from rsb_extras.pictures.tests import picture_places

WHOLE = [
    Picture(),
    Picture(numbers=(FieldNumber("/t", "x", 0.5), FieldNumber("/t", "y[a]"))),
    Picture(None, 1, 2, 3, 4, "std_msgs/msg/String", ("a", "b"), "no message"),
    Picture(Pixels(2, 2, bytes(12))),
    Picture(Pixels(LONGEST_SIDE, LONGEST_SIDE, b"any bytes", "webp")),
    Picture(Cells(("ab", "", "é"), b"\0\1\0", ("", "#00ff00"), Scale("map", -1.0, 1.0, 0.5, 1.0))),
    Picture(Cells(("ab",), b"\0\0", ("", "free", "@unknown", "@#00ff00"), None, b"\1\2")),
    Picture(Cells(("x" * MOST_COLUMNS,) * MOST_ROWS)),
    Picture(Series(0.0, 0.1, (Curve("x", (1.0, None), (2.0, None), 1.0, 1.5), Curve("y", (None,) * 2, (None,) * 2)))),
    Picture(Series(-5.0, 1e9, ())),
    Picture(Series(0.0, 1.0, (Curve("x", (-MOST_VALUE,), (MOST_VALUE,)),))),
    Picture(Pixels(MOST_COLUMNS, 2 * MOST_ROWS, bytes(6 * MOST_COLUMNS * MOST_ROWS))),
]


@pytest.mark.parametrize("picture", WHOLE)
def test_a_picture_is_read_as_it_was_written(picture: Picture) -> None:
    assert decode_picture(encode_picture(picture)) == picture


def raw(content: Any = None, **fields: Any) -> bytes:
    """Return a picture that nobody has checked."""
    return msgspec.msgpack.encode({"content": content, **fields})


def pixels(width: Any, height: Any, data: Any, **more: Any) -> dict[str, Any]:
    return {"type": "pixels", "width": width, "height": height, "data": data, **more}


def cells(*rows: str, **more: Any) -> dict[str, Any]:
    return {"type": "cells", "rows": rows, **more}


def series(*curves: Any, start: float = 0.0, step: float = 1.0) -> dict[str, Any]:
    return {"type": "series", "start": start, "step": step, "curves": curves}


@pytest.mark.parametrize(
    "content",
    [
        pixels(2, 2, bytes(11)),
        pixels(2, 2, bytes(13)),
        pixels(2, 2, b""),
        pixels(0, 2, b""),
        pixels(2, 0, b""),
        pixels(-1, -1, bytes(3)),
        pixels(LONGEST_SIDE + 1, 1, bytes(3 * (LONGEST_SIDE + 1))),
        pixels(1, LONGEST_SIDE + 1, bytes(3 * (LONGEST_SIDE + 1))),
        pixels(65535, 65535, b"RIFF", coding="webp"),
        pixels(1, 1, bytes(3), coding="png"),
        pixels(1, 1, "abc"),
        cells("x" * (MOST_COLUMNS + 1)),
        cells(*["x"] * (MOST_ROWS + 1)),
        cells("ab", styles=b"\0", palette=("",)),
        cells("ab", styles=b"\0\0\0", palette=("",)),
        cells("ab", styles=b"\0\1", palette=("",)),
        cells("ab", styles=b"\1\1"),
        cells("ab", styles=b"\0\0", palette=("",) * 257),
        cells("ab", styles=b"\0\0", palette=("blinking",)),
        cells("ab", backgrounds=b"\0", palette=("",)),
        cells("ab", backgrounds=b"\0\1", palette=("",)),
        cells("ab", styles=b"\0\0", palette=("@",)),
        cells("ab", styles=b"\0\0", palette=("@@free",)),
        cells("ab", styles=b"\0\0", palette=("@blinking",)),
        cells("a", scale={"frame": "\x1b[2J", "left": 0, "top": 0, "column": 1, "row": 1}),
        series({"name": "x", "lows": [1.0], "highs": [1.0, 2.0]}),
        series({"name": "x", "lows": [1.0], "highs": [1.0]}, {"name": "y"}),
        series({"name": "x", "lows": [None] * (2 * MOST_COLUMNS + 1), "highs": [None] * (2 * MOST_COLUMNS + 1)}),
        series({"name": "x", "lows": [2 * MOST_VALUE], "highs": [1.0]}),
        series({"name": "x", "last": float("nan")}),
        series({"name": "x\x1b[2J"}),
        series({"name": "x" * 256}),
        series(*[{"name": "x"}] * 9),
        series(step=0.0),
        series(step=-1.0),
        series(start=1e13),
        {"type": "other"},
        [1, 2],
        "text",
    ],
)  # fmt: skip
def test_parts_that_do_not_fit_are_refused(content: Any) -> None:
    with pytest.raises(PictureError):
        decode_picture(raw(content))


@pytest.mark.parametrize(
    "fields",
    [
        {"problem": "\x1b]0;title\x07"},
        {"problem": "two\nlines"},
        {"problem": "\u202eturned"},
        {"problem": "x" * 501},
        {"notes": ["zero\u200bwidth"]},
        {"notes": ["\x9b31m"]},
        {"notes": ["x" * 256]},
        {"notes": ["x"] * 17},
        {"type_name": "a\rb"},
        {"type_name": "x" * 256},
        {"numbers": [{"topic": "/t", "path": "x\x1b[2J"}]},
        {"numbers": [{"topic": "/t" * 200, "path": "x"}]},
        {"numbers": [{"topic": "/t", "path": "x", "value": float("inf")}]},
        {"numbers": [{"topic": "/t", "path": "x"}] * (MOST_NUMBERS + 1)},
        {"taken": "now"},
        {"messages": 1.5},
    ],
)
def test_texts_and_figures_that_are_none_are_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(PictureError):
        decode_picture(raw(**fields))


def test_control_characters_of_a_row_are_replaced() -> None:
    content = decode_picture(raw(cells("\x1b[2J\u202e\n\x9b", "ok"))).content
    assert isinstance(content, Cells)
    assert content.rows == ("\ufffd[2J\ufffd\ufffd\ufffd", "ok")


def test_too_many_bytes_are_refused_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    picture_places.PICTURE_DECODER.set(monkeypatch, None)
    with pytest.raises(PictureError):
        decode_picture(bytes(PICTURE_LIMIT + 1))


def test_fields_of_a_newer_version_are_ignored() -> None:
    assert decode_picture(raw(cells("x", blinks=True), depth=3)) == Picture(Cells(("x",)))


@pytest.mark.parametrize("picture", WHOLE[1:])
def test_a_part_of_a_picture_is_none(picture: Picture) -> None:
    encoded = encode_picture(picture)
    for length in {0, 1, len(encoded) // 2, len(encoded) - 1}:
        with pytest.raises(PictureError):
            decode_picture(encoded[:length])
    with pytest.raises(PictureError):
        decode_picture(encoded + b"\0")
