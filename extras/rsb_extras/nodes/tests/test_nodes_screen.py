"""The screen of nodes: its tree, its filter, a node's page, and the ways to topics and from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.console.driving import NARROW, WIDE, gone, on_main, selected_topic, shown, text, until

from rsb_console.screens.links_screen import LinksScreen
from rsb_extras.nodes.nodes_screen import NodesScreen

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


def rows(app: ConsoleApp) -> list[str]:
    return [line.strip(" │") for line in text(app).splitlines()]


@on_main(WIDE, NARROW)
async def test_faults_come_first_and_namespaces_without_any_are_folded(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("O")
    await shown(pilot, "10 nodes, 1 ended, 1 not active")
    await shown(pilot, "ERROR 41 s ago: motor stalled")
    tree = rows(app)
    places = [
        next(number for number, row in enumerate(tree) if word in row)
        for word in (
            "raspi",
            "▾ /front",
            "✗ lidar_driver  ended 40 s ago",
            "▸ /cameras  9 nodes",
            "host 78fd",
            "inactive",
        )
    ]
    assert places == sorted(places)
    await pilot.press("escape")
    await gone(pilot, "▸ /cameras")


@on_main(NARROW)
async def test_namespace_unfolds_and_faults_and_filters_choose(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("O")
    await shown(pilot, "▸ /cameras  9 nodes")
    screen = app.screen
    assert isinstance(screen, NodesScreen)
    while screen.table.cursor_key != "raspi\n/cameras":
        await pilot.press("j")
    await pilot.press("enter")
    await shown(pilot, "camera_3  42 %, 310 MB, 61 threads with 8 other nodes")
    await pilot.press("f")
    await gone(pilot, "camera_3")
    await shown(pilot, "lidar_driver")
    await pilot.press("escape", "slash", *"planner", "enter")
    await gone(pilot, "lidar_driver")
    await shown(pilot, "planner_server")
    await pilot.press("escape")
    await shown(pilot, "lidar_driver")


@on_main(WIDE)
async def test_topic_leads_to_its_node_and_node_to_its_topics(app: ConsoleApp, pilot: Pilot[None]) -> None:
    while selected_topic(app) != "/robot1/scan":
        await pilot.press("j")
    await pilot.press("O")
    await shown(pilot, "lidar_driver")
    screen = app.screen
    assert isinstance(screen, NodesScreen)
    await until(pilot, lambda: screen.table.cursor_key == "/front/lidar_driver", "the cursor on its node")
    await pilot.press("enter")
    await shown(pilot, "/scan  sensor_msgs/msg/LaserScan")
    await shown(pilot, "WARN 60 s ago: motor is hot")
    await pilot.press("t")
    names = {"/robot1/scan", "/robot2/scan"}  # either may be the node's /scan, with a prefix
    await until(pilot, lambda: {row.topic for row in app.main.topics.listed} == names, "its topics alone")


@on_main(WIDE)
async def test_list_of_links_leads_to_topics_of_a_node(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("c")
    await until(pilot, lambda: isinstance(app.screen, LinksScreen), "the links")
    await pilot.press("O")
    await shown(pilot, "lidar_driver")
    screen = app.screen
    assert isinstance(screen, NodesScreen)
    while screen.table.cursor_key != "/front/lidar_driver":
        await pilot.press("j")
    await pilot.press("question_mark")
    await shown(pilot, "Show its topics in the table of topics")
    await pilot.press("escape", "t")
    await until(pilot, lambda: app.screen is app.main, "the table of topics")
    await until(pilot, lambda: all("scan" in row.topic for row in app.main.topics.listed), "its topics alone")


@on_main(NARROW)
async def test_next_side_is_this_one(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("O")
    await shown(pilot, "lidar_driver")
    await pilot.press("s")
    await shown(pilot, "this side")
