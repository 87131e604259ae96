"""Helpers of `test_pictures_on_screen` and others."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from tests.console.scripted import route

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
