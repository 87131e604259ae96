"""Patterns among the topics: their rows, their details, and what is asked before one is removed."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.console.driving import engine_of, gone, listed, on_main, put, shown, until
from tests.console.scripted import LINK, ROUTES, route
from textual.pilot import Pilot

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PatternSnapshot, State
from rsb_console.app import ConsoleApp
from rsb_console.notation.formats import pattern_rows
from rsb_console.session.exports import export_topics
from rsb_console.widgets.fault_pane import faults_of
from rsb_console.widgets.topics import COLUMNS

SPEC = Topic("/aa/**", "transmit", remote_topic="/robot1/**", excepts=("/aa/raw",))
KEY = "key of /aa/**"


def with_pattern(app: ConsoleApp, state: State = State.DOWN, **changes: Any) -> None:
    """The next snapshot has a pattern, with a route that it has made."""
    told: dict[str, Any] = {
        "spec": SPEC,
        "reason": "20 more match",
        "here": True,
        "source": "/aa/**",
        "routes": 3,
    } | changes
    link = replace(LINK, patterns=(PatternSnapshot(key=KEY, link=LINK.name, state=state, **told),))
    put(app, route("/aa/scan", State.DOWN, reason="of a test", pattern="/aa/**"), *ROUTES, links=(link,))


@on_main()
async def test_pattern_has_row_and_counts_as_no_topic(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    assert listed(app)[:2] == ["/aa/**", "/aa/scan"]
    await shown(pilot, "3 names")
    await shown(pilot, f"{len(ROUTES) + 1} topics")
    await shown(pilot, "there       /robot1/**")
    await shown(pilot, "/aa/raw")
    assert next(fault.name for fault in faults_of(app.snapshot())) == "/aa/**"
    await pilot.press("j")
    await shown(pilot, "matches /aa/**")


@on_main()
async def test_the_filter_finds_what_a_pattern_has_made(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    await pilot.press("slash", *"aa/**", "enter")
    await until(pilot, lambda: listed(app) == ["/aa/**", "/aa/scan"], "the pattern and its route")


@on_main()
async def test_removing_pausing_and_editing_are_about_the_pattern(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    engine = engine_of(app)
    await pilot.press("p")
    await until(pilot, lambda: ("pause", KEY, True) in engine.commands, "a pause")
    await pilot.press("e")
    await shown(pilot, "Edit /aa/**")
    await shown(pilot, "/aa/raw")
    await pilot.press("escape")
    await pilot.press("d")
    await shown(pilot, "Remove /aa/**?")
    await pilot.press("y")
    await until(pilot, lambda: ("remove", KEY) in engine.commands, "the removal")


@on_main()
async def test_a_pattern_has_no_messages(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app, State.OK)
    engine_of(app).commands.clear()
    while app.main.topics.selected is None or app.main.topics.selected.topic != "/aa/**":
        await pilot.press("j")
    await pilot.press("v")
    await shown(pilot, "is a pattern")
    assert engine_of(app).commands == []


@on_main()
async def test_a_pattern_has_no_figures(
    app: ConsoleApp, pilot: Pilot[None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes last where a figure sorts the table, and an export leaves the figures empty."""
    monkeypatch.chdir(tmp_path)
    with_pattern(app)
    await until(pilot, lambda: "/aa/**" in listed(app), "the pattern")
    app.main.topics.order.column = next(column for column in COLUMNS if column.title == "HZ/EXP")
    app.main.topics.relist()
    assert listed(app)[-1] == "/aa/**"
    rows = list(csv.DictReader(export_topics(app.main.topics.listed).read_text().splitlines()))
    assert [rows[-1][name] for name in ("topic", "outgoing", "rate", "bytes_per_second", "offered")] == [
        "/aa/**", "True", "", "", ""
    ]  # fmt: skip
    assert all(row["rate"] for row in rows[:-1])


@on_main()
async def test_its_keys_show_where_row_is_single(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    await pilot.press("slash", *"name:nothing", "enter")
    await gone(pilot, "d remove")
    await pilot.press("slash", "ctrl+u", *"aa/**", "enter")
    await shown(pilot, "d remove")


def test_topics_of_one_direction_sort_together() -> None:
    way = next(column for column in COLUMNS if column.title == "VIA")
    ways = [("bluetooth", 10), ("tcp", 9003), ("tcp", 9001), ("bluetooth", 2), ("tcp", 9003)]
    rows = sorted((route("/a", transport=name, port=port) for name, port in ways), key=way.order)
    assert [row.port for row in rows] == [2, 10, 9001, 9003, 9003]


@on_main()
async def test_a_link_shows_its_own_patterns_only(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    put(app, links=(*app.snapshot().links, replace(LINK, name="robot2")))
    await pilot.press("c", "j", "enter")
    await shown(pilot, "Link robot2")
    await shown(pilot, "Nothing is bridged over this link.")


@on_main()
async def test_both_names_belong_to_their_sides(app: ConsoleApp, pilot: Pilot[None]) -> None:
    with_pattern(app)
    now = app.snapshot()
    (row,) = pattern_rows(now)
    assert (row.topic, row.remote_topic, row.outgoing) == ("/aa/**", "/robot1/**", True)
    (row,) = pattern_rows(replace(now, role="server"))
    assert (row.topic, row.remote_topic, row.outgoing) == ("/aa/**", "/aa/**", False)
    with_pattern(app, here=False, source="/robot1/**", spec=Topic("/**", "receive"))
    (row,) = pattern_rows(app.snapshot())
    assert (row.topic, row.remote_topic, row.outgoing) == ("/**", "/robot1/**", False)
