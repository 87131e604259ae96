"""Images in the terminal's pixels on the screen: where they are drawn, what covers them, and when they go."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from tests.console.driving import WIDE, on_main, shown, until

from rsb_console.app import ConsoleApp
from rsb_extras.pictures.graphics import BANDS
from rsb_extras.pictures.picture import Pixels
from rsb_extras.pictures.tests.looking_engine import LookingEngine
from rsb_extras.pictures.tests.test_view_screen import comes, drawn, opened, screen_of, viewed

if TYPE_CHECKING:
    from textual.pilot import Pilot

_PLACED = re.compile(r"\x1b\[(\d+);(\d+)H\x1b_Ga=T,f=100,i=(\d+),p=1,c=(\d+),r=(\d+)")
_FREED = re.compile(r"\x1b_Ga=d,d=I,i=(\d+),q=2")
CELL = (10.0, 20.0)


class Written:
    """The sequences that an app has written beside Textual's."""

    def __init__(self) -> None:
        self.text = ""

    def shown(self) -> dict[str, tuple[int, int, int, int]]:
        """Return row, column, width and height of each image that is not taken away, by its number."""
        found: dict[str, tuple[int, int, int, int]] = {}
        for event in re.finditer(f"{_PLACED.pattern}|{_FREED.pattern}", self.text):
            if event[3] is not None:
                row, column, width, height = (int(event[each]) for each in (1, 2, 4, 5))
                found[event[3]] = row, column, width, height
            else:
                found.pop(event[6], None)
        return found


def noise(width: int, height: int, seed: int = 1) -> Pixels:
    return Pixels(width, height, np.random.default_rng(seed).integers(0, 256, 3 * width * height, np.uint8).tobytes())


async def in_kitty(pilot: Pilot[None]) -> Written:
    """Let the terminal be kitty, and open a picture."""
    app: Any = pilot.app
    assert isinstance(app, ConsoleApp)
    app.facts = replace(app.facts, pixels="kitty", cell=CELL)
    written = Written()

    def write(sequence: str) -> None:
        written.text += sequence

    vars(app)["write_to_terminal"] = write
    await opened(pilot)
    return written


def bands(app: ConsoleApp) -> int:
    """Return how many bands an image of the pane's height has."""
    height = screen_of(app).pane.size.height
    return math.ceil(height / math.ceil(height / BANDS))


on_list = on_main(WIDE, landmark="/robot2/scan", make_engine=LookingEngine)


@on_list
async def test_image_is_asked_for_in_pixels_of_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await in_kitty(pilot)
    wish = await comes(pilot, viewed(noise(320, 240)))
    assert (wish.across, wish.down, wish.shape) == (10, 20, 2.0)
    assert (wish.width, wish.height) == screen_of(app).pane.size


@on_list
async def test_image_fills_its_pane_and_no_more(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_kitty(pilot)
    await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    content = screen_of(app).pane.content_region
    places = sorted(written.shown().values())
    assert (places[0][0], places[0][1]) == (content.y + 1, content.x + 1)
    assert sum(height for *_, height in places) == content.height
    assert {width for _, _, width, _ in places} == {-(-content.height * 20 * 320 // (240 * 10))}
    assert not any(row.strip() for row in drawn(app))


@on_list
async def test_rows_below_a_question_are_characters(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_kitty(pilot)
    await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    app.notify("a message", timeout=600)
    await shown(pilot, "a message")
    await until(pilot, lambda: 0 < len(written.shown()) < bands(app), "some of the image")
    await until(pilot, lambda: any(row.strip() for row in drawn(app)), "the rest in characters")
    app.clear_notifications()
    await until(pilot, lambda: len(written.shown()) == bands(app), "the whole image again")


@on_list
async def test_image_goes_with_its_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_kitty(pilot)
    await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    await pilot.press("question_mark")  # a screen that hides all
    await shown(pilot, "Help: every key")
    await until(pilot, lambda: not written.shown(), "no image over the help")
    await pilot.press("escape")
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image again")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main and not written.shown(), "no image over the list")


@on_list
async def test_still_image_is_written_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_kitty(pilot)
    for _ in range(3):
        await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    assert len(_PLACED.findall(written.text)) == bands(app)
    await comes(pilot, viewed(noise(320, 240, seed=2)))
    await until(pilot, lambda: len(_PLACED.findall(written.text)) == 2 * bands(app), "another image")
    assert len(written.shown()) == bands(app)
