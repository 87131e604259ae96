"""A camera that repeats its last picture is as old as that."""

from __future__ import annotations

from builtin_interfaces.msg import Time  # type: ignore[import-untyped]
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.tests.samples import task
from rsb_extras.pictures.worker import Artist

_S = 10**9


def image(at: int, grey: int) -> Image:
    """Return an image with a stamp (s)."""
    header = Header(stamp=Time(sec=at), frame_id="camera")
    return Image(header=header, width=4, height=2, encoding="mono8", step=4, data=bytes((grey,)) * 8)


def times(*images: Image) -> tuple[float, float]:
    """Return when the newest image came that counts, and when its content came first: s since the first image."""
    artist = Artist()
    for number, each in enumerate(images):
        picture = artist.do(task(Wish(), each, at=1000.0 + number))
    assert picture is not None
    assert not picture.problem
    return picture.taken / _S - 1000, picture.changed / _S - 1000


def test_new_content_is_new() -> None:
    assert times(image(1, 10), image(2, 11), image(3, 12)) == (2, 2)
    assert times(image(0, 10), image(0, 11)) == (1, 1)


def test_repeated_message_is_as_old_as_its_first() -> None:
    assert times(image(1, 10), image(1, 10), image(1, 10)) == (0, 0)


def test_equal_picture_of_new_stamp_is_young_and_still() -> None:
    assert times(image(1, 10), image(2, 10), image(3, 10)) == (2, 0)


def test_picture_without_stamp_is_young_and_still() -> None:
    assert times(image(0, 10), image(0, 10)) == (1, 0)
