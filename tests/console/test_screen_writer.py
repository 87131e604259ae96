"""When the screen is given to the terminal, and which part of it first: what a key may have done, and pictures last."""

from __future__ import annotations

import asyncio
import re
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pyte
import pytest
from rich.color import ColorSystem
from tests.console.arming_helpers import DISARMED
from tests.console.driving import NARROW, WIDE, on_main, until
from tests.support.heights import heights_of
from textual._compositor import LayoutUpdate
from textual.geometry import Region, Size
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_console.actions.action import late
from rsb_console.screens.dialog import ArmScreen
from rsb_console.screens.help import KeyList
from rsb_console.terminal.screen_cells import BOX, FIRST, LAST, LINES, USUAL
from rsb_console.terminal.screen_writer import ScreenWriter
from rsb_console.terminal.terminal_line import TerminalLine
from rsb_console.terminal_app import prepare

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from textual.app import ComposeResult
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


class Box(ModalScreen[None]):
    """A screen with one thing on it."""

    def compose(self) -> ComposeResult:
        yield Static("box", id="box")


class Coloured(Box):
    """A box with a style of its own."""

    CSS = "#box { background: #0000ff; }"


@on_main()
async def test_boxes_come_before_pictures_below_them_and_after_their_own(app: ConsoleApp, pilot: Pilot[None]) -> None:
    below, above = Box(), Box()
    for screen in (below, above):
        app.push_screen(screen)
        await until(pilot, lambda screen=screen: bool(screen.query("#box")) and screen.is_current, "a box")
    picture, picture_above = below.query_one("#box"), above.query_one("#box")
    driver: Any = SimpleNamespace(line=TerminalLine(), losses=0)
    box = picture_above.region
    title = Region(box.x, box.y, box.width, 1)
    for shown, expected in (
        ([picture], [(title, FIRST), (box, BOX), (picture.region, LAST), (picture.region, USUAL)]),
        ([picture_above], [(box, LAST), (title, FIRST), (box, BOX), (picture.region, USUAL)]),
    ):
        writer = ScreenWriter(app, driver, ColorSystem.TRUECOLOR, shown, lambda _: None)
        *ranks, header = writer._ranks()
        assert ranks == expected
        assert header == (Region(0, 0, app.size.width, 2), LINES)


class Given:
    """A writer of an app, over a line of 1,920 bytes/s in simulated time.

    Attributes:
        rows: rows of the screen that were written.
        looks: s until each next look.
    """

    def __init__(self, app: ConsoleApp, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.rows, self.looks = 100.0, list[int](), list[float]()
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        monkeypatch.setattr(asyncio, "get_running_loop", lambda: SimpleNamespace(call_later=self._call_later))
        line = TerminalLine(lambda: self.now, rate=1_920)
        driver: Any = SimpleNamespace(line=line, losses=0, is_free=True, erases=False, late=0.0)
        driver.write_frame = lambda *_, **__: None
        self.writer = ScreenWriter(app, driver, ColorSystem.TRUECOLOR, (), self._written)
        self.writer.expect_effect()
        self.writer.draw(LayoutUpdate([], Region()))

    def _call_later(self, seconds: float, _call: Callable[[], None]) -> object:
        self.looks.append(seconds)
        return SimpleNamespace(cancel=lambda: None)

    def _written(self, spans: Sequence[tuple[int, int, int]]) -> None:
        self.rows += [y for y, *_ in spans]

    def give_in(self, seconds: float) -> None:
        self.now += seconds
        self.writer.give()


@on_main()
async def test_key_has_its_effect_before_what_is_below_the_box(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which is written later, also while the key is held, and is no lateness meanwhile."""
    app.push_screen(box := Box())
    await until(pilot, lambda: bool(box.query("#box")) and box.is_current, "a box")
    region = box.query_one("#box").region
    with monkeypatch.context() as patched:
        given = Given(app, patched)
        while not given.writer.has(region):
            given.give_in(0.02)
        for _ in range(4):
            given.writer.expect_effect()  # a repeat
            given.give_in(0.05)
        assert set(given.rows) <= {0, 1, *region.line_range}
        assert given.writer.late == 0.0
        given.give_in(given.looks[-1])
        assert not set(given.rows) <= {0, 1, *region.line_range}


@on_main()
async def test_nothing_becomes_dim_before_the_box_is_there(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    app.push_screen(screen := ModalScreen[None]())
    await until(pilot, lambda: screen.is_current, "a screen")
    with monkeypatch.context() as patched:
        given = Given(app, patched)
        given.give_in(0.02)
        assert given.rows == []
        given.give_in(given.looks[-1])
        assert given.rows != []


@on_main(NARROW, WIDE)
async def test_help_has_its_height_at_once(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a slow line would carry it twice."""
    heights = heights_of("KeyList", monkeypatch)
    await pilot.press("question_mark")
    await until(pilot, lambda: isinstance(app.screen.focused, KeyList), "the keys")
    await pilot.pause()
    assert heights == [app.screen.query_one(KeyList).outer_size.height]
    assert heights[0] > app.size.height // 2


def test_writer_gives_what_is_left_while_app_ends_without_a_screen() -> None:
    app: Any = SimpleNamespace(screen_stack=[], size=Size(80, 24), focused=None)
    line = TerminalLine(rate=float("inf"))
    driver: Any = SimpleNamespace(line=line, losses=0, is_free=True, erases=False)
    driver.write_frame = lambda *_, **__: None
    rows: list[int] = []
    writer = ScreenWriter(app, driver, ColorSystem.TRUECOLOR, (), lambda spans: rows.extend(y for y, *_ in spans))
    writer.draw(LayoutUpdate([], Region()))
    assert rows


def test_line_that_stands_still_is_looked_at_less_often(monkeypatch: pytest.MonkeyPatch) -> None:
    now, waits = [100.0], list[float]()

    def call_later(seconds: float, _call: Callable[[], None]) -> object:
        waits.append(seconds)
        return object()

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(asyncio, "get_running_loop", lambda: SimpleNamespace(call_later=call_later))
    app = cast("Any", SimpleNamespace())
    driver = cast("Any", SimpleNamespace(line=None, losses=0, is_free=False, erases=False))
    writer = ScreenWriter(app, driver, ColorSystem.TRUECOLOR, (), lambda _: None)
    writer.give()
    for _ in range(100):
        now[0] += waits[-1]
        writer.give()
    assert waits[0] < 0.05
    assert now[0] > 105.0
    assert waits[-1] < 0.5


@on_main()
async def test_styles_of_screens_are_read_before_a_key_opens_one(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading all anew with each takes so long that the key seems lost."""
    await prepare(app)
    monkeypatch.setattr(app.stylesheet, "reparse", lambda: pytest.fail("all styles are read again"))
    app.push_screen(box := Coloured())
    await until(pilot, lambda: bool(box.query("#box")) and box.is_current, "a box")
    assert box.query_one("#box").styles.background.hex == "#0000FF"


STYLED = """
from textual.screen import ModalScreen

class Styled(ModalScreen):
    CSS = "Static { background: #00ff00; }"

class Heir(Styled):
    pass
"""


@on_main()
async def test_styles_of_screens_that_keys_import_are_read(
    app: ConsoleApp, pilot: Pilot[None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "failing_late.py").write_text("1 / 0")
    (tmp_path / "styled_late.py").write_text(STYLED)
    late("failing_late:show")
    late("styled_late:show")
    await prepare(app)
    sources = [name for _, name in app.stylesheet.source]
    assert {"Styled.CSS", "Heir.CSS"} <= {*sources}
    await pilot.press("t")


@on_main()
async def test_faulty_styles_of_a_screen_are_left_to_its_key(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Coloured, "CSS", "#box { background: }")
    await prepare(app)
    await pilot.press("t")
    assert not any(name == "Coloured.CSS" for _, name in app.stylesheet.source)


@on_main()
async def test_styles_of_a_screen_without_a_file_are_read(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Coloured, "__module__", "without_a_file")
    await prepare(app)
    assert app.stylesheet.has_source("", "Coloured.CSS")


@pytest.mark.parametrize("colours", [ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT])
@on_main((80, 24))
async def test_question_and_answers_come_before_the_rest_of_box(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch, colours: ColorSystem
) -> None:
    """At 9,600 baud these take 0.2 s, and the whole box half a second."""
    screen, whole = pyte.Screen(80, 24), Region(0, 0, 80, 24)
    stream, asked_after = pyte.Stream(screen), cast("int | None", None)

    def asks() -> bool:
        text = "\n".join(screen.display)
        return "Arm /cmd_vel of robot1?" in text and re.search("Arm +No", text) is not None

    def write_frame(text: str, **_: object) -> None:
        nonlocal asked_after
        if asked_after is None:
            stream.feed(text)
            return
        for each in text:
            asked_after += 0 if asks() else len(each.encode())
            stream.feed(each)

    line: Any = SimpleNamespace(most=144, answers=True)  # as of 960 bytes/s
    driver: Any = SimpleNamespace(line=line, losses=0, is_free=True, erases=True, late=0.0, write_frame=write_frame)
    writer = ScreenWriter(app, driver, colours, (), lambda _: None)
    monkeypatch.setattr(writer, "_look_in", lambda _: None)

    def give_until(shown: Callable[[], object]) -> None:
        writer.draw(app.screen._compositor.render_full_update())
        while not shown():
            writer.give()

    give_until(lambda: writer.has(whole))
    app.push_screen(question := ArmScreen(DISARMED))
    await until(pilot, lambda: bool(question.query("#no")) and question.is_current, "a question")
    await pilot.pause()
    asked_after = 0
    writer.expect_effect()
    give_until(asks)
    assert asked_after is not None
    assert asked_after < 960 / 5
