"""Helpers of `test_view_screen` and others."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from tests.console.driving import (
    engine_as,
    on_main,
    selected_topic,
    shown,
    until,
)

from rsb_console.app import ConsoleApp
from rsb_extras.pictures.picture import (
    Cells,
    Picture,
    Viewed,
    Wish,
)
from rsb_extras.pictures.tests.looking_engine import LookingEngine

if TYPE_CHECKING:
    from textual.pilot import Pilot

SCAN = "/robot2/scan"


CHARACTERS = Cells(("the picture",), bytes((1,) * 11), ("", "robot"))


def viewed(content: Any = CHARACTERS, *, age: float | None = 0.5, **about: Any) -> Viewed:
    usual: dict[str, Any] = {"messages": 3, "type_name": "sensor_msgs/msg/LaserScan", "notes": ("360 points",)}
    return Viewed(Picture(content, **(usual | about)), "robot1", age, 1234)


def engine_of(app: ConsoleApp) -> LookingEngine:
    return engine_as(app, LookingEngine)


def looks(engine: LookingEngine) -> list[tuple[Any, ...]]:
    """Return the questions for pictures: topics, wish and link each."""
    return [command[1:] for command in engine.commands if command[0] == "look"]


async def comes(pilot: Pilot[None], answer: Viewed | Exception | None = None) -> Wish:
    """Answer the screen's question once it asks, and return the wish of its next question."""
    assert isinstance(pilot.app, ConsoleApp)
    engine = engine_of(pilot.app)
    await until(pilot, lambda: not engine.viewing.done(), "a question for a picture")
    asked = engine.viewing
    if isinstance(answer, Exception):
        asked.set_exception(answer)
    else:
        asked.set_result(answer)
    await until(pilot, lambda: engine.viewing is not asked, "the next question")
    wish = looks(engine)[-1][1]
    assert isinstance(wish, Wish)
    return wish


async def opened(pilot: Pilot[None]) -> None:
    app = pilot.app
    assert isinstance(app, ConsoleApp)
    await shown(pilot, SCAN)
    await until(pilot, lambda: selected_topic(app) == SCAN, "the topic under the cursor")
    await pilot.press("v")
    await until(pilot, lambda: looks(engine_of(app)), "a question for a picture")


on_list = functools.partial(on_main, make_engine=LookingEngine)


looking = functools.partial(on_list, landmark=SCAN, opening=opened)
"""A test's steps run once the screen has asked for the first picture."""
