"""Scans and clouds in braille."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from tests.support.wording import has_text

from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.points import PointsProblem
from rsb_extras.pictures.tests.samples import cells_of, drawn, task
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=41, height=21)


def scan(ranges: list[float], **more: float) -> LaserScan:
    step = 2 * math.pi / max(1, len(ranges))
    return LaserScan(angle_min=0.0, angle_increment=step, range_min=0.1, range_max=30.0, ranges=ranges, **more)


def cloud(points: Sequence[tuple[float, ...]], names: str = "xyz", **changes: int) -> PointCloud2:
    array = np.array(points, "<f4").reshape(-1, len(names))
    fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate(names)]
    about = {"width": len(array), "height": 1, "point_step": 4 * len(names), "row_step": array.nbytes, **changes}
    return PointCloud2(fields=fields, data=list(array.tobytes()), is_dense=True, **about)


def marked(picture: Picture) -> list[tuple[int, int]]:
    """Return columns and rows with points, which alone have colours."""
    content, found, at = cells_of(picture), [], 0
    for row, text in enumerate(content.rows):
        for column in range(len(text)):
            if content.palette[content.styles[at]].startswith("#"):
                found.append((column, row))
            at += 1
    return found


def test_ahead_is_up_and_left_is_left() -> None:
    ahead = marked(drawn(WISH, scan([5.0, math.inf, math.inf, math.inf])))
    left = marked(drawn(WISH, scan([math.inf, 5.0, math.inf, math.inf])))
    assert all(row < 10 and abs(column - 20) <= 1 for column, row in ahead)
    assert all(column < 20 and abs(row - 10) <= 1 for column, row in left)
    assert ahead
    assert left


def test_invalid_ranges_are_left_out() -> None:
    picture = drawn(WISH, scan([math.nan, -1.0, 0.0, 99.0]))
    assert has_text(picture.problem, PointsProblem.NO_POINTS)


def test_heights_have_colours() -> None:
    points = [(math.cos(a), math.sin(a), a) for a in np.linspace(0, 6, 100)]
    content = cells_of(drawn(WISH, cloud(points)))
    assert sum(colour.startswith("#") for colour in content.palette) > 5


def test_a_tilted_cloud_shows_heights_as_heights() -> None:
    picture = drawn(Wish(width=41, height=21, tilt=90), cloud([(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]))
    assert min(marked(picture), key=lambda at: at[1])[0] == 20


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (cloud([(1, 2, 3)], "abc"), PointsProblem.NO_FIELD),
        (cloud([(1, 2, 3)], width=1000), PointsProblem.TOO_SHORT),
        (cloud([(1, 2, 3)], point_step=4), PointsProblem.BAD_STEP),
        (cloud([(math.nan, 2, 3)]), PointsProblem.NO_POINTS),
        (cloud([]), PointsProblem.NO_POINTS),
    ],
)
def test_clouds_that_cannot_be_drawn(message: PointCloud2, problem: PointsProblem) -> None:
    assert has_text(drawn(WISH, message).problem, problem)


def test_rows_with_padding() -> None:
    rows = b"".join(np.array([x, y, 0], "<f4").tobytes() + b"\xff" * 4 for x, y in ((1, 1), (-1, -1)))
    message = cloud([(0, 0, 0)])
    message.width, message.height, message.row_step, message.data = 1, 2, 16, list(rows)
    assert len(marked(drawn(WISH, message))) == 2


@pytest.mark.parametrize("row_step", [0, 12, 1000])
def test_rows_with_a_wrong_step_follow_each_other(row_step: int) -> None:
    """A cloud's row_step is often that of a point, or of the cloud before it was cropped; RViz does not read it."""
    points = [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0)]
    right = drawn(WISH, cloud(points, width=2, height=2, row_step=24))
    assert len(marked(right)) == 4
    assert marked(drawn(WISH, cloud(points, width=2, height=2, row_step=row_step))) == marked(right)


def test_age_is_of_points_that_are_drawn() -> None:
    artist = Artist()
    good, bad = task(WISH, cloud([(1.0, 0.0, 0.0)]), at=1000.0), task(WISH, cloud([], "xy"), at=1001.0)
    first, second = artist.do(good), artist.do(bad)
    assert first is not None
    assert second is not None
    assert has_text(second.problem, PointsProblem.NO_FIELD)
    assert marked(second) == marked(first)
    assert second.taken == first.taken == 1000 * 10**9
