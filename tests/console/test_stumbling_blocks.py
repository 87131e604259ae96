"""Operators' difficulties: lost forms, misleading figures, and functions that were hard to find."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    AppSteps,
    engine_of,
    fill,
    form_of,
    gone,
    listed,
    on_main,
    put,
    shown,
    text,
    until,
)
from tests.console.scripted import LINK, SESSION, refused, route
from textual.pilot import Pilot

from rsb_bridge.config.session_file import save
from rsb_bridge.model.commands import AddTopic
from rsb_bridge.model.snapshot import State
from rsb_console.app import ConsoleApp
from rsb_console.notation.ascii_signs import to_ascii
from rsb_console.screens.new_session import FIELDS
from rsb_console.widgets.controls import Choice
from rsb_console.widgets.filter import RowFilter
from rsb_console.widgets.topics import TopicsTable


def test_chosen_and_unchosen_differ_in_ascii() -> None:
    options = next(spec.options for spec in FIELDS if spec.key == "role")
    chosen, other = (to_ascii(piece)[0] for piece in Choice(options)._pieces())
    assert chosen != other


@on_main()
async def test_refused_topic_returns_with_values_and_reason(app: ConsoleApp, pilot: Pilot[None]) -> None:
    why = "robot1 does not allow /added"
    engine_of(app).answering = lambda command: refused(why) if isinstance(command, AddTopic) else None
    await pilot.press("a")
    await shown(pilot, "Add a topic")
    await fill(pilot, topic="/added", max_rate="7")
    form_of(app).fields["max_rate"].control.focus()
    await pilot.press("enter")
    await shown(pilot, "robot1 does not allow /added")
    values = form_of(app).values
    assert (values["topic"], values["max_rate"]) == ("/added", "7")


def two_files() -> dict[str, Any]:
    save(SESSION, Path("nav2.yaml"))
    save(msgspec.structs.replace(SESSION, name="other"), Path("other.yaml"))
    return {"path": Path("nav2.yaml").resolve()}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("dialog", ["open", "new", "save as"])
@on_main(before=two_files)
async def test_no_leads_back_to_the_dialog_that_asked(app: ConsoleApp, pilot: Pilot[None], dialog: str) -> None:
    keys, words, values, question = {
        "open": ("o", "Sessions", {"path": "./other.yaml"}, "Run other.yaml instead?"),
        "new": ("f2", "New session", {"name": "robot7", "server_ip": "10.0.0.20"}, "Run robot7.yaml instead?"),
        "save as": ("W", "Save as", {"path": "other.yaml"}, "Overwrite other.yaml?"),
    }[dialog]
    await pilot.press(keys)
    await shown(pilot, words)
    await fill(pilot, **values)
    await pilot.press("enter")
    await shown(pilot, question)
    await shown(pilot, "n no")  # the keys of the answers
    await pilot.press("n")
    await gone(pilot, question)
    await until(pilot, lambda: app.screen is not app.main, "the dialog")
    await shown(pilot, words)
    assert form_of(app).values.items() >= {key: value.removeprefix("./") for key, value in values.items()}.items()


@on_main(session=msgspec.structs.replace(SESSION, use_name=True))
async def test_prefixed_name_on_server_is_not_called_same(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).now = replace(engine_of(app).now, links=(replace(LINK, use_name=True),))
    await pilot.press("a", "f8")  # the name there is among the further fields
    await shown(pilot, "/robot1 and its name")
    await gone(pilot, "same name")


COLUMNS = {"topic": "/robot1/scan", "robot": "robot1", "state": "DOWN", "type": "sensor_msgs/msg/LaserScan", "why": ""}


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        ("state:down", True),
        ("state:ok", False),
        ("robot:robot1 state:down", True),
        ("robot:robot2 state:down", False),
        ("type:LaserScan scan", True),
        ("type:scan /odom", False),
        ("laserscan", True),
        ("^/robot1/scan$", True),
        ("!state:down", False),
        ("!state:ok scan", True),
        ("topic:scan$", True),
        ("state:", True),
        ("mystate:ok", False),
        ("scan !odom", True),
        ("scan !robot1", False),
        ("!odom", True),
        ("!scan", False),
        ("scan robot1 laser", True),
        ("scan robot2", False),
        ("state:down !type:laser", False),
        ("state:down !state:ok !/odom", True),
        ("^/robot1 !scan$", False),
        ("! scan !", True),
        ("!", True),
    ],
)
def test_filter_looks_in_named_column_or_all(typed: str, found: bool) -> None:
    assert RowFilter(typed).matches(COLUMNS) is found


@on_main()
async def test_the_topics_of_a_robot_stand_together(app: ConsoleApp, pilot: Pilot[None]) -> None:
    topics = [(link, number, state) for number, state in ((1, State.OK), (2, State.DOWN)) for link in "ba"]
    put(
        app,
        *(route(f"/{link}/{number}", link=link, state=state) for link, number, state in topics),
        links=(replace(LINK, name="a"), replace(LINK, name="b")),
    )
    assert listed(app) == ["/a/2", "/b/2", "/a/1", "/b/1"]
    await pilot.press("B")
    await until(pilot, lambda: listed(app) == ["/a/2", "/a/1", "/b/2", "/b/1"], "two groups")
    await shown(pilot, "Topics by robot")
    await pilot.press("B")
    await until(pilot, lambda: listed(app)[:2] == ["/a/2", "/b/2"], "none")


@on_main(NARROW)
async def test_page_of_a_link_with_many_facts_keeps_its_keys(app: ConsoleApp, pilot: Pilot[None]) -> None:
    down = replace(LINK, state=State.DOWN, reason="the server does not answer " * 12, next_fingerprint="1 2 3 4")
    put(app, *(route(f"/{number}", link="robot1") for number in range(20)), links=(down,))
    await pilot.press("c", "enter")
    await shown(pilot, "Link robot1")
    await until(pilot, lambda: "esc close" in text(app) and "next key" in text(app), "the keys")


@on_main()
async def test_enter_on_link_shows_it_with_its_topics(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/a", link="robot1"), route("/b", link="robot2"), links=(LINK, replace(LINK, name="robot2")))
    await pilot.press("c", "enter")
    await shown(pilot, "Link robot1")
    dialog = text(app).partition("Link robot1")[2]
    assert "its clock" in dialog
    assert app.screen.query_one("#topics", TopicsTable).keys == ["/a"]
    await pilot.press("escape")
    await gone(pilot, "Link robot1")
    await shown(pilot, "⏎ detail")


@pytest.mark.parametrize("words", ["limit", "bandwidth"])
@on_main()
async def test_the_palette_finds_how_to_limit_a_topic(app: ConsoleApp, pilot: Pilot[None], words: str) -> None:
    await pilot.press("colon", *words)
    await shown(pilot, "Edit the topic")


def wide_screen(size: tuple[int, int]) -> AppSteps:
    async def steps(app: ConsoleApp, pilot: Pilot[None]) -> None:
        assert app.main.detail.size.width >= (60 if size[0] >= 200 else 36)
        assert ("TOTAL" in text(app)) is (size[0] >= 200)
        app.notify("a message")
        await shown(pilot, "a message")
        rows = text(app).splitlines()
        at = next(number for number, row in enumerate(rows) if "a message" in row)
        log = app.main.log_pane.region.y
        last = max(number for number, row in enumerate(rows[:log]) for topic in listed(app) if topic in row)
        assert last < at < log, "below the topics, and over no line of the log"

    return steps


test_a_wide_screen_gives_the_details_room = on_main((200, 50))(wide_screen((200, 50)))
test_messages_cover_no_topic = on_main((120, 36))(wide_screen((120, 36)))
