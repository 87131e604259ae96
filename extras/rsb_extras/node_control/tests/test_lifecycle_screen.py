"""The screen of managed nodes and groups: its list, a question for each change, its steps, and the way from a node."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from tests.console.driving import NARROW, WIDE, engine_of, gone, notified, on_main, shown, text, until

from rsb_console.notation.side_answer import SideText
from rsb_extras.node_control.change_records import (
    ChangeOutcome,
    ChangeStep,
    Component,
    ListedGroup,
    Managed,
    ManagedNode,
    NodeChange,
)
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged, ManagedSide
from rsb_extras.node_control.lifecycle_rows import LifecycleText
from rsb_extras.node_control.lifecycle_screen import LifecycleScreen, LifecycleScreenText, LifecycleTable
from rsb_extras.node_control.tests.scripted_answers import DONE, SIDES
from rsb_extras.nodes.nodes_screen import NodesScreen

if TYPE_CHECKING:
    import pytest
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


def told(app: ConsoleApp) -> list[tuple[object, ...]]:
    return [command[:4] for command in engine_of(app).commands if command[0] == "change nodes"]


async def opened(pilot: Pilot[None], *down: str) -> None:
    await pilot.press("X")
    await shown(pilot, "1 inactive, 1 unconfigured")
    await pilot.press(*down)


@on_main(WIDE, NARROW)
async def test_nodes_and_groups_are_shown_with_the_last_change(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    lines = [" ".join(line.strip(" │▌").split()) for line in text(app).splitlines()]
    assert "/camera this side active u w d S" in lines
    assert "/controller the server unconfigured no right" in lines
    assert "/nav/planner_server the server inactive u w a n S L" in lines, "a component, too"
    assert "/nav2_container the server 2 components l" in lines
    assert "/nav/smoother_server the server component L" in lines
    assert "/sensors/filter the server component no right" in lines
    assert "nav the server 1 inactive, 1 unconfigured u w" in lines
    assert "esc close" in text(app)
    await pilot.press("j")
    await shown(pilot, "nav of the server: up: /controller refused to configure, and is")
    await until(pilot, lambda: "see its log" in text(app), "the whole reason")
    await shown(pilot, "/nav/planner_server  configure  inactive  1.2 s")
    await pilot.press("escape")
    await gone(pilot, "no right")


@on_main(NARROW)
async def test_a_change_is_asked_first(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "j", "u")
    await shown(pilot, "Up nav of the server?")
    await shown(pilot, "/controller will be active")
    await pilot.press("n")
    await gone(pilot, "Up nav of the server?")
    assert told(app) == []
    await pilot.press("w")
    await shown(pilot, "Down nav of the server?")
    await pilot.press("y")
    await until(pilot, lambda: told(app) == [("change nodes", "nav", "down", "robot1")], "the change")


@on_main(NARROW)
async def test_what_a_node_does_not_offer_is_named(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "c")
    offers = {"name": "/camera", "state": "active", "offers": "deactivate, shutdown"}
    await notified(pilot, LifecycleScreenText.NOT_OFFERED, **offers)
    assert told(app) == []


@on_main(NARROW)
async def test_container_without_states_is_not_brought_up(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    table = app.screen.query_one(LifecycleTable)
    table.move_to(table.keys.index("robot1 /nav2_container"))
    await pilot.press("u")
    await notified(pilot, LifecycleScreenText.NOT_OFFERED, name="/nav2_container", offers="nothing")


@on_main(NARROW)
async def test_without_a_right_nothing_is_asked(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "j", "j", "c")
    await notified(
        pilot, SideText.LACKS, side="the server", act="change /controller", entry="may: {nodes: [/controller]}"
    )
    assert told(app) == []


@on_main(NARROW)
async def test_long_names_and_states_fit(app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"/robot_of_the_west_wing/navigation/{each}_server" for each in ("planner", "controller", "behavior")]
    known = zip(names, ("active", "inactive", "unconfigured"), strict=True)
    nodes = tuple(ManagedNode(name, state, ("activate", "cleanup", "shutdown"), True) for name, state in known)
    outcome = ChangeOutcome(
        is_over=False, seconds=3.0, steps=tuple(ChangeStep(f"/n{each}", "configure") for each in range(20))
    )
    managed = Managed(nodes, (ListedGroup("nav", tuple(names), True),), (NodeChange(names[0], "up", outcome),))
    played = {ListManaged: lambda _: (ManagedSide("robot1", managed),)}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await pilot.press("X")
    await shown(pilot, "u w a n S")
    lines = [line.strip(" │▌").split() for line in text(app).splitlines()]
    keys = [line[-4:] for line in lines if line and "…" in line[0]]
    assert keys == [["up", "under", "way", "-"], *[["w", "a", "n", "S"]] * 2], "of long names"
    await pilot.press("j")
    await shown(pilot, "/n19  configure")  # the newest step


@on_main(NARROW, readonly=True)
async def test_a_read_only_console_only_looks(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "d")
    await notified(pilot, LifecycleScreenText.READ_ONLY)
    assert told(app) == []


@on_main(NARROW)
async def test_a_result_outlives_the_screen(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer: Future[ChangeOutcome] = Future()
    played = {ListManaged: lambda _: SIDES, ChangeNodes: lambda _: answer}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await opened(pilot, "d")
    await shown(pilot, "Deactivate /camera of this side?")
    await pilot.press("y")
    await gone(pilot, "Deactivate /camera of this side?")
    await pilot.press("escape")
    await gone(pilot, "no right")
    answer.set_result(DONE)
    await notified(pilot, LifecycleText.ENDED, target="/camera", side="this side")


@on_main(WIDE)
async def test_a_node_leads_to_its_lifecycle(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("O")
    await shown(pilot, "planner_server")
    nodes = app.screen
    assert isinstance(nodes, NodesScreen)
    await shown(pilot, "x lifecycle")
    while nodes.table.cursor_key != "/nav/planner_server":
        await pilot.press("j")
    await pilot.press("x")
    await until(pilot, lambda: isinstance(app.screen, LifecycleScreen), "the lifecycle")
    screen = app.screen
    assert isinstance(screen, LifecycleScreen)
    await until(pilot, lambda: screen.table.cursor_key == "robot1 /nav/planner_server", "the cursor on the node")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is nodes, "the nodes")
    await pilot.press("question_mark")
    await shown(pilot, "Show its lifecycle, and change it")


def test_each_question_fits() -> None:
    for each in (LifecycleScreenText.RISES, LifecycleScreenText.FALLS, LifecycleScreenText.LOADS):
        assert len(each(nodes="", goal="unconfigured")) <= 2 * 60  # lines of a question


async def to(pilot: Pilot[None], app: ConsoleApp, name: str) -> None:
    screen = app.screen
    assert isinstance(screen, LifecycleScreen)
    wanted = f"robot1 {name}"
    await until(pilot, lambda: wanted in screen.table.keys, "the row")
    screen.table.move_to(screen.table.keys.index(wanted))


def changed(app: ConsoleApp) -> list[tuple[Any, ...]]:
    return [command[1:] for command in engine_of(app).commands if command[0] == "change nodes"]


@on_main(WIDE)
async def test_a_component_is_loaded_after_a_form_and_a_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    await to(pilot, app, "/nav/smoother_server")
    await pilot.press("l")
    await notified(pilot, LifecycleScreenText.NO_CONTAINER, name="/nav/smoother_server")
    await to(pilot, app, "/nav2_container")
    await pilot.press("l")
    await shown(pilot, "Load into /nav2_container")
    await pilot.press(*"nav2_route", "tab", *"nav2::Route", "tab", "tab", "tab", *"rate:=x:=y; depth")
    await shown(pilot, "depth is no rule: write name:=value")
    await pilot.press(*":=2", "tab", "tab", "tab", "enter")
    await shown(pilot, "Load nav2::Route into /nav2_container of the server?")
    await pilot.press("y")
    await until(pilot, lambda: len(changed(app)) == 1, "the change")
    ((_, _, _, values, component),) = changed(app)
    assert component == Component("nav2_route", "nav2::Route")
    assert [(each.name, each.value.plain()) for each in values] == [("rate", "x:=y"), ("depth", 2)]


@on_main(NARROW)
async def test_a_component_is_unloaded_after_a_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    await to(pilot, app, "/nav/smoother_server")
    await pilot.press("L")
    await shown(pilot, "Unload /nav/smoother_server of the server?")
    await pilot.press("y")
    await until(pilot, lambda: len(changed(app)) == 1, "the change")
    ((target, action, _, _, component),) = changed(app)
    assert (target, action, component.name) == ("/nav2_container", "unload", "/nav/smoother_server")
    await to(pilot, app, "/sensors/filter")
    await pilot.press("L")
    await notified(pilot, SideText.LACKS, side="the server", act="change /sensors", entry="may: {nodes: [/sensors]}")
