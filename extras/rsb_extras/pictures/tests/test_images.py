"""Images of all usual encodings, and damaged ones."""

from __future__ import annotations

import io
from array import array

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image as Pillow
from sensor_msgs.msg import CompressedImage, Image
from tests.support import surroundings
from tests.support.wording import has_text

from rsb_extras.pictures.images import BAYER, DEPTHS, ENCODINGS, NUMBERS, PLANES, YUV, ImageProblem
from rsb_extras.pictures.picture import LONGEST_SIDE, Picture, Pixels, Wish, in_full
from rsb_extras.pictures.picture_rows import rgb_of
from rsb_extras.pictures.tests.samples import drawn

WISH = Wish(width=8, height=4)
RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)


def image(encoding: str, data: bytes, width: int = 8, height: int = 8, step: int = 0, **more: int) -> Image:
    return Image(encoding=encoding, width=width, height=height, step=step, data=list(data), **more)


def pixels(picture: Picture) -> np.ndarray:
    assert isinstance(picture.content, Pixels), picture.problem
    return np.frombuffer(picture.content.data, np.uint8).reshape(picture.content.height, picture.content.width, 3)


@pytest.mark.parametrize(
    ("encoding", "pixel", "expected"),
    [("rgb8", b"\xff\0\0", RED), ("bgr8", b"\0\0\xff", RED), ("rgba8", b"\xff\0\0\t", RED),
     ("bgra8", b"\0\0\xff\t", RED), ("8UC3", b"\0\0\xff", RED), ("8UC4", b"\0\0\xff\t", RED),
     ("mono8", b"\x80", 128), ("8UC1", b"\x80", 128), ("mono16", b"\x00\x80", 128),
     ("rgb16", b"\1\xff\1\0\1\0", RED), ("bgr16", b"\1\0\1\0\1\xff", RED),
     ("rgba16", b"\1\xff\1\0\1\0\1\t", RED), ("bgra16", b"\1\0\1\0\1\xff\1\t", RED),
     ("16UC3", b"\1\0\1\0\1\xff", RED), ("16UC4", b"\1\0\1\0\1\xff\1\t", RED)],
)  # fmt: skip
def test_colours_and_greys(encoding: str, pixel: bytes, expected: int | tuple[int, ...]) -> None:
    assert (pixels(drawn(WISH, image(encoding, pixel * 64))) == expected).all()


def test_big_endian() -> None:
    assert (pixels(drawn(WISH, image("mono16", b"\x80\x00" * 64, is_bigendian=1))) == 128).all()
    assert (pixels(drawn(WISH, image("rgb16", b"\xff\1\0\1\0\1" * 64, is_bigendian=1))) == RED).all()


@pytest.mark.parametrize("encoding", sorted(YUV))
def test_yuv(encoding: str) -> None:
    bright, colour = YUV[encoding]
    pair = bytearray(4)
    pair[bright] = pair[bright + 2] = 81
    pair[colour], pair[colour + 2] = 90, 240
    assert np.abs(pixels(drawn(WISH, image(encoding, bytes(pair) * 32))).astype(int) - RED).max() <= 3


@pytest.mark.parametrize("step", [0, 11])
@pytest.mark.parametrize(("encoding", "colours"), [("nv12", (90, 240)), ("nv21", (240, 90)), ("nv24", (90, 240))])
def test_colours_after_the_brightness(encoding: str, colours: tuple[int, int], step: int) -> None:
    """The right half is green, so that a colour of a wrong pixel would show."""
    green = tuple(reversed((54, 34))) if encoding == "nv21" else (54, 34)
    across = 8 if encoding == "nv24" else 4
    padding = bytes(max(0, step - 8))
    bright = (bytes([81] * 4 + [145] * 4) + padding) * 8
    row = bytes(colours * (across // 2) + green * (across // 2)) + padding * (2 if encoding == "nv24" else 1)
    data = bright + row * across
    found = pixels(drawn(WISH, image(encoding, data, step=step))).astype(int)
    assert np.abs(found[:, :4] - RED).max() <= 3
    assert np.abs(found[:, 4:] - GREEN).max() <= 3


def test_colours_that_are_missing_after_the_brightness() -> None:
    picture = drawn(WISH, image("nv12", bytes(64)))
    assert has_text(picture.problem, ImageProblem.TOO_SHORT)
    assert "96" in picture.problem


@pytest.mark.parametrize("encoding", sorted(BAYER))
def test_bayer(encoding: str) -> None:
    size, row, column = BAYER[encoding]
    data = np.zeros((16, 16), f"<u{size}")
    data[row::2, column::2] = 256**size - 1
    assert (pixels(drawn(WISH, image(encoding, data.tobytes(), 16, 16))) == RED).all()


@pytest.mark.parametrize("encoding", sorted(NUMBERS))
def test_numbers_have_colours_from_least_to_most(encoding: str) -> None:
    values = np.full((8, 8), -100, NUMBERS[encoding])
    values[:, 4:] = 100
    drawing = drawn(WISH, image(encoding, values.tobytes()))
    picture = pixels(drawing)
    assert (picture[0, 0].tolist(), picture[0, 7].tolist()) == ([48, 18, 59], [122, 4, 3])
    assert "-100 to 100" in drawing.notes


@pytest.mark.parametrize("encoding", sorted(DEPTHS))
def test_near_and_far_differ_invalid_is_black(encoding: str) -> None:
    dtype, unit = DEPTHS[encoding]
    metres = np.full((8, 8), 1.0)
    metres[:, 4:] = 5.0
    metres[:2] = 0.0
    picture = pixels(drawn(WISH, image(encoding, (metres / unit).astype(dtype).tobytes())))
    assert (picture[:2] == 0).all()
    assert (picture[4, 0] != picture[4, 7]).any()


def test_webp_for_a_viewer_that_reads_it() -> None:
    wish = msgspec.structs.replace(WISH, width=80, height=24, webp=True)
    content = drawn(wish, image("rgb8", bytes(BLUE) * 96 * 96, 96, 96)).content
    assert isinstance(content, Pixels)
    assert content.coding == "webp-doubled"
    read = np.frombuffer(rgb_of(content), np.uint8).reshape(content.height, content.width, 3)
    assert np.abs(read.astype(int) - BLUE).max() <= 6


def test_padding_at_ends_of_rows_is_left_out() -> None:
    row = bytes(GREEN) * 8 + b"\xff" * 5
    assert (pixels(drawn(WISH, image("rgb8", row * 8, step=29))) == GREEN).all()


def test_proportions_are_kept() -> None:
    picture = pixels(drawn(Wish(width=80, height=24), image("mono8", bytes(200 * 100), 200, 100)))
    assert picture.shape[:2] == (40, 80)
    picture = pixels(drawn(Wish(width=80, height=24), image("mono8", bytes(100 * 200), 100, 200)))
    assert picture.shape[:2] == (48, 24)


def test_zoom_and_shift_show_a_part() -> None:
    data = np.zeros((64, 64, 3), np.uint8)
    data[:32, 32:] = BLUE
    message = image("rgb8", data.tobytes(), 64, 64)
    assert (pixels(drawn(Wish(width=8, height=4, zoom=4.0, x=1.5, y=1.5), message)) == BLUE).all()


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
def test_compressed_images(kind: str) -> None:
    file = io.BytesIO()
    Pillow.new("RGB", (64, 48), BLUE).save(file, kind)
    message = CompressedImage(format=f"rgb8; {kind} compressed bgr8", data=list(file.getvalue()))
    picture = drawn(WISH, message)
    assert np.abs(pixels(picture).astype(int) - BLUE).max() <= 3
    assert picture.notes == (f"64×48 {kind} rgb8",)
    message.format = kind
    assert drawn(WISH, message).notes == (f"64×48 {kind}",)


def test_compressed_depth() -> None:
    file = io.BytesIO()
    metres = np.full((48, 64), 1000, np.uint16)
    metres[:, 32:] = 4000
    Pillow.fromarray(metres).save(file, "png")
    message = CompressedImage(format="16UC1; compressedDepth png", data=list(bytes(12) + file.getvalue()))
    picture = pixels(drawn(WISH, message))
    assert (picture[0, 0] != picture[0, -1]).any()


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (image("rgb8", b"", 0, 0), ImageProblem.NO_SIZE),
        (image("rgb8", b"", 65535, 65535), ImageProblem.TOO_LARGE),
        (image("rgb8", b"123"), ImageProblem.TOO_SHORT),
        (image("rgb8", bytes(192), step=3), ImageProblem.STEP),
        (image("nv99", bytes(192)), ImageProblem.ENCODING),
        (image("yuv422", b"12", 1, 1), ImageProblem.NO_SIZE),
        (image("bayer_rggb8", b"1", 1, 1), ImageProblem.NO_SIZE),
        (CompressedImage(format="theora", data=list(b"OggS")), ImageProblem.FORMAT),
        (CompressedImage(format="jpeg", data=list(b"\xff\xd8\xff\xe0rubbish")), ImageProblem.BROKEN),
        (CompressedImage(format="jpeg", data=list(b"\0\0rubbish")), ImageProblem.OTHER),
        (CompressedImage(format="bgr8; PNG compressed", data=[]), ImageProblem.OTHER),
    ],
)
def test_images_that_cannot_be_drawn(message: Image | CompressedImage, problem: ImageProblem) -> None:
    picture = drawn(WISH, message)
    assert picture.content is None
    assert has_text(picture.problem, problem)
    assert "object at" not in picture.problem


def test_a_decompression_bomb_is_refused() -> None:
    file = io.BytesIO()
    Pillow.new("1", (20_000, 20_000)).save(file, "png")
    picture = drawn(WISH, CompressedImage(format="png", data=list(file.getvalue())))
    assert picture.content is None
    assert has_text(picture.problem, ImageProblem.TOO_LARGE) or has_text(picture.problem, ImageProblem.BROKEN)


SIZES = st.integers(0, 20) | st.sampled_from([65535, 2**32 - 1])


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    st.sampled_from([*ENCODINGS, *DEPTHS, *NUMBERS, *YUV, *PLANES, *BAYER, "?"]), st.binary(max_size=600),
    SIZES, SIZES, st.integers(0, 50) | st.just(2**32 - 1), st.integers(0, 255),
)  # fmt: skip
def test_any_image_is_drawn_or_refused_in_words(
    encoding: str, data: bytes, width: int, height: int, step: int, order: int
) -> None:
    picture = drawn(WISH, image(encoding, data, width, height, step, is_bigendian=order))
    assert (picture.content is None) == bool(picture.problem)
    assert "Error" not in picture.problem


def _sizes(width: int, height: int, wish: Wish = WISH, /, **changes: object) -> tuple[int, int]:
    wanted = msgspec.structs.replace(wish, **changes)
    content = drawn(wanted, image("rgb8", bytes(3 * width * height), width, height)).content
    assert isinstance(content, Pixels)
    return content.width, content.height


def test_terminals_that_show_pixels_get_more_of_them() -> None:
    """As many as the image has at most: they enlarge it themselves."""
    assert _sizes(640, 480, webp=True) == (8, 6)
    assert _sizes(640, 480, webp=True, across=6, down=12) == (48, 36)
    assert _sizes(64, 48, webp=True, across=16, down=32) == (64, 48)


@pytest.mark.parametrize("shape", [1.5, 2.0, 2.375, 3.0])
def test_proportions_are_those_of_terminal_cells(shape: float) -> None:
    area = Wish(160, 60, webp=True)
    for across, down in ((1, 2), (2, 4), (2, 6), (8, 19)):
        width, height = _sizes(1920, 1080, area, across=across, down=down, shape=shape)
        on_screen = (width / across) / (height / down * shape)
        assert on_screen == pytest.approx(16 / 9, rel=0.04)


@pytest.mark.parametrize("shape", [1.5, 1.878, 2.0, 15 / 7, 3.0])
def test_an_image_in_full_has_its_own_resolution(shape: float) -> None:
    """Noise, too, which takes most bytes, and whatever the shape of the terminal's cells."""
    wish = in_full(msgspec.structs.replace(WISH, webp=True, shape=shape))
    for width, height, expected in ((640, 480, (640, 480)), (1920, 1440, (1920, 1440)), (2400, 1800, (1920, 1440))):
        noise = np.random.default_rng(1).integers(0, 256, 3 * width * height, np.uint8).tobytes()
        content = drawn(wish, Image(encoding="rgb8", width=width, height=height, data=array("B", noise))).content
        assert isinstance(content, Pixels)
        assert (content.width, content.height) == expected
    assert LONGEST_SIDE == 1920


@pytest.mark.parametrize("webp", [False, True])
@pytest.mark.parametrize("cell", [(1, 2), (2, 6), (4, 8), (7, 15)])
def test_picture_tells_the_shape_of_its_pixels(cell: tuple[int, int], webp: bool) -> None:
    wish = Wish(100, 100, webp=webp, across=cell[0], down=cell[1], shape=15 / 7)
    content = drawn(wish, image("rgb8", bytes(3 * 640 * 480), 640, 480)).content
    assert isinstance(content, Pixels)
    assert content.width / (content.height * content.shape) == pytest.approx(4 / 3, rel=0.02)


def test_detail_needs_webp(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _sizes(640, 480, across=6, down=12) == (8, 6)
    surroundings.hide_modules(monkeypatch, "PIL")
    assert _sizes(640, 480, webp=True, across=6, down=12) == (8, 6)
