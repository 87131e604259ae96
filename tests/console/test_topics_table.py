"""The table of topics, key by key: cursor, order, filter."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from tests.console.driving import NARROW, fill, gone, listed, on_main, put, selected_topic, shown, until
from tests.console.scripted import FAULTY, LINK, NOW, ROUTES, ScriptedEngine, route
from textual.pilot import Pilot

from rsb_bridge.model.commands import AddTopic, Command, R
from rsb_bridge.model.snapshot import RouteSnapshot, State
from rsb_bridge.model.verdict import Cause
from rsb_console.app import ConsoleApp
from rsb_console.widgets.filter import PatternProblem


@on_main()
async def test_cursor_begins_with_worst_and_stays(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/worse", State.DOWN), *ROUTES)
    assert selected_topic(app) == "/robot2/scan"  # /worse sorts behind it
    put(app, route("/a/worse", State.DOWN), *ROUTES)
    assert selected_topic(app) == "/a/worse"
    await pilot.press("j")
    put(app, route("/a/a/worse", State.DOWN), *ROUTES)
    assert selected_topic(app) == "/robot2/scan"
    put(app, *(r for r in ROUTES if r.topic != "/robot2/scan"))
    assert app.main.topics.selected is not None


@on_main(NARROW)
async def test_a_name_gets_the_room_of_the_history(app: ConsoleApp, pilot: Pilot[None]) -> None:
    widths = []
    for name in "/scan", "/robot1/goal_pose", "/robot1/left/goal_pose", "/robot1/left/front/goal_pose":
        put(app, route(name))
        await shown(pilot, f" {name} " if len(name) < 22 else "_pose ")
        widths.append({column.title: width for column, width in app.main.topics.columns}.get(" HISTORY", 0))
    assert widths == [13, 12, 8, 8]


@on_main(NARROW)
async def test_narrow_table_tells_what_waits_for_link(app: ConsoleApp, pilot: Pilot[None]) -> None:
    away = replace(LINK, state=State.DOWN, association_ends=NOW + 47)
    rows: dict[str, dict[str, Any]] = {
        "/alarms": {"state": State.DOWN, "cause": Cause.LINK_DOWN, "reason": "waiting 13 s, 612 kept"},
        "/odom": {
            "state": State.DOWN,
            "cause": Cause.LINK_DOWN,
            "reason": "waiting 13 s, 100 kept, 2,412,118 older dropped",
        },
        "/map": {"cause": Cause.CATCHING_UP, "reason": "catching up, 412 left"},
        "/scan": {"reason": "fine"},
    }

    def lines() -> dict[str, str]:
        table = app.main.topics
        return {key: "".join(piece for piece, _ in table.row_line(key, cursor=False)) for key in table.keys}

    put(app, *(route(name, **changes) for name, changes in rows.items()), links=(away,))
    await shown(pilot, "waiting 13 s, 612 kept")
    shown_lines = lines()
    assert "waiting 13 s, 100 kept, 2,412,118 older" in shown_lines["/odom"]
    assert shown_lines["/odom"].rstrip().endswith("…")
    assert "catching up, 412 left" in shown_lines["/map"]
    assert "fine" not in shown_lines["/scan"]
    assert len({len(line) for line in shown_lines.values()}) == 1
    put(app, links=(replace(away, association_ends=None),))  # nothing waits for it any more
    assert "612" not in lines()["/alarms"]
    assert "412 left" in lines()["/map"]


class Adding(ScriptedEngine):
    """An engine that shows what is added."""

    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        if isinstance(command, AddTopic):
            self.now = replace(self.now, routes=(*self.now.routes, route(command.topic.topic)))
        return super().do(command, step)


@on_main(make_engine=Adding)
async def test_what_was_added_gets_the_cursor(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "Direction")
    await fill(pilot, topic="/new")
    await pilot.click("#yes")
    await until(pilot, lambda: selected_topic(app) == "/new", "the cursor")


@on_main()
async def test_moving(app: ConsoleApp, pilot: Pilot[None]) -> None:
    table = app.main.topics
    for key, position in (
        ("j", 1),
        ("down", 2),
        ("k", 1),
        ("G", 7),
        ("g", 0),
        ("pagedown", 7),
        ("pageup", 0),
        ("up", 0),
    ):
        await pilot.press(key)
        assert table.position == position, key


@on_main()
async def test_five_hundred_topics_scroll_and_the_heading_stays(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *(route(f"/t{i:03d}") for i in range(500)))
    await pilot.press("G")
    await shown(pilot, "/t499  ")
    await gone(pilot, "/t000")
    await shown(pilot, "STATE▼")
    table = app.main.topics
    await until(pilot, lambda: table.scroll_offset.y == 500 - table.page, "the last one in the last line")
    await pilot.press("g")
    await shown(pilot, "/t000")


@on_main()
async def test_cursor_is_visible_after_list_has_grown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The key came before the refresh that makes the scrollbar."""
    put(app, *(route(f"/t{i:03d}") for i in range(500)))
    app.main.topics.action_move_last()
    await shown(pilot, "/t499  ")
    await gone(pilot, "/t000")
    put(app, *(route(f"/s{i:03d}") for i in range(100)), *(route(f"/t{i:03d}") for i in range(500)))
    await shown(pilot, "/t499  ")


@on_main()
async def test_sorting(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("greater_than_sign")
    assert listed(app) == sorted(listed(app))
    await pilot.press("s")
    assert listed(app) == sorted(listed(app), reverse=True)
    await pilot.press("s", "greater_than_sign", "greater_than_sign")
    rates = [route.rate for route in app.main.topics.listed if isinstance(route, RouteSnapshot)]
    assert rates == sorted(rates, reverse=True)
    await pilot.press("less_than_sign", "less_than_sign", "less_than_sign")
    assert listed(app)[:2] == FAULTY


@on_main()
async def test_click_on_heading_sorts_and_reverses(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.click("#topics", offset=(12, 1))
    assert listed(app) == sorted(listed(app))
    await pilot.click("#topics", offset=(12, 1))
    assert listed(app) == sorted(listed(app), reverse=True)


@on_main()
async def test_click_moves_cursor_and_another_one_opens(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.click("#topics", offset=(12, 3))
    assert selected_topic(app) == "/robot1/map"
    await pilot.click("#topics", offset=(12, 3))
    assert app.main.detail.has_focus


@on_main()
async def test_filtering_as_it_is_typed(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("slash", *"/scan$")
    await until(pilot, lambda: listed(app) == ["/robot2/scan", "/robot1/scan"], "both scans")
    await pilot.press("enter")
    await shown(pilot, "Topics ▸ //scan$ ▸ 2 of 8")
    await pilot.press("n")
    assert selected_topic(app) == "/robot1/scan"
    await pilot.press("escape")
    assert len(listed(app)) == 8


@on_main()
async def test_invalid_regular_expression_is_refused_in_words(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("slash", *"/scan(")
    await shown(pilot, PatternProblem.NO_REGEX)
    assert listed(app) == ["/robot2/scan", "/robot1/scan"]
    await pilot.press("escape")
    await until(pilot, lambda: not app.main.prompt.display, "the prompt closed")
    assert len(listed(app)) == 8


@on_main()
async def test_faults_only_and_from_fault_to_fault(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("n")
    assert selected_topic(app) == "/robot1/map"
    await pilot.press("n")
    assert selected_topic(app) == "/robot2/scan"
    await pilot.press("f")
    assert listed(app) == FAULTY
    await shown(pilot, "faults only ▸ 2 of 8")
    put(app, *ROUTES, route("/worse", State.DOWN))
    await shown(pilot, "faults only ▸ 3 of 9")
    await pilot.press("f")
    assert len(listed(app)) == 9


@on_main()
async def test_servers_links_are_counted_and_peers_have_column(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.resize_terminal(150, 36)
    other = replace(LINK, name="robot2", state=State.DOWN)
    put(app, *ROUTES, route("/scan", key="2", link="robot2"), links=(LINK, other), role="server")
    await shown(pilot, "✗ 1 of 2 linked")
    await shown(pilot, "PEER")
    await pilot.press("slash", *"robot2", "enter")
    await until(pilot, lambda: listed(app) == ["/robot2/scan", "/scan"], "what concerns robot2")
