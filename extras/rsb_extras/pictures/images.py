"""Camera images: sensor_msgs Image and CompressedImage, reduced to the pixels that a viewer's terminal shows."""

from __future__ import annotations

import io
import warnings
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from rsb_bridge.feature_api import Wording
from rsb_extras.pictures.drawing import Drawn, UndrawableError, View, nested, raw, text
from rsb_extras.pictures.picture import LONGEST_SIDE, MOST_COLUMNS, MOST_ROWS, PICTURE_LIMIT, Pixels

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

    Array = NDArray[Any]

MOST_PIXELS = 64 << 20
"""Pixels of an image that is drawn at most: a round figure, as is the next one."""
_SAMPLES = 4
"""Pixels of the image, in each direction, that are averaged to one of the picture at most."""
_QUALITIES = (90, 60, 10)
"""Of WebP, the next one if a picture is too large: one of 80×48 pixels takes some 500 bytes, noise of 1920×1440 in the
last quality 850 kB."""
_DOUBLED_BELOW, _QUALITY_DOUBLED = 200, 60
"""Pixels in width below which a picture is doubled for WebP, which halves the resolution of colours. In this quality,
it takes a tenth more bytes, and its worst colours are a fourth to a third less wrong (docs/picture-costs.md)."""
_FAST_FROM = 4 * MOST_COLUMNS * MOST_ROWS
"""Pixels from which on WebP is made by the fastest method, which takes a third of the time."""
_LOW, _HIGH = 2.0, 98.0
"""Percentiles of the valid depths at the ends of the colours: few wrong depths may not dim the rest."""
_RAMP = np.array(
    [(48, 18, 59), (70, 107, 227), (40, 187, 235), (50, 241, 151), (164, 252, 60), (237, 208, 58), (251, 128, 34),
     (210, 49, 5), (122, 4, 3)], dtype=np.float32,
)  # fmt: skip
"""Colours from near to far, after Turbo (Mikhailov, 2019)."""


class ImageProblem(Wording):
    """The reason why an image cannot be drawn."""

    NO_SIZE = "the image is empty: {width}×{height}"
    TOO_LARGE = "the image is too large to draw: {width:,}×{height:,}; at most {limit:,} pixels"
    TOO_SHORT = "the image has {got:,} bytes; {width}×{height} in {encoding} needs {needed:,}"
    STEP = "the image's rows have {step:,} bytes; {width} pixels in {encoding} need {needed:,}"
    ENCODING = "images in {encoding!r} cannot be drawn"
    FORMAT = "compressed images in {format!r} cannot be drawn, only JPEG, PNG and WebP"
    BROKEN = "the compressed image is damaged: {error}"
    OTHER = "the compressed image is damaged: its {length:,} bytes do not begin like {format}"


ENCODINGS = {
    "rgb8": (1, 3, (0, 1, 2)), "bgr8": (1, 3, (2, 1, 0)), "rgba8": (1, 4, (0, 1, 2)), "bgra8": (1, 4, (2, 1, 0)),
    "rgb16": (2, 3, (0, 1, 2)), "bgr16": (2, 3, (2, 1, 0)), "rgba16": (2, 4, (0, 1, 2)), "bgra16": (2, 4, (2, 1, 0)),
    "8UC3": (1, 3, (2, 1, 0)), "8UC4": (1, 4, (2, 1, 0)), "16UC3": (2, 3, (2, 1, 0)), "16UC4": (2, 4, (2, 1, 0)),
    "mono8": (1, 1, (0, 0, 0)), "8UC1": (1, 1, (0, 0, 0)), "mono16": (2, 1, (0, 0, 0)),
}  # fmt: skip
"""Encodings with all channels of a pixel in its place (sensor_msgs/image_encodings.hpp): the bytes of a channel, the
number of channels, and the places of red, green and blue."""
DEPTHS = {"16UC1": ("u2", 1e-3), "32FC1": ("f4", 1.0)}
"""Encodings of depths (REP 118): the type, and m in one unit."""
NUMBERS = {"8SC1": "i1", "16SC1": "i2", "32SC1": "i4", "64FC1": "f8"}
"""Encodings of one number of any unit in a pixel: the type."""
YUV = {"yuv422": (1, 0), "uyvy": (1, 0), "yuv422_yuy2": (0, 1), "yuyv": (0, 1)}
"""Places of the brightness and of the colour among two bytes."""
PLANES = {"nv12": (2, 0), "nv21": (2, 1), "nv24": (1, 0)}
"""Encodings with the brightness of all pixels before their colours: the pixels, across and down, that share a colour,
and the place of its blue part among two bytes."""
BAYER = {
    "bayer_rggb8": (1, 0, 0), "bayer_bggr8": (1, 1, 1), "bayer_gbrg8": (1, 1, 0), "bayer_grbg8": (1, 0, 1),
    "bayer_rggb16": (2, 0, 0), "bayer_bggr16": (2, 1, 1), "bayer_gbrg16": (2, 1, 0), "bayer_grbg16": (2, 0, 1),
}  # fmt: skip
"""Bytes of a pixel, and row and column of the red one among four."""
_FORMATS = {b"\xff\xd8\xff": "JPEG", b"\x89PNG": "PNG", b"RIFF": "WEBP"}
_NAMED = ("jpeg", "jpg", "png", "webp")
"""Their names in a message's format (sensor_msgs/CompressedImage)."""
_DEPTH_HEADER = 12
"""Bytes before the PNG of a compressed depth image (compressed_depth_image_transport)."""


class ImageView(View):
    """Draws the newest image."""

    def __init__(self) -> None:
        self._message: Message | None = None

    def receive(self, received: TakenMessage) -> None:
        self._message = received.message

    def draw(self, wish: Wish) -> Drawn:
        if self._message is None:
            return Drawn()
        message = self._message
        if "format" in message:
            picture, note = _compressed(message, wish)
            return Drawn(picture, (note,))
        width, height = _size(message)
        encoding, step = text(message, "encoding"), _whole(message, "step")
        content, _ = raw(message, "data")
        data = np.frombuffer(content, np.uint8)
        is_big = bool(nested(message, "is_bigendian"))
        order = ">" if is_big else "<"
        notes = [f"{width}×{height} {encoding}"]

        def rows(size: int) -> Array:
            return _rows(data, width, height, step, size, encoding)

        def high_bytes(size: int, channels: int) -> Array:
            """Return the bytes that a terminal can show of channels of one or two bytes."""
            return rows(size * channels).reshape(height, width, channels, size)[..., 0 if is_big else -1]

        if encoding in DEPTHS:
            dtype, unit = DEPTHS[encoding]
            depth = _reduced(rows(int(dtype[1])).view(order + dtype)[:, :, None], wish)[:, :, 0]
            picture, span = _depth(depth.astype(np.float32) * unit, wish)
            return Drawn(picture, (*notes, span))
        if dtype := NUMBERS.get(encoding, ""):
            numbers = _reduced(rows(int(dtype[1])).view(order + dtype)[:, :, None], wish)[:, :, 0].astype(np.float64)
            picture, low, high = _coloured(numbers, np.isfinite(numbers), wish)
            return Drawn(picture, (*notes, f"{low:g} to {high:g}"))
        if encoding in ENCODINGS:
            size, channels, places = ENCODINGS[encoding]
            rgb = _reduced(high_bytes(size, channels), wish)[:, :, places]
        elif encoding in YUV:
            rgb = _yuv(rows(2), encoding, wish)
        elif encoding in PLANES:
            rgb = _planes(data, rows(1), step or width, encoding, wish)
        elif encoding in BAYER:
            size, row, column = BAYER[encoding]
            rgb = _bayer(high_bytes(size, 1)[:, :, 0], row, column, wish)
        else:
            raise UndrawableError(ImageProblem.ENCODING(encoding=encoding))
        return Drawn(_pixels(rgb, wish), tuple(notes))


def _whole(message: Message, name: str) -> int:
    value = nested(message, name)
    return value if isinstance(value, int) else 0


def _size(message: Message) -> tuple[int, int]:
    width, height = _whole(message, "width"), _whole(message, "height")
    _check_size(width, height)
    return width, height


def _check_size(width: int, height: int) -> None:
    if width <= 0 or height <= 0:
        raise UndrawableError(ImageProblem.NO_SIZE(width=width, height=height))
    if width * height > MOST_PIXELS:
        raise UndrawableError(ImageProblem.TOO_LARGE(width=width, height=height, limit=MOST_PIXELS))


def _rows(data: Array, width: int, height: int, step: int, size: int, encoding: str) -> Array:
    """Return an image's bytes by row, without padding."""
    needed = width * size
    step = step or needed
    if step < needed:
        raise UndrawableError(ImageProblem.STEP(step=step, width=width, encoding=encoding, needed=needed))
    total = step * (height - 1) + needed
    if len(data) < total:
        problem = ImageProblem.TOO_SHORT(got=len(data), width=width, height=height, encoding=encoding, needed=total)
        raise UndrawableError(problem)
    # The last row may lack its padding, so that the bytes cannot be reshaped to rows with it.
    rows = np.lib.stride_tricks.as_strided(data, (height, needed), (step, 1), writeable=False)
    return rows if step == needed else np.ascontiguousarray(rows)


def _part(height: int, width: int, wish: Wish) -> tuple[slice, slice]:
    """Return the rows and columns of an image that a zoomed view shows."""
    zoom = max(1.0, wish.zoom)
    shown_height, shown_width = max(1, round(height / zoom)), max(1, round(width / zoom))
    top = round((height - shown_height) / 2 - wish.y * shown_height)
    left = round((width - shown_width) / 2 + wish.x * shown_width)
    top, left = max(0, min(height - shown_height, top)), max(0, min(width - shown_width, left))
    return slice(top, top + shown_height), slice(left, left + shown_width)


def _is_webp(wish: Wish) -> bool:
    """Whether the picture is sent as WebP: the viewer reads that, and this side can write it."""
    return wish.webp and find_spec("PIL") is not None


def _density(wish: Wish) -> tuple[int, int]:
    """Return the pixels of the picture across and down a cell."""
    return (wish.across, wish.down) if _is_webp(wish) else (1, 2)


def _pixel_shape(wish: Wish) -> float:
    """Return the height of the picture's pixels over their width."""
    across, down = _density(wish)
    return across * wish.shape / down


def _fitted(height: int, width: int, wish: Wish) -> tuple[int, int]:
    """Return the height and width of the picture in pixels: as large as the area allows, in the same proportions."""
    across, down = _density(wish)
    most_width, most_height = min(LONGEST_SIDE, across * wish.width), min(LONGEST_SIDE, down * wish.height)
    height = round(height / _pixel_shape(wish))
    if across > 1:
        most_width, most_height = min(most_width, width), min(most_height, height)
    factor = min(most_width / width, most_height / height)
    return max(1, min(most_height, round(height * factor))), max(1, min(most_width, round(width * factor)))


def _reduced(pixels: Array, wish: Wish) -> Array:
    """Return the wished part of an image in the picture's size, by averages of a few pixels."""
    rows, columns = _part(pixels.shape[0], pixels.shape[1], wish)
    part = pixels[rows, columns]
    height, width = part.shape[:2]
    new_height, new_width = _fitted(height, width, wish)
    down = max(1, min(_SAMPLES, height // new_height))
    across = max(1, min(_SAMPLES, width // new_width))
    at_rows = _places(height, new_height * down)
    at_columns = _places(width, new_width * across)
    samples = part[at_rows[:, None], at_columns[None, :]]
    if down == across == 1:
        return samples
    blocks = samples.reshape(new_height, down, new_width, across, -1)
    if pixels.dtype.kind == "f" or pixels.dtype.itemsize > 1:
        nearest: Array = blocks[:, 0, :, 0]
        return nearest  # an average over the edge of a depth would be where nothing is
    means: Array = blocks.mean(axis=(1, 3)).astype(pixels.dtype)
    return means


def _places(length: int, count: int) -> Array:
    places: Array = ((np.arange(count) + 0.5) * length / count).astype(np.intp)
    return places


def _pixels(rgb: Array, wish: Wish) -> Pixels:
    (height, width), shape = rgb.shape[:2], _pixel_shape(wish)
    pixels = np.ascontiguousarray(rgb, dtype=np.uint8)
    if _is_webp(wish):
        if width < _DOUBLED_BELOW:
            doubled = pixels.repeat(2, axis=0).repeat(2, axis=1)
            return Pixels(width, height, _webp(doubled, (_QUALITY_DOUBLED, *_QUALITIES[2:])), "webp-doubled", shape)
        return Pixels(width, height, _webp(pixels, _QUALITIES), "webp", shape)
    return Pixels(width, height, pixels.tobytes(), shape=shape)


def _webp(pixels: Array, qualities: Sequence[int]) -> bytes:
    """Return pixels as a WebP file, in the first quality that is small enough."""
    from PIL import Image  # noqa: PLC0415 -- optional

    image, method = Image.fromarray(pixels), 0 if pixels.size // 3 > _FAST_FROM else 4
    for quality in qualities:
        file = io.BytesIO()
        image.save(file, "webp", quality=quality, method=method)
        if file.tell() <= PICTURE_LIMIT * 0.9:
            break
    return file.getvalue()


def _depth(metres: Array, wish: Wish) -> tuple[Pixels, str]:
    """Return the picture of depths, coloured from near to far, and a note with the range. Invalid depths are black."""
    valid = np.isfinite(metres) & (metres > 0)
    picture, low, high = _coloured(metres, valid, wish)
    return picture, f"{low:.2f} to {high:.2f} m" if valid.any() else "no valid depth"


def _coloured(values: Array, valid: Array, wish: Wish) -> tuple[Pixels, float, float]:
    """Return the picture of values in colours, with the lowest and highest value that have one. Others are black."""
    if not valid.any():
        return _pixels(np.zeros((*values.shape, 3), np.uint8), wish), 0.0, 0.0
    low, high = np.percentile(values[valid], (_LOW, _HIGH))
    part = np.clip((np.where(valid, values, low) - low) / max(high - low, 1e-6), 0, 1) * (len(_RAMP) - 1)
    below = np.minimum(part.astype(int), len(_RAMP) - 2)
    rest = (part - below)[:, :, None]
    rgb = _RAMP[below] * (1 - rest) + _RAMP[below + 1] * rest
    return _pixels(rgb * valid[:, :, None], wish), float(low), float(high)


def _yuv(rows: Array, encoding: str, wish: Wish) -> Array:
    """Return red, green and blue of YUV 4:2:2."""
    height, width = rows.shape[0], rows.shape[1] // 2
    pairs = rows[:, : width // 2 * 4].reshape(height, width // 2, 4)
    if not pairs.size:
        raise UndrawableError(ImageProblem.NO_SIZE(width=width, height=height))
    bright, colour = YUV[encoding]
    y = np.repeat(pairs[:, :, bright : bright + 1], 2, axis=1)
    y[:, 1::2, 0] = pairs[:, :, bright + 2]
    u, v = (np.repeat(pairs[:, :, at : at + 1], 2, axis=1) for at in (colour, colour + 2))
    return _rgb(_reduced(np.concatenate([y, u, v], axis=2), wish))


def _planes(data: Array, bright: Array, step: int, encoding: str, wish: Wish) -> Array:
    """Return red, green and blue of an image whose colours follow the brightness of its pixels."""
    shared, blue = PLANES[encoding]
    height, width = (length // shared * shared for length in bright.shape)
    if not height or not width:
        raise UndrawableError(ImageProblem.NO_SIZE(width=bright.shape[1], height=bright.shape[0]))
    begin, row_step = step * bright.shape[0], 2 * step // shared
    needed = begin + row_step * (height // shared - 1) + 2 * width // shared
    if len(data) < needed:
        size = {"width": bright.shape[1], "height": bright.shape[0]}
        raise UndrawableError(ImageProblem.TOO_SHORT(got=len(data), encoding=encoding, needed=needed, **size))
    colours = _rows(data[begin:], width // shared, height // shared, row_step, 2, encoding)
    pairs = colours.reshape(height // shared, width // shared, 2)
    if shared > 1:
        pairs = pairs.repeat(shared, axis=0).repeat(shared, axis=1)
    y = bright[:height, :width, None]
    return _rgb(_reduced(np.concatenate([y, pairs[:, :, blue, None], pairs[:, :, 1 - blue, None]], axis=2), wish))


def _rgb(yuv: Array) -> Array:
    """Return red, green and blue (ITU-R BT.601)."""
    values = yuv.astype(np.float32)
    y, u, v = values[:, :, 0] - 16, values[:, :, 1] - 128, values[:, :, 2] - 128
    rgb = np.stack([1.164 * y + 1.596 * v, 1.164 * y - 0.392 * u - 0.813 * v, 1.164 * y + 2.017 * u], axis=2)
    return rgb.clip(0, 255)


def _bayer(values: Array, row: int, column: int, wish: Wish) -> Array:
    """Return red, green and blue of a Bayer pattern with red at this row and column, in half of its resolution."""
    height, width = values.shape[0] // 2 * 2, values.shape[1] // 2 * 2
    if not height or not width:
        raise UndrawableError(ImageProblem.NO_SIZE(width=values.shape[1], height=values.shape[0]))
    red = values[row:height:2, column:width:2]
    blue = values[1 - row : height : 2, 1 - column : width : 2]
    green = values[row:height:2, 1 - column : width : 2]
    return _reduced(np.stack([red, green, blue], axis=2), wish)


def _compressed(message: Message, wish: Wish) -> tuple[Pixels, str]:
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 -- uncompressed images do without

    content, _ = raw(message, "data")
    data, words = bytes(content), text(message, "format")
    if "compressedDepth" in words:
        data = data[_DEPTH_HEADER:]
    kind = next((name for start, name in _FORMATS.items() if data.startswith(start)), "")
    named = next((each for each in _NAMED if each in words.lower()), "")
    if not kind and named:
        raise UndrawableError(ImageProblem.OTHER(format=named, length=len(data)))
    if not kind:
        raise UndrawableError(ImageProblem.FORMAT(format=words))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            # By one of three decoders only: Pillow has dozens, which any bytes could choose from.
            image = Image.open(io.BytesIO(data), formats=[kind])
        # Only the header was read so far, so that a bomb is refused before it takes memory.
        _check_size(*image.size)
        size = "×".join(map(str, image.size))
        encoding, _, _ = words.partition(";")
        note = f"{size} {kind.lower()} {'' if encoding.lower() in _NAMED else encoding}".strip()
        if image.mode.startswith("I") or image.mode == "F":
            depth = np.asarray(image).astype(np.float32) * 1e-3
            picture, span = _depth(_reduced(depth[:, :, None], wish)[:, :, 0], wish)
            return picture, f"{note}, {span}"
        # A part that is zoomed needs all pixels.
        if wish.zoom <= 1:
            across = _SAMPLES * wish.width * wish.across
            image.draft("RGB", (across, 2 * _SAMPLES * wish.height * wish.down))  # JPEG: decodes less
        pixels = np.asarray(image.convert("RGB"))
    except UnidentifiedImageError:  # its text names an object of Python
        raise UndrawableError(ImageProblem.BROKEN(error="it has no header")) from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        # Pillow raises each of them for a damaged file.
        raise UndrawableError(ImageProblem.BROKEN(error=error)) from None
    return _pixels(_reduced(pixels, wish), wish), note
