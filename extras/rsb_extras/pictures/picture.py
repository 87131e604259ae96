"""Pictures of messages: a viewer's wish, and what the sending side draws for it.

The side that has a topic renders its messages for the viewer's terminal, and sends only the picture. It crosses a link
on an internal route of its own (`rsb_extras.pictures.link_views.VIEW`).
"""

from __future__ import annotations

import contextlib
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import sanitize_text
from rsb_bridge.model.text import UNPRINTABLE, single_cells

# Limits of the protocol (docs/picture-protocol.md).
MOST_COLUMNS, MOST_ROWS = 400, 150
"""Cells of the largest picture."""
MOST_ACROSS, MOST_DOWN = 16, 32
"""Pixels of an image across and down a cell."""
MOST_FINE = 4
"""Cells of a map in each direction of a character, for viewers that draw it in pixels."""
_FLATTEST, _HIGHEST = 0.5, 8.0
"""Heights of a cell over its width."""
LONGEST_SIDE = 1920
"""Pixels of an image's width and height."""
MOST_RATE = 10.0
"""Hz."""
TOPICS_AT_ONCE = 8
"""Topics in one view: the map view lays several over one another."""
PICTURE_LIMIT = 1 << 20
"""Bytes of an encoded picture."""
_TEXT = 255
_Text: TypeAlias = Annotated[str, Meta(max_length=_TEXT, pattern=rf"\A[^{UNPRINTABLE}]*\Z")]
_Number: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]
MOST_NUMBERS = 1000
"""Numbers of which a viewer chooses some to plot."""
MOST_VALUE = 1e300
"""Largest value of a plot: differences and sums stay finite."""
_Value: TypeAlias = Annotated[float, Meta(ge=-MOST_VALUE, le=MOST_VALUE)]
_Place: TypeAlias = Annotated[float, Meta(ge=-1e100, le=1e100)]
_Step: TypeAlias = Annotated[float, Meta(ge=1e-12, le=1e100)]
_Style: TypeAlias = Annotated[str, Meta(max_length=16, pattern=r"\A(|@?[a-z]+|@?#[0-9a-fA-F]{6})\Z")]


class Wish(msgspec.Struct, frozen=True, omit_defaults=True):
    """A viewer's wish, which it may change with each picture.

    Attributes:
        width: cells of the picture's area.
        height: cells of the picture's area.
        rate: Hz of pictures, at most.
        how: kind of picture, or an empty string for the usual one of the type: ``plot`` draws numbers over time,
            ``tree`` shows all fields, ``fields`` lists the numbers to plot (`Picture.numbers`).
        fields: paths of the numbers to plot (``pose.position.x``, ``ranges[3]``), with the topic before them if there
            are several (``/odom:pose.position.x``, `field_of`), or none for the usual ones.
        zoom: factor; above 1 shows less, larger.
        x: shift of the view to the right, in parts of its width.
        y: shift of the view upwards, in parts of its height.
        tilt: degrees by which points are seen from the side, from 0 (above) to 90.
        frame: frame of a map, or an empty string for the first topic's.
        colour: colour of points by ``height`` or ``intensity``.
        seconds: length of a plot's time axis.
        level: lowest level of the shown log messages (rcl_interfaces/msg/Log) or diagnostics.
        webp: whether the viewer reads WebP, which takes a tenth of the bytes.
        across: pixels of an image across a cell; above 1 only with WebP.
        down: pixels of an image down a cell.
        shape: height of a cell over its width.
        match: text that shown log messages, nodes, frames or fields contain.
        fine: cells of a map in each direction of a character, and columns of a plot by so many times, as far as they
            stay within the largest picture.
    """

    width: Annotated[int, Meta(ge=1, le=MOST_COLUMNS)] = 80
    height: Annotated[int, Meta(ge=1, le=MOST_ROWS)] = 24
    rate: Annotated[float, Meta(gt=0, le=MOST_RATE)] = 2.0
    how: Annotated[str, Meta(max_length=16)] = ""
    fields: Annotated[tuple[_Text, ...], Meta(max_length=8)] = ()
    zoom: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0
    x: _Number = 0.0
    y: _Number = 0.0
    tilt: Annotated[float, Meta(ge=0, le=90)] = 0.0
    frame: _Text = ""
    colour: Literal["height", "intensity"] = "height"
    seconds: Annotated[float, Meta(ge=1, le=3600)] = 30.0
    level: Annotated[int, Meta(ge=0, le=255)] = 0
    match: _Text = ""
    webp: bool = False
    across: Annotated[int, Meta(ge=1, le=MOST_ACROSS)] = 1
    down: Annotated[int, Meta(ge=1, le=MOST_DOWN)] = 2
    shape: Annotated[float, Meta(ge=_FLATTEST, le=_HIGHEST)] = 2.0
    fine: Annotated[int, Meta(ge=1, le=MOST_FINE)] = 1

    @property
    def allowed_fine(self) -> int:
        """`fine`, or as much of it as the largest picture allows."""
        return max(1, min(self.fine, MOST_COLUMNS // self.width, MOST_ROWS // self.height))


def sized(wish: Wish, width: int, height: int, across: int, down: int, shape: float) -> Wish:
    """Return a wish for an area and its cells, as far as the other side accepts that: it refuses one out of bounds."""
    return msgspec.structs.replace(
        wish,
        width=max(1, min(MOST_COLUMNS, width)),
        height=max(1, min(MOST_ROWS, height)),
        across=max(1, min(MOST_ACROSS, across)),
        down=max(1, min(MOST_DOWN, down)),
        shape=max(_FLATTEST, min(_HIGHEST, shape)),
    )


def in_full(wish: Wish) -> Wish:
    """Return a wish for an image in its own resolution, up to `LONGEST_SIDE`, if the viewer reads WebP."""
    most = {"width": MOST_COLUMNS, "height": MOST_ROWS, "across": MOST_ACROSS, "down": MOST_DOWN}
    # In the shape of a terminal's cells, the image would be as high as it is shown there, not as it is.
    return msgspec.structs.replace(wish, **most, shape=MOST_DOWN / MOST_ACROSS)


def field_of(topic: str, path: str) -> str:
    """Return the path of a number of one of several topics, as in `Wish.fields`."""
    return f"{topic}:{path}"


def split_field(field: str) -> tuple[str, str]:
    """Return the topic of a path in `Wish.fields`, or an empty string, and the path in its messages."""
    topic, colon, path = field.partition(":")
    return (topic, path) if colon and topic.startswith("/") else ("", field)


class Pixels(msgspec.Struct, frozen=True, omit_defaults=True, tag="pixels"):
    """An image.

    Attributes:
        width: pixels; a cell of a terminal shows one in width, unless the wish has more detail.
        height: pixels; a cell of a terminal shows two, one above the other.
        data: three bytes a pixel, red, green and blue, row by row from the top; or a WebP file.
        coding: of `data`; ``webp-doubled`` has twice as many pixels across and down, since WebP halves colours.
        shape: height of a pixel over its width. It gives the image's proportions, whatever the viewer wishes by now.
    """

    width: Annotated[int, Meta(ge=1, le=LONGEST_SIDE)]
    height: Annotated[int, Meta(ge=1, le=LONGEST_SIDE)]
    data: bytes
    coding: Literal["rgb", "webp", "webp-doubled"] = "rgb"
    shape: Annotated[float, Meta(ge=_FLATTEST / MOST_DOWN, le=_HIGHEST * MOST_ACROSS)] = 1.0


class Scale(msgspec.Struct, frozen=True):
    """The place of a map's cells in the world.

    Attributes:
        left: m, x of the left edge.
        top: m, y of the upper edge.
        column: m a cell to the right.
        row: m a cell down; a cell is about twice as high as wide.
    """

    frame: _Text
    left: _Place
    top: _Place
    column: _Step
    row: _Step


class Cells(msgspec.Struct, frozen=True, omit_defaults=True, tag="cells"):
    """Characters with styles.

    Attributes:
        rows: of the text. Each character takes one cell; rows may be shorter than the picture is wide.
        styles: for each character of each row, one after the other, the index of its style in `palette`.
        palette: names of styles (`STYLES`), or colours as ``#rrggbb``. Behind a character they are tints, which a
            viewer mixes with its own background; ``@`` before one gives a character itself the colour of that tint.
        scale: the place of the cells in the world, if they are a map.
        backgrounds: for each character, as in `styles`, the index of the tint behind it, or empty for none at all.
        fine: cells in each direction of a character of text, which are drawn as pixels if there are several.
    """

    rows: Annotated[tuple[Annotated[str, Meta(max_length=MOST_COLUMNS)], ...], Meta(max_length=MOST_ROWS)]
    styles: bytes = b""
    palette: Annotated[tuple[_Style, ...], Meta(max_length=256)] = ()
    scale: Scale | None = None
    backgrounds: bytes = b""
    fine: Annotated[int, Meta(ge=1, le=MOST_FINE)] = 1


STYLES = (
    "", "dim", "strong", "axis", "ok", "warning", "error", "robot", "path", "scan", "occupied", "free", "goal",
    "unknown", "lethal",
)  # fmt: skip
"""Styles of `Cells` that a viewer's theme colours."""


class Series(msgspec.Struct, frozen=True, omit_defaults=True, tag="series"):
    """Numbers over time, reduced to the columns that a plot has.

    Attributes:
        start: s since the epoch on the sending side's clock, at the left edge of the first column.
        step: s a column.
    """

    start: Annotated[float, Meta(ge=-1e12, le=1e12)]
    step: Annotated[float, Meta(ge=1e-6, le=1e9)]
    curves: Annotated[tuple[Curve, ...], Meta(max_length=8)]


class Curve(msgspec.Struct, frozen=True, omit_defaults=True):
    """One number over time.

    Attributes:
        name: path of the field.
        lows: lowest value in each column, or None where none came.
        highs: highest value in each column, or None.
        last: newest value, or None before the first.
        mean: of all values in the plot, or None.
    """

    name: _Text
    lows: Annotated[tuple[_Value | None, ...], Meta(max_length=2 * MOST_COLUMNS)] = ()
    highs: Annotated[tuple[_Value | None, ...], Meta(max_length=2 * MOST_COLUMNS)] = ()
    last: _Value | None = None
    mean: _Value | None = None


class FieldNumber(msgspec.Struct, frozen=True, omit_defaults=True):
    """A number that can be plotted.

    Attributes:
        path: in the topic's messages.
        value: newest one, or None if that is no number (NaN) or infinite.
    """

    topic: _Text
    path: _Text
    value: _Value | None = None


class Picture(msgspec.Struct, frozen=True, omit_defaults=True):
    """A picture of messages, or the reason why it is missing.

    Attributes:
        content: the picture, or None before the first message, or with a problem.
        taken: ns since the epoch on the sending side's clock, when DDS received the newest message in it, or 0.
            Messages of the same stamp and content count as the first of them: a camera that hangs repeats its last one.
        stamp: ns since the epoch, the newest message's own stamp (``header.stamp``), or 0.
        messages: received since the view began.
        size: bytes of the newest message.
        type_name: of the first topic.
        notes: lines about the picture (``1920×1080 rgb8``).
        problem: the reason why there is no picture, or why it is incomplete, and what to do.
        waiting: before the first message: facts about the topic's publishers, and what to do.
        number: of the content, from 1; each other content of a view has another one. 0 within one side.
        is_unchanged: whether the content is left out, as it is the one that was sent with this number.
        numbers: all that can be plotted, if the wish asks for ``fields``; then there is no content.
        changed: ns as of `taken`, when the first message with the newest one's content came, whatever their stamps.
    """

    content: Pixels | Cells | Series | None = None
    taken: int = 0
    stamp: int = 0
    messages: int = 0
    size: int = 0
    type_name: _Text = ""
    notes: Annotated[tuple[_Text, ...], Meta(max_length=16)] = ()
    problem: Annotated[str, Meta(max_length=500, pattern=rf"\A[^{UNPRINTABLE}]*\Z")] = ""
    waiting: _Text = ""
    number: Annotated[int, Meta(ge=0, le=(1 << 63) - 1)] = 0
    is_unchanged: bool = False
    numbers: Annotated[tuple[FieldNumber, ...], Meta(max_length=MOST_NUMBERS)] = ()
    changed: int = 0


class Viewed(msgspec.Struct, frozen=True, omit_defaults=True):
    """A picture as a viewer gets it.

    Attributes:
        where: the link's name if the other side drew it, or an empty string if this side did.
        age: s since DDS received the newest message in it, by both machines' clocks, or None if it has none, or if the
            clocks cannot be compared.
        encoded: bytes of the picture as it crossed the link, before compression.
    """

    picture: Picture
    where: str = ""
    age: float | None = None
    encoded: int = 0


class PictureError(ValueError):
    """Bytes are no picture."""


class _Unchanged(msgspec.Struct):
    is_unchanged: bool = False


_unchanged_decoder = msgspec.msgpack.Decoder(_Unchanged)
_encoder, _decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(Picture)


def encode_picture(picture: Picture) -> bytes:
    """Return a picture as bytes."""
    return _encoder.encode(picture)


def is_unchanged(encoded: bytes) -> bool:
    """Whether an encoded picture leaves out its content; what is no picture does not."""
    with contextlib.suppress(msgspec.MsgspecError, ValueError):
        return _unchanged_decoder.decode(encoded).is_unchanged
    return False


def decode_picture(encoded: bytes) -> Picture:
    """Return a picture of a side that is not trusted, safe for terminals.

    Raises:
        PictureError: the bytes are no picture, or its parts do not fit each other.
    """
    if len(encoded) > PICTURE_LIMIT:
        raise PictureError(f"a picture of {len(encoded):,} bytes; at most {PICTURE_LIMIT:,} are read")
    try:
        picture = _decoder.decode(encoded)
    except (msgspec.MsgspecError, ValueError) as error:  # ValueError: a text that is not UTF-8
        raise PictureError(str(error)) from None
    return check_picture(picture)


def check_picture(picture: Picture) -> Picture:
    """Return a decoded picture of a side that is not trusted, safe for terminals.

    Raises:
        PictureError: its parts do not fit each other.
    """
    content = picture.content
    if isinstance(content, Pixels):
        if content.coding == "rgb" and len(content.data) != 3 * content.width * content.height:
            raise PictureError("an image has not as many bytes as its size says")
    elif isinstance(content, Cells):
        characters = sum(map(len, content.rows))
        for indices in (content.styles, content.backgrounds):
            if len(indices) not in (0, characters):
                raise PictureError("not each character has a style")
            if max(indices, default=0) >= max(1, len(content.palette)):  # 0 needs no palette
                raise PictureError("a character has a style that is not in the palette")
        if not all((name := style.removeprefix("@")) in STYLES or name.startswith("#") for style in content.palette):
            raise PictureError("the palette has a style that is none")
        if content.scale is not None and min(content.scale.column, content.scale.row) <= 0:
            raise PictureError("a map's cells have no size")
        rows = tuple(single_cells(sanitize_text(row)) for row in content.rows)
        content = msgspec.structs.replace(content, rows=rows)
        picture = msgspec.structs.replace(picture, content=content)
    elif isinstance(content, Series):
        if len({len(each) for curve in content.curves for each in (curve.lows, curve.highs)}) > 1:
            raise PictureError("a plot's curves have different lengths")
        curves = tuple(msgspec.structs.replace(curve, name=single_cells(curve.name)) for curve in content.curves)
        content = msgspec.structs.replace(content, curves=curves)
        picture = msgspec.structs.replace(picture, content=content)
    return picture
