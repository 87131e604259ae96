"""Pictures of a topic's messages in the console: their keys, their age, and what is wrong."""

import asyncio
import csv
import math
import re
import struct
import time
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    WIDE,
    form_of,
    notified,
    put,
    selected_topic,
    send,
    shown,
    text,
    until,
)
from tests.console.scripted import SUGGESTION, answered, route
from tests.support import surroundings
from tests.support.control import Machine
from tests.support.wording import says
from textual.binding import Binding
from textual.events import Key
from textual.pilot import Pilot

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, RouteSnapshot
from rsb_console.actions.all_actions import BY_ID
from rsb_console.app import ConsoleApp
from rsb_console.notation import formats
from rsb_console.screens.help import KeyList
from rsb_console.screens.message_screen import MessageScreen
from rsb_console.widgets.form import FormScreen
from rsb_extras.pictures.goal_keys import GoalText
from rsb_extras.pictures.goal_on_map import POSE, Goal
from rsb_extras.pictures.look_requests import AnswerProblem, LookAtTopics
from rsb_extras.pictures.picture import (
    MOST_ACROSS,
    MOST_COLUMNS,
    MOST_RATE,
    MOST_ROWS,
    Cells,
    Curve,
    Picture,
    Pixels,
    Scale,
    Series,
    Viewed,
    Wish,
)
from rsb_extras.pictures.picture_keys import LOOK
from rsb_extras.pictures.picture_rows import AXIS
from rsb_extras.pictures.picture_tile import PictureTile, ViewText
from rsb_extras.pictures.tests import picture_places
from rsb_extras.pictures.tests.looking_engine import LookingEngine
from rsb_extras.pictures.tests.view_screen_helpers import (
    CHARACTERS,
    SCAN,
    comes,
    engine_of,
    looking,
    looks,
    on_list,
    opened,
    viewed,
)
from rsb_extras.pictures.tile import ON_ROBOT
from rsb_extras.pictures.view_screen import ViewScreen

IMAGE = Pixels(300, 200, Random(1).randbytes(3 * 300 * 200))
"""With so much detail that blocks have characters, and no spaces in colours alone."""
CURVES = Series(0.0, 0.5, (Curve("x", (1.0, 2.0), (1.0, 3.0), 3.0, 2.0),))


async def written(pilot: Pilot[None], answer: Viewed | Exception) -> Wish:
    """Press the key that writes an image, answer the question for it in full, and return that question's wish."""
    assert isinstance(pilot.app, ConsoleApp)
    engine = engine_of(pilot.app)
    follows = engine.viewing
    await pilot.press("p")
    await until(pilot, lambda: engine.viewing is not follows, "the question for the whole image")
    wish = looks(engine)[-1][1]
    assert isinstance(wish, Wish)
    if isinstance(answer, Exception):
        engine.viewing.set_exception(answer)
    else:
        engine.viewing.set_result(answer)
    engine.viewing = follows
    return wish


def screen_of(app: ConsoleApp) -> ViewScreen:
    assert isinstance(app.screen, ViewScreen)
    return app.screen


def drawn(app: ConsoleApp) -> list[str]:
    """Return the rows of the picture's pane."""
    pane = screen_of(app).pane
    return [pane.render_line(row).text for row in range(pane.size.height)]


def has_picture(app: ConsoleApp) -> bool:
    return any(row.strip() for row in drawn(app))


def placing(app: ConsoleApp) -> Goal | None:
    tile = screen_of(app).pane
    assert isinstance(tile, PictureTile)
    return tile._goal.goal


def title(app: ConsoleApp) -> str:
    pane_title = screen_of(app).pane._border_title
    return "" if pane_title is None else pane_title.plain


@looking()
async def test_help_begins_with_the_keys_of_pictures(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("question_mark")
    await shown(pilot, "Help: every key")
    keys = app.screen.query_one(KeyList)
    assert LOOK.chapters[0].title in keys.render_line(0).text
    rows = [keys.render_line(row).text for row in range(keys.size.height)]
    assert any("Hold the picture" in row for row in rows)


# -- pictures


@looking()
async def test_a_picture_is_asked_for_and_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    (topics, wish, link), *_ = looks(engine_of(app))
    assert (topics, link) == ((SCAN,), "")
    pane = screen_of(app).pane.scrollable_content_region.size
    assert (wish.width, wish.height) == (pane.width, pane.height)
    await shown(pilot, ViewText.WAITING)
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    for part in (SCAN, "360 points", ViewText.SIDE(side="the server"), formats.byte_rate(1234 / 5)):
        assert part in title(app)


@looking(theme="terminal")
async def test_without_true_colour_an_image_is_ascii(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(IMAGE))
    await until(pilot, lambda: has_picture(app), "the picture")
    rows = "".join(drawn(app))
    assert rows.strip()
    assert rows.isascii() == bool(app.ansi_color)


@looking()
async def test_the_wish_follows_the_size_of_the_terminal(app: ConsoleApp, pilot: Pilot[None]) -> None:
    before = await comes(pilot, viewed())
    await pilot.resize_terminal(70, 20)

    async def is_smaller() -> Wish:
        wish = before
        while wish.width >= before.width:
            wish = await comes(pilot, viewed())
        return wish

    after = await asyncio.wait_for(is_smaller(), 180)
    assert after.width < 70
    assert after.height < 20 < before.height


@looking()
async def test_screen_asks_again_after_answer_without_picture(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for answer in (None, viewed(), None):
        await comes(pilot, answer)
    await shown(pilot, "the picture")  # the last one stays


@looking()
async def test_the_view_ends_with_the_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed())
    await pilot.press("escape")
    await until(pilot, engine_of(app).viewing.cancelled, "nobody asks any more")
    assert app.screen is app.main


@looking()
async def test_the_reason_stands_in_an_empty_pane(app: ConsoleApp, pilot: Pilot[None]) -> None:
    waiting = Viewed(
        Picture(type_name="sensor_msgs/msg/Image", waiting=f"1 publisher{' word' * 60}, unheard"), "robot1"
    )
    await comes(pilot, waiting)
    await until(pilot, lambda: "unheard" in "".join(drawn(app)), "the reason, over several rows")
    assert says(title(app), ViewText.WAITING)
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    assert "unheard" not in "".join(drawn(app))
    await comes(pilot, waiting)  # the other side draws again
    await until(pilot, lambda: "1 publisher" in title(app), "the reason, with the last picture")
    assert "the picture" in "".join(drawn(app))


@looking()
async def test_a_refusal_stands_in_an_empty_pane(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, EngineError("nobody publishes it"))
    await until(pilot, lambda: "nobody publishes it" in "".join(drawn(app)), "the refusal")


# -- keys


@pytest.mark.parametrize(
    ("type_name", "keys", "others"),
    [
        ("sensor_msgs/msg/Image", (), ("[] tilt", "l layers")),
        ("sensor_msgs/msg/PointCloud2", ("[] tilt",), ("l layers",)),
        ("nav_msgs/msg/OccupancyGrid", ("l layers",), ("[] tilt",)),
    ],
)
@on_list(NARROW, landmark=SCAN)
async def test_keys_of_picture_have_room_on_narrow_screen(
    app: ConsoleApp, pilot: Pilot[None], type_name: str, keys: tuple[str, ...], others: tuple[str, ...]
) -> None:
    put(app, route("/first", type_name=type_name), route("/path", type_name="nav_msgs/msg/Path"))
    await until(pilot, lambda: selected_topic(app) == "/first", "the topic under the cursor")
    await pilot.press("v")
    await until(pilot, lambda: looks(engine_of(app)), "a question for a picture")
    await shown(pilot, "space hold")
    assert all(key in text(app) for key in (*keys, "+- zoom"))
    assert not any(key in text(app) for key in others)
    assert keys or "p file" in text(app)


WISHES: list[tuple[list[str], dict[str, Any]]] = [
    (["plus"], {"zoom": 1.5}),
    (["equals_sign"], {"zoom": 1.5}),
    (["minus"], {"zoom": pytest.approx(1 / 1.5)}),
    (["plus"] * 14, {"zoom": 200.0}),
    (["minus"] * 9, {"zoom": 0.05}),
    (["left"], {"x": -0.1}),
    (["right", "right"], {"x": pytest.approx(0.2)}),
    (["up"], {"y": 0.1}),
    (["down"], {"y": -0.1}),
    (["right_square_bracket"], {"tilt": 15.0}),
    (["right_square_bracket"] * 9, {"tilt": 90.0}),
    (["right_square_bracket", "left_square_bracket", "left_square_bracket"], {"tilt": 0.0}),
    (["c"], {"colour": "intensity"}),
    (["c", "c"], {"colour": "height"}),
    (["h"], {"how": "plot"}),
    (["h", "h"], {"how": "tree"}),
    (["h", "h", "h"], {"how": ""}),
    (["greater_than_sign"], {"rate": 5.0}),
    (["greater_than_sign"] * 9, {"rate": MOST_RATE}),
    (["less_than_sign"], {"rate": 1.0}),
    (["less_than_sign"] * 9, {"rate": 0.2}),
    (["plus", "up", "left", "right_square_bracket", "0"], {"zoom": 1.0, "x": 0.0, "y": 0.0, "tilt": 0.0}),
]


@on_list(landmark=SCAN)
async def test_a_key_changes_the_wish(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Each time the view is opened again."""
    for keys, changes in WISHES:
        engine_of(app).commands.clear()
        await opened(pilot)
        before = looks(engine_of(app))[-1][1]
        await pilot.press(*keys)
        after = await comes(pilot, viewed())
        assert {name: getattr(after, name) for name in changes} == changes, keys
        others = {name: getattr(before, name) for name in changes}
        assert msgspec.structs.replace(after, **others) == before, keys
        await pilot.press("escape")
        await until(pilot, lambda: app.screen is app.main, "the main screen")


@looking()
async def test_a_held_picture_stays(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed())
    await pilot.press("space")
    await shown(pilot, ViewText.HELD)
    engine = engine_of(app)
    engine.viewing.set_result(viewed(Cells(("another one",))))
    await until(pilot, lambda: "the picture" in text(app) and "another one" not in text(app), "the held picture")
    asked = len(looks(engine))
    await pilot.press("space")
    await until(pilot, lambda: len(looks(engine)) > asked, "a question")
    await comes(pilot, viewed(Cells(("another one",))))
    await shown(pilot, "another one")
    assert ViewText.HELD() not in title(app)


@looking()
async def test_text_and_back(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("t")
    await until(pilot, lambda: isinstance(app.screen, MessageScreen), "the messages as text")
    await until(pilot, engine_of(app).viewing.cancelled, "no question for pictures")
    await pilot.press("t")
    await until(pilot, lambda: isinstance(app.screen, ViewScreen), "the pictures")
    await comes(pilot, viewed())
    await shown(pilot, "the picture")


@on_list(landmark=SCAN)
async def test_topics_of_robot_can_be_laid_over_map(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(
        app,
        route("/map", type_name="nav_msgs/msg/OccupancyGrid"),
        route("/scan"),
        route("/text", type_name="std_msgs/msg/String"),
    )
    await until(pilot, lambda: selected_topic(app) == "/map", "the map under the cursor")
    await pilot.press("v")
    await until(pilot, lambda: looks(engine_of(app)), "a question for a picture")
    assert looks(engine_of(app))[-1][0] == ("/map", "/scan")
    await pilot.press("l")
    await comes(pilot, viewed())
    assert looks(engine_of(app))[-1][0] == ("/map",)
    await pilot.press("l", "h")  # a plot is of one topic
    await comes(pilot, viewed())
    assert looks(engine_of(app))[-1][0] == ("/map",)


@on_list(landmark=SCAN)
async def test_topic_that_is_not_bridged_can_be_chosen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("V")
    await shown(pilot, SUGGESTION.topic)
    await shown(pilot, "the server")  # a client's link has the client's own name
    await pilot.press("enter")
    await until(pilot, lambda: looks(engine_of(app)), "a question for a picture")
    ((topics, _, _), *_) = looks(engine_of(app))
    assert topics == (SUGGESTION.topic,)
    await comes(pilot, viewed())
    await shown(pilot, "the picture")


# -- goals

SCALE = Scale("map", -2.0, 3.0, 0.1, 0.2)
MAP = Cells((" " * 40,) * 20, scale=SCALE)
POSES = route("/robot1/goal_pose", outgoing=True, type_name=POSE)


def goal_of(app: ConsoleApp) -> Goal:
    goal = placing(app)
    assert goal is not None
    return goal


@looking()
async def test_goal_begins_in_middle_and_moves_by_cells(app: ConsoleApp, pilot: Pilot[None]) -> None:
    before = await comes(pilot, viewed(MAP))
    await pilot.press("g")
    column, row = 20, 10
    assert goal_of(app) == Goal.at(SCALE, column, row)
    assert says(title(app), GoalText.PLACE, frame="map")
    await pilot.press("right", "right", "down", "left", "up", "up")
    cell = Goal.at(SCALE, column, row).cell(SCALE)
    assert goal_of(app).cell(SCALE) == (cell[0] + 1, cell[1] - 1)
    after = await comes(pilot, viewed(MAP))
    assert after == before, "the view itself stays"


@looking()
async def test_the_goal_is_marked_with_its_heading(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(MAP))
    await pilot.press("g")
    await pilot.click(PictureTile, offset=(12, 7))
    at = goal_of(app).cell(SCALE)
    assert marked(app) == (at, "→")
    await pilot.press("enter", *["left"] * 6)
    assert marked(app) == (at, "↑")
    assert goal_of(app).heading == pytest.approx(math.pi / 2)
    assert says(title(app), GoalText.HEADING, degrees=90.0)
    await pilot.press("right", "right", "right")
    assert marked(app) == (at, "↗")
    await pilot.click(PictureTile, offset=(20, 9))  # it only turns now
    assert marked(app) == (at, "↗")


def marked(app: ConsoleApp) -> tuple[tuple[int, int], str]:
    """Return the cell of the mark, and the mark."""
    ((at, text_),) = ((number, each) for number, each in enumerate(drawn(app)) if each.strip())
    return (len(text_) - len(text_.lstrip()), at), text_.strip()


@looking()
async def test_a_click_puts_the_goal_into_its_cell(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(MAP))
    await pilot.click(PictureTile, offset=(12, 7))
    assert placing(app) is None, "no goal without its key"
    await pilot.press("g")
    await pilot.click(PictureTile, offset=(12, 7))
    first = goal_of(app).cell(SCALE)
    await pilot.click(PictureTile, offset=(15, 9))
    assert goal_of(app).cell(SCALE) == (first[0] + 3, first[1] + 2)
    pane = screen_of(app).pane
    assert first == (12 - (pane.content_region.x - pane.region.x), 7 - (pane.content_region.y - pane.region.y))


@pytest.mark.parametrize("beside", [(40, 7), (12, 20)])
@looking()
async def test_click_beside_a_small_map_puts_no_goal(
    app: ConsoleApp, pilot: Pilot[None], beside: tuple[int, int]
) -> None:
    """The map fills 40 columns and 20 rows of its tile."""
    await comes(pilot, viewed(MAP))
    await pilot.press("g")
    pane, before = screen_of(app).pane, goal_of(app)
    frame = pane.content_region.offset - pane.region.offset
    await pilot.click(PictureTile, offset=(beside[0] + frame.x, beside[1] + frame.y))
    await notified(pilot, ViewText.OUTSIDE)
    assert goal_of(app) == before
    await pilot.click(PictureTile, offset=(39 + frame.x, 19 + frame.y))
    assert goal_of(app).cell(SCALE) == (39, 19)


@looking()
async def test_escape_drops_only_the_goal(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(MAP))
    for keys in (["g"], ["g", "enter"]):
        await pilot.press(*keys)
        assert goal_of(app)
        await pilot.press("escape")
        assert placing(app) is None
        assert not says(title(app), GoalText.PLACE)
    await pilot.press("enter")  # without a goal it does nothing
    assert isinstance(app.screen, ViewScreen)
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list")


@looking()
async def test_the_form_has_the_goals_pose(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(MAP))
    await pilot.press("g", "right", "enter", *["left"] * 12)
    goal = goal_of(app)
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(app.screen, FormScreen), "the form")
    values = form_of(app).values
    assert (values["topic"], values["type"]) == ("/goal_pose", POSE)
    fields: Any = read_fields(values["message"])
    assert fields["header"] == {"stamp": "now", "frame_id": "map"}
    position, orientation = fields["pose"]["position"], fields["pose"]["orientation"]
    assert float(position["x"]) == pytest.approx(goal.x, abs=1e-3)
    assert float(position["y"]) == pytest.approx(goal.y, abs=1e-3)
    assert (abs(float(orientation["z"])), float(orientation["w"])) == (1.0, 0.0)
    assert not [each for each in engine_of(app).commands if each[0] == "publish"]
    await pilot.press("escape")
    await until(pilot, lambda: isinstance(app.screen, ViewScreen), "the picture")
    assert placing(app) is None


def replace_type(of: RouteSnapshot, type_name: str) -> Topic:
    """Return a route's entry with another type."""
    return msgspec.structs.replace(of.spec, type=type_name)


SIDES: list[tuple[tuple[RouteSnapshot, ...], str]] = [
    ((), "/goal_pose"),
    ((POSES,), "/robot1/goal_pose"),
    ((replace(POSES, outgoing=False),), "/goal_pose"),
    ((replace(POSES, type_name="std_msgs/msg/String"),), "/goal_pose"),
    ((replace(POSES, topic="/robot2/goal_pose", key="2", link="robot2"), POSES), "/robot1/goal_pose"),
    ((replace(POSES, topic="/robot2/goal_pose", key="2", link="robot2"),), "/goal_pose"),
    ((replace(POSES, topic="/start_pose", key="2"), POSES), "/robot1/goal_pose"),
    ((replace(POSES, type_name="", spec=replace_type(POSES, "PoseStamped")),), "/robot1/goal_pose"),
    ((replace(POSES, type_name="", spec=replace_type(POSES, AUTO)),), "/robot1/goal_pose"),
    ((replace(POSES, type_name="", spec=replace_type(POSES, "String")),), "/goal_pose"),
]


@looking()
async def test_goal_goes_to_side_of_map(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for routes, topic in SIDES:
        await comes(pilot, viewed(MAP))
        put(app, route("/robot2/scan"), *routes)
        await pilot.press("g", "enter", "enter")
        await until(pilot, lambda: isinstance(app.screen, FormScreen), "the form")
        assert form_of(app).values["topic"] == topic
        await pilot.press("escape")
        await until(pilot, lambda: isinstance(app.screen, ViewScreen), "the picture")


@looking()
async def test_a_goal_needs_a_map(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for content in (None, CHARACTERS, IMAGE, CURVES):
        if content is not None:
            await comes(pilot, viewed(content))
        await pilot.press("g")
        await notified(pilot, ViewText.NO_MAP)
        assert placing(app) is None
        app.clear_notifications()


@looking()
async def test_other_frame_or_picture_drops_goal(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Its coordinates mean another place there."""
    await comes(pilot, viewed(MAP))
    await pilot.press("g")
    await comes(pilot, viewed(Cells(MAP.rows, scale=msgspec.structs.replace(SCALE, frame="base_link"))))
    await until(pilot, lambda: placing(app) is None, "no goal")
    await pilot.press("g")
    assert goal_of(app).frame == "base_link"
    await pilot.press("h")
    assert placing(app) is None


@looking()
async def test_goal_far_outside_of_picture_is_not_drawn(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(MAP))
    await pilot.press("g")
    near = Scale("map", -1e7, 1e7, 1e-9, 1e-9)
    await comes(pilot, viewed(Cells(MAP.rows, scale=near)))
    await until(pilot, lambda: not "".join(drawn(app)).strip(), "no mark")


@looking(readonly=True)
async def test_read_only_console_sets_no_goal_moves_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route(SCAN), DRIVEN)
    await comes(pilot, viewed(MAP))
    await pilot.press("g", "d")
    assert placing(app) is None
    assert not any(key in text(app) for key in ("g goal", "d drive"))


# -- actions on the robot of the picture

DRIVEN = route(
    "/cmd_vel", outgoing=True, type_name="geometry_msgs/msg/Twist", max_age=0.5, arming=ArmingSnapshot(armed=False)
)


@pytest.mark.skipif("drive" not in BY_ID, reason="the core alone")
@looking()
async def test_action_on_robot_gets_its_topics_only(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route(SCAN), replace(DRIVEN, topic="/robot2/cmd_vel", key="2", link="robot2"))
    await comes(pilot, viewed())
    await pilot.resize_terminal(*WIDE)
    assert "d drive" not in text(app)
    put(app, route(SCAN), DRIVEN)
    await pilot.resize_terminal(*NARROW)
    await shown(pilot, "d drive")
    await pilot.press("d")
    await shown(pilot, "Drive /cmd_vel")


PHOTO = Pixels(2, 2, bytes(12))
CAMERA = "sensor_msgs/msg/Image"


@pytest.mark.skipif("drive" not in BY_ID, reason="the core alone")
@pytest.mark.parametrize("content", [PHOTO, CHARACTERS], ids=["camera", "scan"])
def test_driving_by_camera_locks_with_old_picture(content: Any) -> None:
    @looking()
    async def steps(app: ConsoleApp, pilot: Pilot[None]) -> None:
        app.preferences.features["picture_age"] = 120.0  # more than a slow machine takes for the test
        put(app, route(SCAN), replace(DRIVEN, arming=ArmingSnapshot(armed=True)))
        await comes(pilot, viewed(content, type_name=CAMERA, age=0.1))
        await pilot.press("d")
        await shown(pilot, "no key is held")
        await comes(pilot, viewed(content, type_name=CAMERA, age=500.0))
        await shown(pilot, "locked: the picture is" if content is PHOTO else "no key is held")
        await comes(pilot, viewed(content, type_name=CAMERA, age=0.1))
        await shown(pilot, "no key is held")
        await comes(pilot, viewed(content, type_name=CAMERA, age=None))
        await shown(pilot, "locked: no picture yet" if content is PHOTO else "no key is held")

    steps()


# -- the cursor of a plot

PLOT = Series(0.0, 1.0, (Curve("x", tuple(map(float, range(100))), tuple(map(float, range(100))), 99.0, 50.0),))


@looking()
async def test_the_cursor_of_a_plot_shows_values(app: ConsoleApp, pilot: Pilot[None]) -> None:
    before = await comes(pilot, viewed(PLOT))
    across = before.width - AXIS

    def cursor() -> int | None:
        """Return the column of the line at the cursor, by a row whose curve is elsewhere."""
        rows = drawn(app)
        at = rows[len(rows) // 2].find("│", AXIS)
        return None if at < 0 else at - AXIS

    def legend() -> str:
        return drawn(app)[-1]

    assert cursor() is None
    newest = legend()
    await pilot.press("left")
    assert cursor() == across - 1
    await pilot.press("right")
    assert cursor() == across - 1
    await pilot.press("left", "left")
    assert cursor() == across - 3
    assert f"{(across - 3) * 100 // across}" in legend().split("x", 1)[1]
    send(app, *(Key("left", None) for _ in range(across)))
    await until(pilot, lambda: cursor() == 0, "the first column")
    await pilot.press("0")
    after = await comes(pilot, viewed(PLOT))
    assert (after.x, after.y) == (before.x, before.y), "the view itself stays"
    await until(pilot, lambda: legend() == newest, "the newest value")
    assert cursor() is None


# -- files


@pytest.mark.parametrize(("content", "suffix"), [(IMAGE, ".png"), (CHARACTERS, ".svg"), (CURVES, ".csv")])
@looking()
async def test_a_picture_is_written_to_a_file(
    app: ConsoleApp, pilot: Pilot[None], folder: Path, content: Any, suffix: str
) -> None:
    await pilot.press("p")
    await notified(pilot, ViewText.NO_PICTURE)
    await comes(pilot, viewed(content))
    await until(pilot, lambda: has_picture(app), "the picture")
    await pilot.press("space", "p")  # a held one is written as it is seen
    await notified(pilot, ViewText.WRITTEN)
    file, *drawing = sorted(folder.iterdir())
    assert re.fullmatch(rf"robot2_scan-\d{{8}}-\d{{6}}\{suffix}", file.name)
    assert [each.suffix for each in drawing] == ([".svg"] if suffix == ".png" else [])
    if suffix == ".png":
        assert file.read_bytes().startswith(b"\x89PNG")
    elif suffix == ".svg":
        assert "the picture" in "".join(ElementTree.parse(file).getroot().itertext())
    else:
        assert len([*csv.reader(file.read_text(encoding="utf-8").splitlines())]) == 3


@looking()
async def test_an_image_is_written_in_its_own_resolution(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await comes(pilot, viewed(IMAGE))
    await until(pilot, lambda: has_picture(app), "the picture")
    wish = await written(pilot, viewed(Pixels(640, 480, bytes(3 * 640 * 480))))
    assert (wish.width, wish.height, wish.across) == (MOST_COLUMNS, MOST_ROWS, MOST_ACROSS)
    await notified(pilot, ViewText.WRITTEN)
    file, drawing = sorted(folder.iterdir())
    assert ElementTree.parse(drawing).getroot().tag.endswith("svg")
    assert struct.unpack(">II", file.read_bytes()[16:24]) == (640, 480)
    assert ("end_look",) in engine_of(app).commands


@looking()
async def test_without_full_image_visible_one_is_written(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await comes(pilot, viewed(IMAGE))
    await until(pilot, lambda: has_picture(app), "the picture")
    await written(pilot, EngineError("9 views of this link are open already"))
    await notified(pilot, ViewText.WRITTEN)
    file, drawing = sorted(folder.iterdir())
    assert ElementTree.parse(drawing).getroot().tag.endswith("svg")
    assert struct.unpack(">II", file.read_bytes()[16:24]) == (300, 200)


@looking()
async def test_a_file_that_cannot_be_written_is_reported(
    app: ConsoleApp, pilot: Pilot[None], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise OSError("no space")

    await comes(pilot, viewed())
    await until(pilot, lambda: has_picture(app), "the picture")
    picture_places.VIEW_REPLACE_FILE.set(monkeypatch, fails)
    await pilot.press("p")
    await notified(pilot, ViewText.NOT_WRITTEN, error="no space")
    assert not [*folder.iterdir()]


# -- ages


@looking()
async def test_the_age_of_an_old_picture_grows(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    late = [0.0]
    picture_places.VIEW_TIME.set(monkeypatch, SimpleNamespace(monotonic=lambda: time.monotonic() + late[0]))
    await comes(pilot, viewed(age=0.5))
    await until(pilot, lambda: has_picture(app), "the picture")
    late[0] = 3600.0
    await shown(pilot, ViewText.OLD, age=formats.age(3600.0))
    await comes(pilot, viewed(age=0.5))
    late[0] = 0.0
    await comes(pilot, viewed(age=None))
    assert ViewText.OLD(age="") not in title(app)


# -- problems


@looking()
async def test_a_problem_instead_of_a_picture(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(None, problem="numpy is not installed there"))
    await shown(pilot, "numpy is not installed there")
    assert "numpy is not installed there" in "".join(drawn(app))
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    assert "numpy" not in title(app)
    await comes(pilot, viewed(None, problem="numpy is not installed there"))
    await shown(pilot, "numpy is not installed there")
    assert "the picture" in text(app), "the last picture stays next to the problem"


@looking((80, 24), (120, 36))
async def test_a_title_leaves_out_what_has_no_room(app: ConsoleApp, pilot: Pilot[None]) -> None:
    notes = ("a first note of the picture", "a second note")
    await comes(pilot, viewed(notes=notes, type_name="a_package/msg/WithALongName"))
    await shown(pilot, "a second note")
    assert all(part in title(app) for part in (SCAN, *notes))
    assert "WithALongName" not in title(app)
    assert title(app).strip() in text(app).splitlines()[0]


@looking()
async def test_a_refusal_is_shown_and_asked_again(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    picture_places.VIEW_TRIED_AGAIN_AFTER.set(monkeypatch, 0.0)
    for _ in range(2):
        await comes(pilot, EngineError("no side publishes it \x1b[2J"))
        await shown(pilot, "no side publishes it \\x1b[2J")
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    assert "no side" not in title(app)


WILD = (
    "[/]", "[red]x[/red]", "[@click=app.quit]x[/]", "[", "]", "[link='https://x']a", "\\[b]", '"\\', "[$error]", "{x}",
)  # fmt: skip


@looking((160, 36))
async def test_no_text_of_a_picture_is_markup(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for wild in WILD:
        await comes(pilot, viewed(None, problem=f"{wild} first"))
        await until(pilot, lambda: " first" in title(app), "the problem")
        await comes(pilot, viewed(Cells((f"{wild} picture",)), notes=(f"{wild} note",), type_name=f"{wild} type"))
        await until(pilot, lambda: " first" not in title(app), "the notes")
        escaped = wild.replace("\\", "\\\\").replace('"', '\\"')
        assert f"{escaped} note" in title(app)
        assert f"{escaped} type" in title(app)
        assert f"{wild} picture" in text(app)


@looking()
async def test_a_damaged_image_is_refused_in_words(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(Pixels(8, 8, b"RIFF\0\0\0\0WEBPxxxx", "webp")))
    await until(pilot, lambda: "an image cannot be read" in title(app), "the reason")
    assert "an image cannot be read" in "".join(drawn(app))
    assert "object at" not in title(app)
    await written(pilot, viewed(None, problem="drawing it failed"))
    await notified(pilot, ViewText.NOT_WRITTEN)
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    assert "an image cannot be read" not in title(app)


@looking()
async def test_finer_map_than_was_asked_for_does_not_end_console(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    surroundings.hide_modules(monkeypatch, "PIL")
    await comes(pilot, viewed(Cells(("xx", "xx"), scale=SCALE, fine=2)))
    await until(pilot, lambda: "the picture cannot be drawn" in title(app), "the reason")
    assert "needs Pillow" in "".join(drawn(app))
    await comes(pilot, viewed())
    await shown(pilot, "the picture")
    assert "cannot be drawn" not in title(app)


@looking()
async def test_error_of_drawing_does_not_end_console(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("too much")

    picture_places.IMAGE_OF.set(monkeypatch, fails)
    await comes(pilot, viewed(Cells(("xx", "xx"), fine=2)))
    await until(pilot, lambda: ViewText.NOT_DRAWN(error="too much") in title(app), "the reason")
    await comes(pilot, viewed())
    await shown(pilot, "the picture")


def test_a_hostile_bridge_s_picture_is_refused(machine: Machine) -> None:
    """Any holder of the bridge's socket, or a robot of a fleet, may send anything."""

    class Hostile(LookingEngine):
        def _execute(self, command: Any, step: Any) -> Future[Any]:
            hostile = Viewed(Picture(Pixels(40, 40, b"abc")))
            return answered(hostile) if isinstance(command, LookAtTopics) else super()._execute(command, step)

    machine.serve(Hostile())
    with pytest.raises(EngineError, match=AnswerProblem.INVALID(error="")):
        machine.attach().do(LookAtTopics("me", ("/scan",), Wish())).result(30)


@looking(NARROW)
async def test_a_picture_larger_than_the_pane_is_cut(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await comes(pilot, viewed(Cells(("x" * 400,) * 150)))
    await until(pilot, lambda: has_picture(app), "the picture")
    await shown(pilot, "xxx")
    assert all(len(line) == NARROW[0] for line in text(app).splitlines())
    await comes(pilot, viewed(Pixels(400, 300, (bytes(600) + b"\xff" * 600) * 300)))
    await until(
        pilot, lambda: "xxx" not in text(app) and all(len(line) == NARROW[0] for line in text(app).splitlines()), "it"
    )


def test_the_keys_of_pictures_and_goals_are_listed() -> None:
    listed = " ".join(keys for chapter in LOOK.chapters for keys, _ in chapter.keys).split()
    others = [each.key for each in ON_ROBOT.values()]
    labels = {"plus": "+", "minus": "-", "space": "space", "escape": "esc", "enter": "⏎", "less_than_sign": "<",
              "greater_than_sign": ">", "left_square_bracket": "[", "right_square_bracket": "]", "left": "←",
              "right": "→", "up": "↑", "down": "↓", "equals_sign": "+", "shift+tab": "tab"}  # fmt: skip
    for binding in (*ViewScreen.BINDINGS, *PictureTile.BINDINGS):
        assert isinstance(binding, Binding)
        for each in binding.key.split(","):
            assert labels.get(each, each) in [*listed, *others], each
