"""Tiles of a robot side by side: what is chosen, how they are laid out, which of them cost something, and layouts."""

from __future__ import annotations

import functools
from collections import Counter
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from tests.console.driving import NARROW, WIDE, engine_as, notified, on_main, shown, text, until
from tests.console.scripted import ScriptedEngine, route

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.snapshot import ArmingSnapshot, TopicInfo
from rsb_extras.driving.drive_screen import DriveScreen
from rsb_extras.pictures.layouts import LayoutText, read_layouts, written
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.look_screen import LookScreen
from rsb_extras.pictures.picture import Cells, Picture, Viewed
from rsb_extras.pictures.view_screen import MOST_TILES, TilesText, ViewScreen

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.pilot import Pilot

    from rsb_bridge.model.commands import Command
    from rsb_console.app import ConsoleApp

CAMERA, MAP, ODOMETRY = "/camera/image_raw", "/map", "/odom"
INFOS = tuple(
    TopicInfo(topic, type_name, "", Qos(), 1, 0)
    for topic, type_name in (
        (CAMERA, "sensor_msgs/msg/Image"),
        ("/camera/depth/image", "sensor_msgs/msg/Image"),
        (MAP, "nav_msgs/msg/OccupancyGrid"),
        ("/global_costmap/costmap", "nav_msgs/msg/OccupancyGrid"),
        (ODOMETRY, "nav_msgs/msg/Odometry"),
        ("/chatter", "std_msgs/msg/String"),
    )
)


class TilesEngine(ScriptedEngine):
    """Has a picture of each topic, which names it, and then no further one.

    Attributes:
        open: views that are asked for and not ended, by their first topic.
        questions: for pictures.
    """

    def __init__(self, *session: Any) -> None:
        super().__init__(*session)
        self.open: dict[str, str] = {}
        self.questions: list[LookAtTopics] = []

    def topics(self, link: str | None = None) -> Future[tuple[TopicInfo, ...]]:
        return self._done(INFOS if link is None else (), "topics", link)

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        if isinstance(command, EndLook):
            self.open.pop(command.viewer, None)
            return self._done(None, "end_look")
        if not isinstance(command, LookAtTopics):
            return super()._execute(command, step)
        self.questions.append(command)
        if command.viewer in self.open:
            return Future()  # until it is cancelled
        self.open[command.viewer] = command.topics[0]
        picture = Picture(Cells((f"of {command.topics[0]}",)), messages=1, type_name="a/msg/B")
        return self._done(Viewed(picture, "", 0.1, 100), "look")


on_tiles = functools.partial(on_main, WIDE, make_engine=TilesEngine, landmark="/robot2/scan")


def engine_of(app: ConsoleApp) -> TilesEngine:
    return engine_as(app, TilesEngine)


def screen_of(app: ConsoleApp) -> ViewScreen:
    return next(each for each in app.screen_stack if isinstance(each, ViewScreen))


def in_sight(app: ConsoleApp) -> list[str]:
    return [tile.subject.topics[0] for tile in screen_of(app).tiles if tile.display]


def asked(app: ConsoleApp) -> Counter[str]:
    """Return how many open views there are of each topic."""
    return Counter(engine_of(app).open.values())


async def choose(pilot: Pilot[None], words: str) -> None:
    app: Any = pilot.app
    await pilot.press("V")
    await until(pilot, lambda: isinstance(app.screen, LookScreen), "the list")
    await shown(pilot, CAMERA)
    await pilot.press(*("slash" if each == "/" else "underscore" if each == "_" else each for each in words))
    await pilot.pause()
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(app.screen, ViewScreen), "the tiles")


async def overview(pilot: Pilot[None]) -> None:
    app: Any = pilot.app
    await choose(pilot, "overview")
    await until(pilot, lambda: len(engine_of(app).open) == 3, "three views")


# -- tiles


@on_tiles()
async def test_overview_is_camera_map_speed_rates(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    assert in_sight(app) == [CAMERA, MAP, ODOMETRY, "rates"]
    asked_of_map = next(each for each in engine_of(app).questions if each.topics[0] == MAP)
    assert asked_of_map.topics == (MAP, ODOMETRY)
    assert next(each for each in engine_of(app).questions if each.topics == (ODOMETRY,)).wish.how == "plot"
    for words in (f"of {CAMERA}", f"of {MAP}", f"of {ODOMETRY}", "/robot2/scan"):
        await shown(pilot, words)


@on_tiles()
async def test_nodes_are_a_tile(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "nodes")
    await shown(pilot, "10 nodes, 1 ended, 1 not active")
    worst = [line for line in text(app).splitlines() if "/front/lidar_driver" in line or "/nav/planner_server" in line]
    assert ["lidar" in line for line in worst] == [True, False]
    assert "motor stalled" in worst[0]
    await choose(pilot, CAMERA)
    await pilot.press("z")
    await until(pilot, lambda: in_sight(app) == [CAMERA], "the camera alone")
    assert [tile.is_on for tile in screen_of(app).tiles] == [False, True]


@on_tiles()
async def test_recordings_are_a_tile(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "recordings")
    for words in (
        "robot1-drive",
        "[#.....] 25%, 1.5 MB/s, 84 s left",
        "kept by the server, listed 3 min ago",
        "fault: /scan stopped  184 MB",
        "newest of this side",
        "8.4 MB  noon.mcap  ",
    ):
        await shown(pilot, words)
    told = {str(command[0]) for command in engine_of(app).commands}
    assert {each for each in told if "recordings" in each} == {"newest recordings"}, (
        "the other side is asked for nothing"
    )


@on_tiles()
async def test_tiles_do_not_overlap_and_fill_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    regions = [tile.region for tile in screen_of(app).tiles]
    assert sum(region.area for region in regions) == app.size.area
    assert not any(a.overlaps(b) for at, a in enumerate(regions) for b in regions[at + 1 :])


@on_tiles()
async def test_wish_has_the_size_of_its_tile(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    for tile in screen_of(app).tiles[:3]:
        wanted = tile.size
        await until(
            pilot,
            lambda tile=tile, wanted=wanted: any(
                (each.topics[0], each.wish.width, each.wish.height) == (tile.subject.topics[0], *wanted)
                for each in engine_of(app).questions
            ),
            f"a question of {tile.subject.topics[0]} in {wanted}",
        )


@on_tiles()
async def test_hidden_tiles_cost_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    await pilot.press("tab")
    await pilot.press("z")
    await until(pilot, lambda: asked(app) == {MAP: 1}, "the view of the map alone")
    assert in_sight(app) == [MAP]
    await pilot.press("tab")  # goes on to the next one, which takes its place
    await until(pilot, lambda: asked(app) == {ODOMETRY: 1}, "the view of the speed alone")
    await pilot.press("z")
    await until(pilot, lambda: asked(app) == {CAMERA: 1, MAP: 1, ODOMETRY: 1}, "all views again")


@on_tiles()
async def test_escape_shows_all_before_it_closes(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    await pilot.press("z")
    await until(pilot, lambda: len(in_sight(app)) == 1, "one tile")
    await pilot.press("escape")
    await until(pilot, lambda: len(in_sight(app)) == 4, "all tiles")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list of topics")
    await until(pilot, lambda: not engine_of(app).open, "no view")


@on_tiles()
async def test_closing_and_adding_changes_layout(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    await pilot.press("x")
    await until(pilot, lambda: asked(app) == {MAP: 1, ODOMETRY: 1}, "no view of the camera")
    await choose(pilot, "log")
    await until(pilot, lambda: in_sight(app) == [MAP, ODOMETRY, "rates", "log"], "the log, too")
    await choose(pilot, "depth")
    await until(pilot, lambda: asked(app)["/camera/depth/image"] == 1, "a view of the depth")
    for left in range(4, -1, -1):
        await pilot.press("x")
        await until(pilot, lambda left=left: app.screen is app.main or len(in_sight(app)) == left, "one less")
    assert app.screen is app.main


@on_tiles()
async def test_more_tiles_than_fit_are_refused(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    while len(screen_of(app).tiles) < MOST_TILES:
        count = len(screen_of(app).tiles)
        await choose(pilot, "log")
        await until(pilot, lambda count=count: len(screen_of(app).tiles) > count, "one more tile")
    await choose(pilot, "log")
    await notified(pilot, TilesText.FULL, limit=MOST_TILES)
    assert len(screen_of(app).tiles) == MOST_TILES


@on_tiles()
async def test_small_terminal_shows_one_tile(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    await pilot.resize_terminal(40, 12)
    await until(pilot, lambda: asked(app) == {CAMERA: 1}, "the tile with the focus")
    await shown(pilot, f"of {CAMERA}")
    await pilot.press("tab")
    await until(pilot, lambda: asked(app) == {MAP: 1}, "the next tile")
    await pilot.resize_terminal(*WIDE)
    await until(pilot, lambda: len(engine_of(app).open) == 3, "all tiles")


@on_tiles()
async def test_only_focused_tile_has_keys(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await overview(pilot)
    assert text(app).count("esc ·") == 1
    before = screen_of(app).pane
    await pilot.press("tab")
    await until(pilot, lambda: screen_of(app).pane is not before, "the next tile")
    assert text(app).count("esc ·") == 1
    await pilot.press("plus")
    await until(
        pilot, lambda: any(each.wish.zoom > 1 and each.topics[0] == MAP for each in engine_of(app).questions), "zoom"
    )
    assert not any(each.wish.zoom > 1 and each.topics[0] == CAMERA for each in engine_of(app).questions)


@on_tiles()
async def test_key_lays_costmaps_over_map(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "/map")
    expected = [(MAP, ODOMETRY), (MAP, "/global_costmap/costmap", ODOMETRY), (MAP,)]
    for topics in (*expected, expected[0]):
        await until(pilot, lambda topics=topics: engine_of(app).questions[-1].topics == topics, f"{topics}")
        await pilot.press("l")


# -- the drive box


DRIVEN = route(
    "/cmd_vel", outgoing=True, type_name="geometry_msgs/msg/Twist", max_age=0.5, arming=ArmingSnapshot(armed=True)
)


@pytest.mark.parametrize("size", [WIDE, NARROW, (60, 20)])
def test_drive_box_stands_beside_tiles(size: tuple[int, int]) -> None:
    @on_main(size, make_engine=TilesEngine, landmark="/robot2/scan")
    async def steps(app: ConsoleApp, pilot: Pilot[None]) -> None:
        from tests.console.driving import put

        await choose(pilot, "raw")
        put(app, DRIVEN)
        await pilot.press("d")
        await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the drive box")
        box, screen = app.screen.query_one("#drive"), screen_of(app)
        await until(pilot, lambda: not box.region.overlaps(screen.pane.region), "room for the box")
        assert screen.pane.size.area > 0
        assert box.region.area + screen.pane.region.area >= 0.9 * app.size.area or size == NARROW
        await until(pilot, lambda: box.has_class("-armed"), "the armed topic's border")
        await pilot.press("escape")
        await until(pilot, lambda: screen.pane.region.size == app.size, "the whole screen again")

    steps()


# -- layouts

GIVEN = {
    "drive": [CAMERA, MAP, "rates", "log"],
    "arm": {
        "robots": ["arm*"],
        "tiles": [CAMERA, {"topic": "/joint_states", "as": "plot", "fields": ["position[elbow]"], "seconds": 60.0}],
    },
    "several": [{"topics": [MAP, "/scan"], "frame": "map", "link": "robot1"}],
}


def test_layouts_are_written_as_they_are_read() -> None:
    layouts = read_layouts(GIVEN)
    assert [written(tile) for tile in layouts["drive"].tiles] == GIVEN["drive"]
    assert [written(tile) for tile in layouts["arm"].tiles] == GIVEN["arm"]["tiles"]  # type: ignore[index]
    assert [written(tile) for tile in layouts["several"].tiles] == GIVEN["several"]
    assert layouts["arm"].tiles[1].wish.how == "plot"
    assert layouts["arm"].suits(["arm7"])
    assert not layouts["arm"].suits(["robot1"])
    assert layouts["drive"].suits([])


@pytest.mark.parametrize(
    ("given", "place"),
    [
        (["/map"], "layouts:"),
        ({"a": "/map"}, "layouts.a:"),
        ({"a": []}, "layouts.a:"),
        ({"a": {"tiles": ["/map"], "robot": []}}, "layouts.a:"),
        ({"a": ["/map", {"seconds": 5}]}, "layouts.a.tiles[1]:"),
        ({"a": [{"topic": "/map", "seconds": 0}]}, "layouts.a.tiles[0].seconds:"),
        ({"a": [{"topic": "/map", "zooom": 1}]}, "layouts.a.tiles[0]"),
        ({"a": [{"topics": ["/map", 3]}]}, "layouts.a.tiles[0].topics[1]:"),
        ({"a": [3]}, "layouts.a.tiles[0]"),
    ],
)
def test_mistakes_in_layouts_name_their_place(given: object, place: str) -> None:
    with pytest.raises(ValueError, match="layouts") as refusal:
        read_layouts(given)
    assert str(refusal.value).startswith(place)


def with_layouts() -> dict[str, Any]:
    Path("console.yaml").write_text(f"# mine\nlayouts: {yaml.safe_dump(GIVEN, default_flow_style=True, width=999)}")
    return {"config": Path().resolve()}


@pytest.mark.usefixtures("folder")
@on_tiles(before=with_layouts)
async def test_layout_of_console_yaml_opens(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "drive")
    await until(pilot, lambda: in_sight(app) == GIVEN["drive"], "the tiles of the layout")
    await until(pilot, lambda: asked(app) == {CAMERA: 1, MAP: 1}, "its views")
    assert set(next(each.topics for each in engine_of(app).questions if each.topics[0] == MAP)) > {MAP}


@pytest.mark.usefixtures("folder")
@on_tiles(before=with_layouts)
async def test_tiles_are_kept_as_layout(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "raw")
    await choose(pilot, "rates")
    await pilot.press("w")
    await shown(pilot, "Keep these tiles")
    await pilot.press(*"two", "enter")
    await notified(pilot, TilesText.KEPT, name="two")
    text_of_file = Path("console.yaml").read_text(encoding="utf-8")
    assert text_of_file.startswith("# mine\n")
    kept = yaml.safe_load(text_of_file)["layouts"]
    assert kept == {**GIVEN, "two": [CAMERA, "rates"]} or kept["two"][1] == "rates"
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list of topics")
    await choose(pilot, "two")
    await until(pilot, lambda: in_sight(app) == [CAMERA, "rates"], "the kept tiles")


def test_reason_of_wrong_layouts_says_what_is_right() -> None:
    with pytest.raises(ValueError, match="layouts") as refusal:
        read_layouts(3)
    assert str(refusal.value) == LayoutText.NO_MAPPING()
