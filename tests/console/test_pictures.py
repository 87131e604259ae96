"""Exact pictures, each proven to show the console and not a crash before it is compared."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from tests.console.driving import NARROW, WIDE, Steps, scripted_app, settled, shown
from tests.console.scripted import ScriptedEngine, route
from textual.pilot import Pilot
from textual.widgets import Input

from rsb_bridge.model.pictures import Cells, Curve, Picture, Pixels, Series, Viewed

SnapCompare = Callable[..., bool]
THEMES = ("dark", "light", "high-contrast", "terminal")


def after(landmark: str, *keys: str) -> Steps:
    """Press `keys` once the topics are there, then require `landmark`."""

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await shown(pilot, "q quit")
        await pilot.press(*keys)
        await shown(pilot, landmark)
        for field in pilot.app.screen.query(Input):
            field.cursor_blink = False
        await settled(pilot)

    return steps


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_main(snap_compare: SnapCompare, theme: str, size: tuple[int, int]) -> None:
    assert snap_compare(scripted_app(theme=theme), terminal_size=size, run_before=after("● ok       /tf"))


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_ascii(snap_compare: SnapCompare, size: tuple[int, int]) -> None:
    app = scripted_app(theme="terminal", ascii_only=True)
    assert snap_compare(app, terminal_size=size, run_before=after("o ok       /tf"))


def test_detail_on_a_narrow_screen(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("99.7 %", "G", "enter"))


def test_quit_dialog(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("Quit?", "q"))


def test_filter(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("3 of 8", "slash", *"robot1"))


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
LOOKED_AT: dict[str, tuple[str, Cells | Pixels | Series, tuple[str, ...]]] = {
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


class LookedAtEngine(ScriptedEngine):
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
