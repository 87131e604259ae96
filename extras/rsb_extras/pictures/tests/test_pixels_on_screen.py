"""Images in the terminal's pixels on the screen: where they are drawn, what covers them, and when they go."""

from __future__ import annotations

import math
import re
import threading
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from sensor_msgs.msg import Image
from tests.console.driving import WIDE, on_main, put, shown, until
from tests.console.scripted import route
from tests.support import replaced
from textual.geometry import Offset, Region
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_bridge.model.snapshot import ArmingSnapshot
from rsb_console.app import ConsoleApp
from rsb_console.terminal.terminal_line import FRAME, TerminalLine
from rsb_extras.driving.drive_screen import DriveScreen
from rsb_extras.pictures.graphics import BANDS
from rsb_extras.pictures.picture import Cells, Curve, Pixels, Scale, Series
from rsb_extras.pictures.tests import picture_places, samples
from rsb_extras.pictures.tests.looking_engine import LookingEngine
from rsb_extras.pictures.tests.view_screen_helpers import comes, engine_of, looks, opened, viewed
from rsb_extras.pictures.view_screen import ViewScreen

if TYPE_CHECKING:
    from textual.app import ComposeResult
    from textual.pilot import Pilot

    from rsb_extras.pictures.picture import Wish
    from rsb_extras.pictures.tile import Tile

_PLACED = re.compile(r"\x1b\[(\d+);(\d+)H\x1b_Ga=T,f=100,i=(\d+),p=1,c=(\d+),r=(\d+)")
_SIXELS = re.compile(r"\x1b\[(\d+);(\d+)H\x1bP")
_FREED = re.compile(r"\x1b_Ga=d,d=I,i=(\d+),q=2")
CELL = (10.0, 20.0)


class Written:
    """The sequences that an app has written beside Textual's."""

    def __init__(self) -> None:
        self.text = ""

    def tops(self, after: int = 0) -> set[int]:
        """Return the first rows of all bands that were written after so many characters."""
        return {int(found[1]) - 1 for way in (_PLACED, _SIXELS) for found in way.finditer(self.text, after)}

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


def halves(width: int, height: int, bright: int) -> Pixels:
    """Return an image whose left half is black."""
    return Pixels(width, height, (bytes(3 * (width // 2)) + bytes([bright]) * (3 * (width - width // 2))) * height)


async def in_pixels(
    pilot: Pilot[None], protocol: str = "kitty", cell: tuple[float, float] = CELL, name: str = ""
) -> Written:
    """Let the terminal show pixels, and open a picture."""
    app: Any = pilot.app
    assert isinstance(app, ConsoleApp)
    app.facts = replace(app.facts, pixels=protocol, cell=cell, name=name)  # type: ignore[arg-type]
    written = Written()

    def write(sequence: str) -> None:
        written.text += sequence

    vars(app)["write_to_terminal"] = write
    await opened(pilot)
    return written


def pane_of(app: ConsoleApp) -> Tile:
    return next(each for each in app.screen_stack if isinstance(each, ViewScreen)).pane


def drawn(app: ConsoleApp) -> list[str]:
    """Return the rows of the picture in characters."""
    pane = pane_of(app)
    return [pane.render_line(row).text for row in range(pane.size.height)]


def edges(app: ConsoleApp) -> dict[int, tuple[int, int]]:
    """Return of each row in characters the column from which on an image of two halves is white, and its width."""
    found, pane = {}, pane_of(app)
    for row in range(pane.size.height):
        strip = pane.render_line(row)
        cells = [part.style.bgcolor for part in strip if part.style is not None for _ in part.text]
        changes = [at for at, (before, after) in enumerate(pairwise(cells), 1) if before != after]
        if len(changes) > 1:
            found[row] = changes[0], changes[-1]
    return found


def image_region(app: ConsoleApp) -> Region:
    """Return the place of an image of 4:3 in cells of `CELL`."""
    pane = pane_of(app).content_region
    height = min(pane.height, math.ceil(pane.width * 3 / 8 - 0.01))
    return Region(pane.x, pane.y, min(pane.width, math.ceil(pane.height * 8 / 3 - 0.01)), height)


def bands(app: ConsoleApp) -> int:
    """Return how many bands an image of the pane's height has."""
    height = pane_of(app).size.height
    return math.ceil(height / math.ceil(height / BANDS))


on_list = on_main(WIDE, landmark="/robot2/scan", make_engine=LookingEngine)


@on_list
async def test_image_is_asked_for_in_pixels_of_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await in_pixels(pilot)
    wish = await comes(pilot, viewed(noise(320, 240)))
    assert (wish.across, wish.down, wish.shape) == (10, 20, 2.0)
    assert (wish.width, wish.height) == pane_of(app).size


@on_list
async def test_image_fills_its_pane_and_no_more(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_pixels(pilot)
    await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    content = pane_of(app).content_region
    places = sorted(written.shown().values())
    assert (places[0][0], places[0][1]) == (content.y + 1, content.x + 1)
    assert sum(height for *_, height in places) == content.height
    assert {width for _, _, width, _ in places} == {-(-content.height * 20 * 320 // (240 * 10))}
    assert not any(row.strip() for row in drawn(app))


@on_list
async def test_rows_below_a_question_are_characters(app: ConsoleApp, pilot: Pilot[None]) -> None:
    written = await in_pixels(pilot)
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
    written = await in_pixels(pilot)
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
    written = await in_pixels(pilot)
    for _ in range(3):
        await comes(pilot, viewed(noise(320, 240)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    assert len(_PLACED.findall(written.text)) == bands(app)
    await comes(pilot, viewed(noise(320, 240, seed=2)))
    await until(pilot, lambda: len(_PLACED.findall(written.text)) == 2 * bands(app), "another image")
    assert len(written.shown()) == bands(app)


# -- boxes

PROTOCOLS = pytest.mark.parametrize("protocol", ["kitty", "sixel"])
DRIVEN = route(
    "/cmd_vel", outgoing=True, type_name="geometry_msgs/msg/Twist", max_age=0.5, arming=ArmingSnapshot(armed=True)
)


class Box(ModalScreen[None]):
    """A box somewhere on the screen."""

    CSS = "Box { align: left top; } Box Static { background: red; }"

    def __init__(self, place: Region) -> None:
        super().__init__()
        self._place = place

    def compose(self) -> ComposeResult:
        box = Static("a box")
        box.styles.offset = Offset(self._place.x, self._place.y)
        box.styles.width, box.styles.height = self._place.width, self._place.height
        yield box


@PROTOCOLS
@on_list
async def test_box_on_image_hides_its_bands(app: ConsoleApp, pilot: Pilot[None], protocol: str) -> None:
    """Their rows show the same part of the image in characters, and no other row does."""
    written = await in_pixels(pilot, protocol)
    await comes(pilot, viewed(halves(640, 480, 255)))
    image = image_region(app)
    high = math.ceil(image.height / BANDS)
    found = [Region(image.x, y, image.width, min(high, image.bottom - y)) for y in range(image.y, image.bottom, high)]
    await until(pilot, lambda: written.tops() == {each.y for each in found}, "the image")
    places = {
        "beside": Region(image.right, image.y, 20, image.height),
        "above": Region(0, 0, app.size.width, image.y),
        "below": Region(0, image.bottom, app.size.width, 1),
        "on a corner": Region(image.right - 2, image.bottom - high - 1, 20, high),
        "within": Region(image.x + 9, image.y + high, 9, 1),
        "on all": Region(0, 0, *app.size),
        "beside again": Region(image.right, image.y, 20, image.height),
    }
    for bright, (name, place) in enumerate(places.items(), 200):
        await app.push_screen(Box(place))
        box = app.screen.query_one(Static)
        await until(pilot, lambda box=box, place=place: box.region == place, f"a box {name}")
        before = len(written.text)
        await comes(pilot, viewed(halves(640, 480, bright)))
        in_sight = {each.y for each in found if not each.overlaps(place)}
        hidden = {y - image.y for each in found if each.overlaps(place) for y in each.line_range}
        await until(pilot, lambda before=before, tops=in_sight: written.tops(before) == tops, f"pixels, box {name}")
        await until(pilot, lambda hidden=hidden: {*edges(app)} == hidden, f"characters, box {name}")
        for edge, width in edges(app).values():
            assert width == image.width
            assert abs(edge - width / 2) <= 1
        await app.pop_screen()


@PROTOCOLS
@on_list
async def test_box_on_held_image_hides_its_bands(app: ConsoleApp, pilot: Pilot[None], protocol: str) -> None:
    """No picture comes that would be drawn around the box."""
    written = await in_pixels(pilot, protocol)
    await comes(pilot, viewed(halves(640, 480, 255)))
    await until(pilot, lambda: len(written.tops()) == bands(app), "the image")
    await pilot.press("space")
    image = image_region(app)
    high = math.ceil(image.height / BANDS)
    await app.push_screen(Box(Region(image.x + 9, image.y + high, 9, 1)))
    await until(pilot, lambda: {*edges(app)} == {*range(high, 2 * high)}, "characters around the box")
    before = len(written.text)
    await app.pop_screen()
    await until(pilot, lambda: not edges(app), "no characters")
    await until(pilot, lambda: image.y + high in written.tops(before), "the band in pixels")


@on_list
async def test_box_that_is_soon_gone_leaves_no_hole(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes while the line carries the text by which the sixels below it were taken away."""
    line = TerminalLine(rate=1e9)
    replaced.NO_LINE.set(monkeypatch, line)
    written = await in_pixels(pilot, "sixel")
    await comes(pilot, viewed(halves(640, 480, 255)))
    await until(pilot, lambda: len(written.tops()) == bands(app), "the image")
    await pilot.press("space")
    image, writer = image_region(app), app.writer
    top, forget = image.y + math.ceil(image.height / BANDS), writer.forget

    def forget_and_wait(region: Region) -> None:
        forget(region)
        line.rate = 1.0
        line.wrote(1000)

    vars(writer)["forget"] = forget_and_wait
    await app.push_screen(Box(Region(image.x + 9, top, 9, 1)))
    await until(pilot, lambda: line.rate == 1.0, "the sixels below it are taken away")
    del vars(writer)["forget"]
    before = len(written.text)
    app.pop_screen()
    await until(pilot, lambda: isinstance(app.screen, ViewScreen), "no box")
    line.rate = 1e9
    await until(pilot, lambda: top in written.tops(before), "the band in pixels")
    assert not edges(app)


@PROTOCOLS
@on_list
async def test_message_beside_image_hides_nothing(app: ConsoleApp, pilot: Pilot[None], protocol: str) -> None:
    written = await in_pixels(pilot, protocol)
    app.notify("a message", timeout=600)
    await shown(pilot, "a message")
    for bright in (200, 255):
        before = len(written.text)
        await comes(pilot, viewed(halves(100, 400, bright)))
        await until(pilot, lambda before=before: len(written.tops(before)) == bands(app), "the image")
    assert not edges(app)


@PROTOCOLS
@on_list
async def test_drive_box_stands_beside_pixels(app: ConsoleApp, pilot: Pilot[None], protocol: str) -> None:
    """The image takes the room that is left, whole and in its proportions."""
    written = await in_pixels(pilot, protocol)
    await comes(pilot, viewed(halves(640, 480, 255)))
    put(app, DRIVEN)
    await pilot.press("d")
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the drive box")
    box = app.screen.query_one("#drive")
    await until(pilot, lambda: not box.region.overlaps(pane_of(app).region), "room for the box")
    for bright in (200, 210):
        before = len(written.text)
        await comes(pilot, viewed(halves(640, 480, bright)))
        expected = math.ceil(image_region(app).height / math.ceil(image_region(app).height / BANDS))
        await until(
            pilot, lambda before=before, expected=expected: len(written.tops(before)) == expected, "the whole image"
        )
    assert not edges(app)
    if protocol == "kitty":
        assert {width for _, _, width, _ in written.shown().values()} == {image_region(app).width}
        assert sum(height for *_, height in written.shown().values()) == image_region(app).height


@on_list
async def test_sixels_come_back_after_text(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Of the screen itself, and of one below a box, which Textual draws as a whole."""
    written = await in_pixels(pilot, "sixel")
    await comes(pilot, viewed(halves(640, 480, 255)))
    await until(pilot, lambda: len(written.tops()) == bands(app), "the image")
    image = image_region(app)
    for box in (None, Box(Region(image.right, image.y, 9, 9))):
        if box is not None:
            await app.push_screen(box)
            await until(pilot, lambda box=box: not box.query_one(Static).region.overlaps(image), "a box beside it")
        await pilot.pause(0.5)
        before = len(written.text)
        app.screen.refresh()
        await until(pilot, lambda before=before: len(written.tops(before)) == bands(app), "the image again")


@on_list
async def test_new_title_below_box_leaves_sixels(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Textual would draw the whole screen below the box again, for each title."""
    await in_pixels(pilot, "sixel")
    await comes(pilot, viewed(halves(640, 480, 255)))
    image, rows = image_region(app), set[int]()
    await app.push_screen(Box(Region(image.right, image.y, 9, 9)))
    app.text_drawn.subscribe(app.main, lambda spans: rows.update(y for y, *_ in spans), immediate=True)
    for number in range(100):  # on a busy machine, the box is drawn with the first titles
        rows.clear()
        pane_of(app).entitle(f"title {number}")
        await until(pilot, lambda: 0 in rows, "the title")
        if rows.isdisjoint(image.line_range):
            return
    pytest.fail("each title draws the image's rows")


# -- proportions


@pytest.mark.parametrize("covered", [False, True])
@on_list
async def test_proportions_hold_while_line_is_slow(
    app: ConsoleApp, pilot: Pilot[None], covered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An image with fewer pixels is asked for, and until it comes the one before is in sight; at last characters."""
    cell, name = (7.0, 15.0), "kitty"
    written = await in_pixels(pilot, "kitty", cell, name)

    replaced.NO_LINE.set(monkeypatch, TerminalLine(rate=2_000.0))
    wish = looks(engine_of(app))[-1][1]
    if covered:
        await app.push_screen(Box(Region(0, 0, *app.size)))
    densities = []
    # A busy machine may draw a picture late: then the next question still asks for as many pixels.
    for bright in range(200, 203 if covered else 256):
        densities.append((wish.across, wish.down))
        before, wish = wish, await comes(pilot, viewed(camera(wish, halves(640, 480, bright))))
        if covered:  # then nothing is sent
            await until(pilot, lambda: len(edges(app)) > 1, "characters")
            wide, high = edges(app)[0][1], len(edges(app))
        else:
            await until(pilot, lambda: written.shown() or len(edges(app)) > 1, "the image")
            if not (places := written.shown().values()):
                break
            wide = {width for _, _, width, _ in places}.pop()
            high = sum(height for *_, height in places)
        assert wide * cell[0] / (high * cell[1]) == pytest.approx(4 / 3, rel=0.05), (before, wish)
    else:
        assert covered, "never in characters"
    assert densities[0] == (7, 15)
    assert (min(densities) < (7, 15)) is not covered


@pytest.mark.parametrize("held", [False, True])
@on_list
async def test_uncovered_image_is_measured_first(
    app: ConsoleApp, pilot: Pilot[None], held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a slow line, what stood under a box comes back with fewer pixels, even if the other side sends no others."""
    written = await in_pixels(pilot, "kitty", (7.0, 15.0), "kitty")
    line = TerminalLine(rate=40_000.0)
    replaced.NO_LINE.set(monkeypatch, line)
    wish = looks(engine_of(app))[-1][1]
    await app.push_screen(Box(Region(0, 0, *app.size)))
    wish = await comes(pilot, viewed(camera(wish, noise(640, 480))))
    await until(pilot, lambda: any(row.strip() for row in drawn(app)), "characters")
    assert not written.shown()
    if held:
        await pane_of(app).run_action("hold")
    await app.pop_screen()
    await until(pilot, lambda: len(written.shown()) == bands(app), "pixels")
    assert len(written.text) <= 2.0 * line.rate
    places = written.shown().values()
    wide, high = {width for _, _, width, _ in places}.pop(), sum(height for *_, height in places)
    assert wide * 7 / (high * 15) == pytest.approx(4 / 3, rel=0.05)
    if not held:
        await until(pilot, lambda: looks(engine_of(app))[-1][1].across < wish.across, "a wish for fewer pixels")


@on_list
async def test_still_image_becomes_fine_on_a_line_that_turns_out_fast(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a new terminal's line, of which is known only how much has passed at once."""
    written = await in_pixels(pilot, "kitty", (7.0, 15.0), "kitty")
    line = TerminalLine(rate=40_000.0)
    replaced.NO_LINE.set(monkeypatch, line)
    write = app.write_to_terminal

    def passes(sequence: str) -> None:
        write(sequence)
        line.rate = max(line.rate, 2.0 * len(sequence) / FRAME)

    vars(app)["write_to_terminal"] = passes
    wish = looks(engine_of(app))[-1][1]
    densities = []
    for _ in range(12):
        wish = await comes(pilot, viewed(camera(wish, noise(640, 480))))
        densities.append((wish.across, wish.down))
    assert min(densities) < (7, 15)
    assert densities[-1] == (7, 15), densities
    assert written.shown()


@pytest.mark.parametrize("rate", [200_000.0, 3_500_000.0])
@on_list
async def test_still_image_settles(
    app: ConsoleApp, pilot: Pilot[None], rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures that cost nothing, as the terminal has them, do not ask for finer ones that cost too much."""
    written = await in_pixels(pilot, "kitty", (7.0, 15.0), "kitty")
    replaced.NO_LINE.set(monkeypatch, TerminalLine(rate=rate))
    wish, densities, sent = looks(engine_of(app))[-1][1], [], 0
    for number in range(12):
        if number == 6:
            sent = len(written.text)
        wish = await comes(pilot, viewed(camera(wish, noise(640, 480))))
        densities.append((wish.across, wish.down))
    assert densities[0] < (7, 15)
    assert len({*densities[5:]}) == 1, densities
    assert len(written.text) == sent


def camera(wish: Wish, seen: Pixels) -> Pixels:
    """Return a camera's image of 640 × 480 as the other side draws it."""
    message = Image(encoding="rgb8", width=640, height=480, step=3 * 640, data=seen.data)
    content = samples.drawn(wish, message).content
    assert isinstance(content, Pixels)
    return content


@on_list
async def test_held_image_keeps_proportions_in_another_size(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Of the terminal, and of its font."""
    written = await in_pixels(pilot, "kitty", (7.0, 15.0))
    await comes(pilot, viewed(camera(looks(engine_of(app))[-1][1], halves(640, 480, 255))))
    await pilot.press("space")
    for size, cell in (((90, 30), (7.0, 15.0)), ((100, 30), (10.0, 19.0)), ((60, 40), (14.0, 29.0))):
        app.facts = replace(app.facts, cell=cell)
        await pilot.resize_terminal(*size)

        def fits(cell: tuple[float, float] = cell) -> bool:
            placed = written.shown().values()
            wide, high = {each[2] for each in placed}, sum(each[3] for each in placed)
            pane = pane_of(app).size
            is_right = len(wide) == 1 and abs(max(wide) * cell[0] / (high * cell[1]) * 3 / 4 - 1) < 0.05
            return is_right and (max(wide) == pane.width or high == pane.height)

        await until(pilot, fits, f"the image in {size} of {cell}")


def whole_map(app: ConsoleApp) -> Cells:
    """Return a map that fills the pane, three cells to a character."""
    width, height = pane_of(app).size
    return Cells(("⣿" * 3 * width,) * 3 * height, scale=Scale("map", 0.0, 3.0, 0.5, 0.5), fine=3)


PLOT = Series(0.0, 1.0, (Curve("x", (0.0, 1.0, 0.0), (0.5, 1.0, 0.0), 0.0, 0.5),))


@on_list
@pytest.mark.parametrize("kind", ["map", "plot"])
async def test_maps_and_plots_are_images(app: ConsoleApp, pilot: Pilot[None], kind: str) -> None:
    written = await in_pixels(pilot)
    wish = await comes(pilot, viewed(PLOT if kind == "plot" else whole_map(app)))
    assert wish.fine == 3
    await until(pilot, lambda: len(written.shown()) == bands(app), "the image")
    assert not any(row.strip() for row in drawn(app))
    before = len(written.text)
    await pilot.press("left" if kind == "plot" else "g")  # a cursor, or a goal
    await until(pilot, lambda: len(written.text) > before and len(written.shown()) == bands(app), "a part is new")
    await pilot.press("escape")


@on_list
async def test_goal_moves_by_characters_of_map_in_pixels(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await in_pixels(pilot)
    await comes(pilot, viewed(whole_map(app)))
    await pilot.press("g")
    await until(pilot, lambda: "GOAL at" in title(app), "a goal")
    before = title(app)
    await pilot.press("right")
    await until(pilot, lambda: title(app) != before, "another place")
    places = [float(re.findall(r"GOAL at (\S+),", each)[0]) for each in (before, title(app))]
    assert places[1] - places[0] == pytest.approx(3 * 0.5)


@on_list
async def test_goal_is_seen_to_move_while_key_is_held(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keys that come faster than the map is drawn: each drawing is shown, and the next one has all keys since."""
    written = await in_pixels(pilot)
    await comes(pilot, viewed(whole_map(app)))
    await pilot.press("space", "g")
    await until(pilot, lambda: len(written.shown()) == bands(app), "the goal")
    drawings: list[threading.Event] = []
    draw = picture_places.IMAGE_OF.value

    def held(*about: Any, **more: Any) -> Pixels:
        drawings.append(may_end := threading.Event())
        may_end.wait(60)
        return draw(*about, **more)  # type: ignore[no-any-return]

    picture_places.IMAGE_OF.set(monkeypatch, held)
    try:
        await pilot.press("right")
        for number in range(3):
            await until(pilot, lambda number=number: len(drawings) > number, "a drawing")
            before = len(written.text)
            await pilot.press("right", "right", "right")
            drawings[number].set()
            await until(pilot, lambda before=before: len(written.text) > before, "the goal further on", 20)
        await until(pilot, lambda: len(drawings) == 4, "the last drawing")
    finally:
        monkeypatch.undo()
        for each in drawings:
            each.set()


@on_list
async def test_click_on_map_of_another_size_puts_goal_there(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """On a held map after a resize, and on one that was made for half of the pane."""
    written = await in_pixels(pilot)
    await comes(pilot, viewed(whole_map(app)))
    await pilot.press("space", "g")
    before = pane_of(app).size
    await pilot.resize_terminal(90, 30)
    await until(pilot, lambda: pane_of(app).size != before and is_whole(app, written), "the map in another size")
    await clicked(app, pilot, written, 3 * before.width * 0.5)
    await pilot.press("space")
    width, height = pane_of(app).size
    half = Cells(("⣿" * 3 * (width // 2),) * (3 * (height // 2)), scale=Scale("map", 0.0, 3.0, 0.5, 0.5), fine=3)
    await comes(pilot, viewed(half))
    await until(pilot, lambda: is_whole(app, written), "the map of half the size")
    await clicked(app, pilot, written, 3 * (width // 2) * 0.5)


async def clicked(app: ConsoleApp, pilot: Pilot[None], written: Written, metres: float) -> None:
    """Click on a map that is so wide, and find the goal in the part of its image that was clicked."""
    content, (columns,) = pane_of(app).content_region, {width for _, _, width, _ in written.shown().values()}
    column = columns // 4
    before = title(app)
    await pilot.click(offset=(content.x + column, content.y + 5))
    await until(pilot, lambda: title(app) != before, "another place")
    place = float(re.findall(r"GOAL at (\S+),", title(app))[0])
    assert place / metres == pytest.approx((column + 0.5) / columns, abs=1 / columns)


def is_whole(app: ConsoleApp, written: Written) -> bool:
    """Whether an image is in sight that fills its pane in one direction."""
    placed, pane = written.shown().values(), pane_of(app).size
    widths = {width for _, _, width, _ in placed}
    return len(widths) == 1 and (max(widths) == pane.width or sum(height for *_, height in placed) == pane.height)


@on_list
async def test_terminal_without_pixels_asks_for_no_finer_map(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    wish = await comes(pilot, viewed(PLOT))
    assert wish.fine == 1
    await until(pilot, lambda: any("┤" in row for row in drawn(app)), "the plot in characters")


def title(app: ConsoleApp) -> str:
    return str(pane_of(app).border_title)


@on_list
async def test_image_that_would_fill_the_line_is_not_sent(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is shown in characters, until there is one that is small."""
    replaced.NO_LINE.set(monkeypatch, TerminalLine(rate=20_000.0))
    written = await in_pixels(pilot)
    asked = looks(engine_of(app))[-1][1]
    wish = await comes(pilot, viewed(full_of(asked)))
    assert (wish.across, wish.down) < (asked.across, asked.down)
    await until(pilot, lambda: any(row.strip() for row in drawn(app)), "characters")
    assert not written.shown()
    for _ in range(4):
        await comes(pilot, viewed(halves(8, 6, 255)))
    await until(pilot, lambda: len(written.shown()) == bands(app), "a small image")
    await until(pilot, lambda: (seen := pane_of(app).sight()) is not None and seen.age is not None, "its age")


def full_of(wish: Wish) -> Pixels:
    """Return an image of as many pixels as were asked for, none of which can be left out."""
    return noise(wish.width * wish.across, wish.height * wish.down)
