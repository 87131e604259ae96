"""The fleet's screen: the worst first, groups, marks, and a change for several robots."""

from __future__ import annotations

import asyncio
import gc
import os
import re
import shutil
import sys
import weakref
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    WIDE,
    Decorator,
    Operator,
    as_test,
    ended,
    notices,
    settled,
    shown,
    text,
    until,
)
from tests.console.scripted import NOW, SESSION, ScriptedEngine
from tests.console.tmux import Tmux
from tests.model.robot_summary_helpers import a, on_server
from tests.support import surroundings
from tests.support.fleet import ServerEngine, robot, topics
from tests.support.long import long
from tests.support.waiting import eventually
from textual.pilot import Pilot
from textual.widgets import Input

from rsb_bridge.model.robot_summary import Battery, LostMessages, RobotState
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Acknowledgement, State
from rsb_bridge.model.verdict import Cause
from rsb_console.actions.action import Group
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.widgets.bars import state_counts
from rsb_extras.fleet.fleet_actions import FLEET_ACTIONS
from rsb_extras.fleet.fleet_app import FleetApp, RobotApp
from rsb_extras.fleet.fleet_table import FleetView
from rsb_extras.fleet.rolling import Bridged
from rsb_extras.fleet.rollout import ChangeField, RolloutPhase, RolloutScreen, _key_line
from rsb_extras.fleet.rollout import _now as present_values
from rsb_extras.fleet.server_source import ServerFleet
from rsb_extras.fleet.tests import fleet_places
from rsb_extras.fleet.tests.scripted_fleet import ScriptedSource, fleet_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from pathlib import Path

    from tests.support.control import Machine

    from rsb_extras.fleet.rolling import RobotChange

SILENT = robot(
    "robot2", RobotState.MISSING, why="cable pulled", seen=NOW - 600, since=NOW - 600, links_up=0, flowing=0,
    group="yard",
)  # fmt: skip
STALE = robot(
    "robot11", RobotState.FAULT, why="/scan STALE: nothing for 15 s", flowing=2, group="hall",
    loss=LostMessages(0.12, 60.0), battery=Battery(0.14, NOW - 20),
)  # fmt: skip
ROBOTS = (
    robot("robot1", group="hall", battery=Battery(0.8, NOW - 5), loss=LostMessages(0.0, 60.0)), SILENT,
    robot("robot3", RobotState.WARN, why="/camera SLOW: 5 Hz of 30", group="hall", loss=LostMessages(0.004, 60.0)),
    robot("robot4", RobotState.WAITING, why="not connected yet", seen=None, links_up=0, flowing=0, version=""), STALE,
    robot("robot12", group="yard", version="0.2.0"),
)  # fmt: skip


def change_of(screen: RolloutScreen) -> ChangeField:
    return screen.query_one(ChangeField)


class Bed:
    """The fleet's screen without a terminal."""

    def __init__(self, *robots: Any, view: FleetView | None = None, **options: Any) -> None:
        self.source = ScriptedSource(*(robots or ROBOTS))
        self.fleet = fleet_of(self.source)
        self.view = view or FleetView()
        self.app = FleetApp(self.fleet, self.view, **{"theme": "dark", **options})
        self.pilot: Pilot[Any] = Operator(self.app)

    @property
    def listed(self) -> list[str]:
        """The names on the screen, of robots and, in brackets, of groups."""
        rows = self.app.main.table.rows
        return [rows[key].robot.summary.name if key in rows else f"[{key[1:]}]" for key in self.app.main.table.keys]

    @property
    def cursor(self) -> str:
        robot = self.app.main.table.selected
        return "" if robot is None else robot.summary.name

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)

    async def shown(self, words: str) -> None:
        await shown(self.pilot, words)

    async def until(self, condition: Callable[[], object], what: str) -> None:
        await until(self.pilot, condition, what)

    def run(self, steps: Callable[[Bed], Awaitable[None]], size: tuple[int, int] = NARROW) -> None:
        async def run() -> None:
            async with self.app.run_test(size=size, notifications=True):
                await until(self.pilot, lambda: self.app.main.table.rows, "robots")
                await steps(self)

        asyncio.run(run())


def on_fleet(make: Callable[[], Bed] = Bed, size: tuple[int, int] = NARROW) -> Decorator:
    """A test's steps run once the fleet's screen has its robots."""

    def decorate(steps: Callable[..., Awaitable[None]]) -> Callable[..., None]:
        return as_test(lambda **fixtures: make().run(lambda bed: steps(bed, **fixtures), size), steps, "bed")

    return decorate


@pytest.fixture(autouse=True)
def _now(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of the script."""
    surroundings.set_wall_clock(monkeypatch, lambda: NOW)


def test_every_action_has_handler_and_own_keys() -> None:
    app = Bed().app
    for action in FLEET_ACTIONS:
        owner: object = {Group.MOVE: app.main.table, Group.CONSOLE: app}.get(action.group, app.main)
        assert callable(getattr(owner, f"action_{action.id}"))
    keys = [key for action in FLEET_ACTIONS for key in action.keys.split(",")]
    assert len(set(keys)) == len(keys)


@on_fleet()
async def test_the_worst_first_and_why(bed: Bed) -> None:
    assert bed.listed == ["robot2", "robot11", "robot3", "robot4", "robot1", "robot12"]
    await bed.shown("cable pulled")
    await bed.press("j")
    await bed.shown("/scan STALE")
    await bed.shown("lost 12% in 60 s")
    await bed.shown("battery 14%")


def test_what_crosses_link_is_counted_at_one_end() -> None:
    async def steps(bed: Bed) -> None:
        (first, *_) = text(bed.app).splitlines()
        assert "from 300 kB/s │ to 4.0 kB/s" in first
        assert " 1 robot " in first
        assert " 1 server " in first

    control = robot("control", role="server", bytes_from_robot=4_000.0, bytes_to_robot=300_000.0)
    Bed(robot("robot1", role="client"), control).run(steps, WIDE)


@pytest.mark.parametrize("size", [(40, 12), *long(NARROW, WIDE), (170, 40)])
def test_every_size(size: tuple[int, int]) -> None:
    async def steps(bed: Bed) -> None:
        lines = text(bed.app).splitlines()
        assert len(lines) == size[1]
        for name in ("robot2", "robot11", "robot12"):
            (line,) = [line for line in lines if f" {name} " in line and "─" not in line and "fleet" not in line]
            assert len(line) == size[0]

    Bed().run(steps, size)


@on_fleet()
async def test_the_cursor_stays_on_its_robot(bed: Bed) -> None:
    assert bed.cursor == "robot2"  # the worst row, until the operator moves
    bed.source.put("robot2", state=RobotState.OK, why="")
    await bed.until(lambda: bed.cursor == "robot11", "the worst under the cursor")
    await bed.press("j")
    assert bed.cursor == "robot3"
    bed.source.put("robot12", state=RobotState.FAULT)
    await bed.until(lambda: bed.listed[1] == "robot12", "a new fault")
    assert bed.cursor == "robot3"


@on_fleet()
async def test_filter_and_faults_only(bed: Bed) -> None:
    await bed.press("f")
    assert bed.listed == ["robot2", "robot11", "robot3"]
    await bed.press("escape", "slash", *"group:hall", "enter")
    await bed.until(lambda: bed.listed == ["robot11", "robot3", "robot1"], "the robots of the hall")
    await bed.shown("3 of 6")
    await bed.press("escape")
    assert len(bed.listed) == 6
    await bed.press("slash", *"why:cable", "enter")
    await bed.until(lambda: bed.listed == ["robot2"], "the one whose cable was pulled")
    await bed.press("slash", *"zzz", "enter")
    await bed.shown("No robot matches")


@on_fleet()
async def test_groups_fold(bed: Bed) -> None:
    await bed.press("B", "g")
    everything = ["[hall]", "robot11", "robot3", "robot1", "[yard]", "robot2", "robot12", "[]", "robot4"]
    assert bed.listed == everything
    await bed.press("enter")
    assert bed.listed == ["[hall]", *everything[4:]]
    await bed.shown("▸ hall  3 robots")
    await bed.shown("/scan STALE")  # its errors are shown all the same
    await bed.press("space")
    assert bed.view.marked == {"control/robot1", "control/robot3", "control/robot11"}
    await bed.press("space", "enter")
    assert (bed.view.marked, bed.listed) == (set(), everything)
    await bed.press("B")
    assert "[hall]" not in bed.listed


@on_fleet(lambda: Bed(robot("robot1", group="hall"), robot("robot2", group="hall"), view=FleetView(grouped=True)))
async def test_of_group_that_is_well_it_is_said(bed: Bed) -> None:
    assert bed.listed == ["[hall]", "robot1", "robot2"]
    assert bed.cursor == ""
    await bed.shown("nothing is wrong")


def test_both_screens_count_topics_that_nobody_hears_alike() -> None:
    """The console counts them by its routes, the fleet by its robots' summaries."""
    unheard = [a(f"/t{number}", State.UNHEARD, cause=Cause.NO_SUBSCRIBER) for number in range(27)]
    known = a("/known", State.UNHEARD, cause=Cause.NO_SUBSCRIBER, acknowledged=Acknowledgement("anna", NOW))
    robots = {name: (*unheard[:count], known, a("/odom")) for name, count in (("robot1", 27), ("robot2", 5))}

    async def steps(bed: Bed) -> None:
        (first, *_) = text(bed.app).splitlines()
        (on_consoles,) = state_counts(
            [each for routes in robots.values() for each in routes], [State.UNHEARD], words=True
        )
        assert on_consoles[0].strip() == "◇ 32 unheard"
        assert on_consoles[0].strip() in first
        await bed.shown("nothing is wrong")
        (of_group,) = [line for line in text(bed.app).splitlines() if "nothing is wrong" in line]
        assert on_consoles[0].strip() in of_group

    summaries = [
        msgspec.structs.replace(on_server(*routes), name=name, group="hall") for name, routes in robots.items()
    ]
    Bed(*summaries, view=FleetView(grouped=True)).run(steps)


@on_fleet(lambda: Bed(robot("robot1"), robot("robot2")))
async def test_without_groups_there_are_no_headings(bed: Bed) -> None:
    await bed.press("B")
    assert bed.listed == ["robot1", "robot2"]


@on_fleet()
async def test_marks(bed: Bed) -> None:
    await bed.press("space", "space")
    assert (bed.view.marked, bed.cursor) == ({"control/robot2", "control/robot11"}, "robot3")
    await bed.shown("2 marked")
    assert text(bed.app).count("✓") == 2
    await bed.press("escape")
    assert bed.view.marked == set()


@on_fleet()
async def test_sorting(bed: Bed) -> None:
    await bed.press("greater_than_sign")  # by name
    assert bed.listed == ["robot1", "robot2", "robot3", "robot4", "robot11", "robot12"]
    await bed.press("s")
    assert bed.listed == ["robot12", "robot11", "robot4", "robot3", "robot2", "robot1"]


@on_fleet()
async def test_what_has_gone_is_dismissed(bed: Bed) -> None:
    bed.view.marked.add("control/robot1")
    bed.source.given = [each for each in bed.source.given if each.name != "robot1"]
    await bed.until(lambda: bed.listed[:2] == ["robot1", "robot2"], "it is missing")
    assert bed.view.marked == set()  # if it comes back in an hour, it is not among those to change
    await bed.press("g", "enter")  # nothing to open
    assert bed.app.return_value is None
    await bed.shown("d dismiss")
    await bed.press("d")
    await bed.until(lambda: "robot1" not in bed.listed, "it is forgotten")
    await bed.until(lambda: "d dismiss" not in text(bed.app), "no such key any more")


@on_fleet()
async def test_a_source_that_knows_nothing_says_so(bed: Bed) -> None:
    bed.source.problem = "socket closed"
    await bed.shown("control: socket closed")


def test_no_robots_yet() -> None:
    bed = Bed()
    bed.source.given = []

    async def steps() -> None:
        async with bed.app.run_test(size=NARROW):
            await bed.shown("No robots yet")
            await bed.press("enter", "space", "e", "d", "n")

    asyncio.run(steps())


def test_opening_one_and_coming_back() -> None:
    bed = Bed()

    async def steps(bed: Bed) -> None:
        await bed.press("j", "j", "enter")

    bed.run(steps)
    assert bed.app.return_value is not None
    assert bed.app.return_value.summary.name == "robot3"

    async def back(later: Bed) -> None:
        await later.until(lambda: later.cursor == "robot3", "the cursor where it was")

    Bed(view=bed.view).run(back)


@on_fleet()
async def test_the_footer_ends_with_help_and_quit(bed: Bed) -> None:
    assert text(bed.app).splitlines()[-1].rstrip().endswith("? help  q quit")


@on_fleet()
async def test_the_fleets_faults_are_counted_shown_or_not(bed: Bed) -> None:
    assert bed.app.main.fault_count == 3
    bed.source.problem = "no router answers"
    await bed.press("slash", *"robot1", "enter")
    await bed.until(lambda: bed.app.main.fault_count == 4, "the source")


@on_fleet()
async def test_the_help_has_the_fleets_actions(bed: Bed) -> None:
    await bed.press("question_mark")
    await bed.until(lambda: "edit_marked" in text(bed.app) or bed.app.screen is not bed.app.main, "the help")
    await bed.press("G")
    await bed.shown("edit_marked")
    assert "add_topic" not in text(bed.app)
    await bed.press("q")


# --- a change for several robots


def with_cameras(*names: str) -> Bed:
    bed = Bed(*(robot(name) for name in names))
    for name in names:
        bed.source.engines[name] = ScriptedEngine(routes=topics(name, Topic("/camera", "transmit", max_rate=30.0)))
    return bed


def rollout(bed: Bed) -> RolloutScreen:
    assert isinstance(bed.app.screen, RolloutScreen)
    return bed.app.screen


async def marked(bed: Bed) -> RolloutScreen:
    """Open the dialog for the first two robots, whose faults last only a moment."""
    await bed.press("space", "space", "e")
    await bed.until(lambda: isinstance(bed.app.screen, RolloutScreen), "the dialog")
    screen = rollout(bed)
    screen._settle = 0.05
    return screen


async def planned(bed: Bed, change: str) -> RolloutScreen:
    """Type a change, and wait for what it would be."""
    screen = await marked(bed)
    screen.query_one(Input).value = change
    await bed.press("enter")
    return screen


@on_fleet(lambda: with_cameras("robot1", "robot2"))
async def test_a_change_is_not_made_without_a_yes(bed: Bed) -> None:
    screen = await planned(bed, "/camera max_rate=5")
    await bed.until(lambda: screen.phase is RolloutPhase.ASKING, "a question")
    await bed.press("enter", "n", "escape")
    assert screen.phase is RolloutPhase.TYPING
    await bed.press("escape")
    await bed.until(lambda: bed.app.screen is bed.app.main, "the fleet")
    assert not any(engine.commands for engine in bed.source.engines.values())


@pytest.mark.parametrize("change", ["/none ", "max_rate=5", "camera max_rate=5", "/a /b max_rate=5"])
@on_fleet(lambda: with_cameras("robot1", "robot2"))
async def test_what_is_no_change(bed: Bed, change: str) -> None:
    screen = await planned(bed, change)
    await bed.shown("for example")
    assert screen.phase is RolloutPhase.TYPING


def with_different_cameras() -> Bed:
    """Two robots with cameras that differ, of which one has a scan, too."""
    bed = with_cameras("robot1", "robot2", "robot3")
    others = Topic("/camera", "transmit"), Topic("/scan", "transmit")
    bed.source.engines["robot2"] = ScriptedEngine(routes=topics("robot2", *others))
    return bed


async def planned_for_the_worse(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> RolloutScreen:
    """Type a change that makes each robot faulty, and wait for the question."""
    screen = await planned(bed, "/camera max_rate=5")
    await bed.until(lambda: screen.phase is RolloutPhase.ASKING, "a question")
    tell = fleet_places.TELL_STEP.value

    def worse(screen: RolloutScreen, step: RobotChange, what: str) -> None:
        tell(screen, step, what)
        if what == "settling":
            bed.source.put(step.name, state=RobotState.FAULT, why="refused")

    fleet_places.TELL_STEP.set(monkeypatch, worse)
    return screen


async def picking(bed: Bed) -> RolloutScreen:
    """Mark the first two robots, and wait for what can be picked."""
    screen = await marked(bed)
    await bed.until(lambda: "/scan" in change_of(screen).list.keys, "all topics")
    return screen


@pytest.mark.parametrize("size", [*long(WIDE), NARROW], ids=["wide", "narrow"])
def test_a_change_is_picked(size: tuple[int, int]) -> None:
    async def steps(bed: Bed) -> None:
        screen = await picking(bed)
        assert change_of(screen).list.keys == ["/camera", "/scan"]  # what most have comes first
        await bed.shown("2 of 2")
        await bed.shown("1 of 2")
        await bed.press("enter")
        assert change_of(screen).control.value == "/camera "
        await bed.press(*"max_r")
        await bed.until(lambda: change_of(screen).list.keys == ["max_rate"], "the key")
        await bed.shown("30 on 1")
        await bed.shown("none on 1")
        await bed.press("enter")
        assert change_of(screen).control.value == "/camera max_rate="
        await bed.press("5", "enter")
        await bed.until(lambda: screen.phase is RolloutPhase.ASKING, "a question")
        await bed.shown("max_rate 30.0 → 5")
        assert not change_of(screen).list.display
        assert not any(engine.commands for engine in bed.source.engines.values())
        await bed.press("y")
        await bed.until(lambda: screen.phase is RolloutPhase.ENDED, "the end")
        assert [len(bed.source.engines[name].commands) for name in ("robot1", "robot2", "robot3")] == [1, 1, 0]
        await bed.shown("u undo")
        await bed.press("escape")
        await bed.until(lambda: bed.app.screen is bed.app.main, "the fleet")

    with_different_cameras().run(steps, size)


@on_fleet(with_different_cameras)
async def test_values_of_choice_are_picked_with_arrows(bed: Bed) -> None:
    screen = await picking(bed)
    await bed.press(*"/camera priority=")
    await bed.until(lambda: "value high" in change_of(screen).list.keys, "values")
    await bed.press("down", "enter")
    assert change_of(screen).control.value == "/camera priority=high"
    await bed.press("enter")
    await bed.until(lambda: screen.phase is RolloutPhase.ASKING, "a question")
    await bed.press("escape")
    assert change_of(screen).list.display


@on_fleet(with_different_cameras)
async def test_a_default_can_be_picked(bed: Bed) -> None:
    screen = await picking(bed)
    await bed.press(*"/camera compression=", "enter", "enter")
    await bed.until(lambda: bool(screen.steps), "a plan")
    assert [step.problem for step in screen.steps] == ["", ""]


@on_fleet(with_different_cameras)
async def test_a_mistake_is_said_as_it_is_typed(bed: Bed) -> None:
    screen = await picking(bed)
    await bed.press(*"/camera max_rate=-1")
    await bed.until(lambda: change_of(screen).mistake() != "", "a mistake")
    await bed.shown("robot1: max_rate")
    assert screen.phase is RolloutPhase.TYPING
    await bed.press("backspace", "backspace", "5")
    await bed.until(lambda: change_of(screen).mistake() == "", "none")


@on_fleet(with_different_cameras)
async def test_a_topic_is_picked_with_the_mouse(bed: Bed) -> None:
    screen = await picking(bed)
    await settled(bed.pilot)  # a topic that is listed already may be drawn later
    assert await bed.pilot.click(change_of(screen).list, offset=(3, 1))
    await bed.until(lambda: change_of(screen).list.cursor_key == "/scan", "the cursor on the second topic")
    assert await bed.pilot.click(change_of(screen).list, offset=(3, 1))
    await bed.until(lambda: change_of(screen).control.value == "/scan ", "the second topic")


def test_a_robot_that_does_not_answer_is_named() -> None:
    bed = with_different_cameras()
    del bed.source.engines["robot1"]

    async def steps(bed: Bed) -> None:
        await picking(bed)
        await bed.shown("no answer from robot1")

    bed.run(steps)


@on_fleet(lambda: with_cameras("robot1", "robot2"))
async def test_old_key_changes_no_robot_without_question(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change may resume topics, or end a demand; a line that hung delivers the y of somebody who has gone on."""
    screen = await planned_for_the_worse(bed, monkeypatch)
    bed.app.input_gate.is_young = False
    for answer in ("n", "y"):
        assert not any(engine.commands for engine in bed.source.engines.values())
        await bed.press("y")
        await bed.until(lambda: isinstance(bed.app.screen, ConfirmScreen), "a question")
        assert screen.phase is RolloutPhase.ASKING
        await bed.press(answer)
        await bed.until(lambda: bed.app.screen is screen, "an answer")
    await bed.until(lambda: screen.phase is RolloutPhase.ENDED, "the end")


@on_fleet(lambda: with_cameras("robot1", "robot2"))
async def test_change_that_makes_it_worse_is_put_back(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = await planned_for_the_worse(bed, monkeypatch)
    await bed.press("y")
    await bed.until(lambda: screen.phase is RolloutPhase.ENDED, "the end")
    await bed.shown("stopped at robot1")
    await bed.shown("not begun: robot2")
    await bed.shown("rsb-console fleet edit robot1 /camera max_rate=30")
    await bed.press("u")
    await bed.until(lambda: isinstance(bed.app.screen, ConfirmScreen), "a question")
    await bed.press("y")
    await bed.until(lambda: screen.phase is RolloutPhase.ENDED and screen.outcome is None, "the undo")
    await bed.shown("restored on robot1")
    lines = re.findall(r"(\S) +(robot.) +max_rate (\S+) → (\S+)", text(bed.app))
    assert [(sign, name, float(old), float(new)) for sign, name, old, new in lines] == [
        ("✓", "robot1", 5.0, 30.0),
        ("│", "robot2", 30.0, 5.0),
    ]
    assert [each[2].max_rate for each in bed.source.engines["robot1"].commands] == [5.0, 30.0]  # type: ignore[attr-defined]


@pytest.mark.parametrize("marked", [("control",), ("control", "robot1")])
@on_fleet(lambda: Bed(robot("robot1"), robot("control", role="server")))
async def test_servers_are_left_out_of_an_edit(bed: Bed, marked: tuple[str, ...]) -> None:
    """A server has each robot's topic, so that an edit could not tell which to change."""
    await bed.until(lambda: len(bed.app.main.table.rows) == 2, "both rows")
    rows = bed.app.main.table.rows
    bed.view.marked.update(key for key, row in rows.items() if row.robot.summary.name in marked)
    await bed.press("e")
    if "robot1" in marked:
        await bed.until(lambda: isinstance(bed.app.screen, RolloutScreen), "the dialog")
        await bed.shown("Edit a topic of 1 robot")
        await bed.shown("no answer from robot1")
    else:
        await bed.until(lambda: notices(bed.app), "a notice")
        assert bed.app.screen is bed.app.main


def test_values_count_robots() -> None:
    """A robot may have a topic twice; the most frequent value comes first and is never cut."""
    spec = Topic("/camera", "transmit", max_rate=30.0)
    with_two = [Bridged("robot1", route, SESSION) for route in topics("robot1", spec, spec)]
    others = [
        Bridged(name, topics(name, msgspec.structs.replace(spec, max_rate=None))[0], SESSION)
        for name in ("robot2", "robot3")
    ]
    now = present_values([*with_two, *others], "max_rate", None)
    assert re.findall(r"(\w+) on (\d+)", now) == [("none", "2"), ("30", "1")]
    wordy = "zenoh on 8, the QoS of its publishers on 1"
    ((_, _), (_, _), (shown, _), *_) = _key_line("qos", wordy, "", 80)
    assert wordy.startswith(shown.rstrip("…"))
    assert shown.startswith("zenoh on 8")


@on_fleet(lambda: Bed(readonly=True))
async def test_read_only(bed: Bed) -> None:
    await bed.shown("READ-ONLY")
    await bed.press("e")
    assert bed.app.screen is bed.app.main


# --- the console on one robot


def test_console_on_robot_is_left_with_escape(machine: Machine) -> None:
    machine.serve(ServerEngine("robot1", "robot2"))
    fleet = ServerFleet("control", machine.folder / "control.sock")
    app = RobotApp(None, None, theme="dark", attach_to=lambda: fleet.open("robot2", read_only=False))

    async def run() -> None:
        async with app.run_test(size=NARROW):
            pilot = Operator(app)
            await shown(pilot, "/robot2/scan")
            await shown(pilot, "robot2 at control")
            assert "/robot1/scan" not in text(app)
            await pilot.press("o", "f2", "f5", "f", "escape")  # nothing else is opened in its place
            assert app.is_running
            assert app.screen is app.main
            await pilot.press("escape")
            await until(pilot, lambda: not app.is_running or ended(app), "the end")

    asyncio.run(run())
    app.stop()
    assert app.return_value is None


def test_console_on_robot_leaves_no_memory_behind() -> None:
    async def run() -> weakref.ref[RobotApp]:
        app = RobotApp(SESSION, None, theme="dark", make_engine=ScriptedEngine)
        async with app.run_test(size=NARROW):
            await shown(Pilot(app), "/robot1/scan")
        return weakref.ref(app)

    app = asyncio.run(run())
    gc.collect()
    assert app() is None


# --- pictures, and a terminal


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize("theme", ["dark", "terminal"])
def test_picture(snap_compare: Callable[..., bool], size: tuple[int, int], theme: str) -> None:
    bed = Bed(theme=theme)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "✗ MISSING")
        await pilot.press("B", "j", "j", "space")
        await shown(pilot, "1 marked")
        await settled(pilot)  # the cursor and the details come behind it

    assert snap_compare(bed.app, terminal_size=size, run_before=steps)


def test_picture_in_ascii(snap_compare: Callable[..., bool]) -> None:
    bed = Bed(theme="terminal", ascii_only=True)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "x MISSING")

    assert snap_compare(bed.app, terminal_size=NARROW, run_before=steps)


def test_in_a_terminal(machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the fleet to a robot and back, as an operator does it."""
    if shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    monkeypatch.setenv("RSB_CONSOLE_ISOLATED", "1")
    engine = machine.have(ServerEngine("robot1", "robot2"))
    engine.now = replace(engine.now, time=NOW + 1)
    command = (
        f"PYTHONPATH={os.environ.get('PYTHONPATH', '')} {sys.executable} -m rsb_console fleet --theme dark; sleep 60"
    )
    with Tmux(tmp_path, "sh", "-c", command, size=NARROW) as tmux:
        tmux.wait_for("2 ● ok")
        eventually(lambda: tmux.title == "fleet")
        tmux("send-keys", "j", "Enter")
        tmux.wait_for("/robot2/scan")
        assert "/robot1/scan" not in tmux.picture
        eventually(lambda: tmux.title != "fleet")
        tmux("send-keys", "p")
        eventually(lambda: [command[:1] for command in engine.commands] == [("pause",)])
        tmux("send-keys", "q")
        tmux.wait_for("2 ● ok")
        tmux("send-keys", "q")
        tmux.wait_for("y yes")
        tmux("send-keys", "Enter")  # the focus is on No
        tmux.wait_for("y yes", there=False)
        tmux("send-keys", "q")
        tmux.agree("Quit?")
        tmux.wait_for("2 ● ok", there=False)
