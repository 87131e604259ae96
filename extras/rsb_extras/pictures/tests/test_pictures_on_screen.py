"""Exact pictures of the screen that shows messages as pictures."""

import math
from dataclasses import replace
from typing import Any

import pytest
from tests.console.driving import NARROW, scripted_app
from tests.console.scripted import route
from tests.console.test_pictures import SnapCompare, after

from rsb_extras.pictures.picture import Cells, Curve, Picture, Pixels, Series, Viewed
from rsb_extras.pictures.tests.looking_engine import LookingEngine

WAVE = tuple(math.sin(column / 9) for column in range(140))
MAP = (
    ("██████████", "oooooooooo"),
    ("█        █", "offffffffo"),
    ("█ ⠤⠤⠤▶   █", "ofppprfffo"),
    ("█   ⠒⠒⠒ ◆█", "offfsss·go"),
    ("██████████", "oooooooooo"),
    ("├────┤ 5 m", "aaaaaaaaaa"),
)
"""Characters, and the first letters of their styles."""
LOOKED_AT: dict[str, tuple[str, Pixels | Cells | Series, tuple[str, ...]]] = {
    "image": (
        "sensor_msgs/msg/Image",
        Pixels(48, 40, bytes(part for y in range(40) for x in range(48) for part in (5 * x, 6 * y, 255 - 5 * x))),
        ("1920×1080 rgb8",),
    ),
    "map": (
        "nav_msgs/msg/OccupancyGrid",
        Cells(
            tuple(row for row, _ in MAP),
            bytes("·ofrpsga".index(letter) for _, row in MAP for letter in row),
            ("", "occupied", "free", "robot", "path", "scan", "goal", "axis"),
        ),
        ("map", "0.05 m a cell"),
    ),
    "plot": (
        "nav_msgs/msg/Odometry",
        Series(0.0, 0.2, (Curve("twist.twist.linear.x", WAVE, tuple(each + 0.1 for each in WAVE), 0.4, 0.1),)),
        ("30 s",),
    ),
}  # fmt: skip


class LookedAtEngine(LookingEngine):
    """Has a picture of its first topic, which is of one type."""

    shows = "image"

    def __init__(self, *session: Any) -> None:
        super().__init__(*session)
        type_name, content, notes = LOOKED_AT[self.shows]
        self.now = replace(self.now, routes=(route("/robot2/scan", type_name=type_name), route("/scan")))
        picture = Picture(content, messages=12, type_name=type_name, notes=notes)
        self.viewed.append(Viewed(picture, "robot1", None, 4321))


@pytest.mark.parametrize("shows", LOOKED_AT)
def test_view(snap_compare: SnapCompare, shows: str) -> None:
    engine = type("Engine", (LookedAtEngine,), {"shows": shows})
    run_before = after(LOOKED_AT[shows][2][0], "v")
    assert snap_compare(scripted_app(make_engine=engine), terminal_size=NARROW, run_before=run_before)
