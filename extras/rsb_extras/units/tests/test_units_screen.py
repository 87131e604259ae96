"""The screen of units: its list, a question for each action, and the result."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING

from tests.console.driving import NARROW, engine_of, gone, notified, on_main, shown, text

from rsb_bridge.api import EngineError
from rsb_console.notation.side_answer import SideText
from rsb_extras.units.tests.scripted_answers import GROUPS, LAST_LINE
from rsb_extras.units.tests.units_places import AGED
from rsb_extras.units.unit_records import ACTIONS, UnitOutcome, UnitState
from rsb_extras.units.unit_requests import ControlUnit, ListUnits, UnitGroup
from rsb_extras.units.units_command import UnitsCommandText
from rsb_extras.units.units_screen import UnitsScreen, UnitsScreenText

if TYPE_CHECKING:
    import pytest
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


def told(app: ConsoleApp) -> list[tuple[object, ...]]:
    return [command for command in engine_of(app).commands if command[0] == "control unit"]


async def opened(pilot: Pilot[None], *down: str) -> None:
    await pilot.press("U")
    await shown(pilot, "no right")
    await pilot.press(*down)


@on_main(NARROW)
async def test_units_of_both_sides_are_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    lines = [" ".join(line.strip(" │▌").split()) for line in text(app).splitlines()]
    assert "camera this side running 1.2s restart" in lines
    assert "gripper the server running 3.0s no right" in lines
    assert "lidar the server failed 3.0s restart" in lines
    assert "nav the server stopped 2.0s start stop restart" in lines
    await pilot.press("escape")
    await gone(pilot, "no right")


@on_main(NARROW)
async def test_an_action_is_asked_and_its_result_stays(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "j", "j", "j", "x")
    await shown(pilot, "Restart unit nav of the server?")
    await pilot.press("n")
    await gone(pilot, "Restart unit nav of the server?")
    assert told(app) == []
    await pilot.press("x")
    await shown(pilot, "Restart unit nav of the server?")
    await pilot.press("y")
    await shown(pilot, "unit nav of the server: it came back in 4.2 s")
    assert told(app) == [("control unit", "nav", "restart", "robot1")]
    await pilot.press("k")
    await gone(pilot, "it came back in 4.2 s")
    await pilot.press("x")
    await shown(pilot, "Restart unit lidar of the server?")
    await pilot.press("y")
    await shown(pilot, "unit lidar of the server: restart ended with exit code 7")
    words = text(app).replace("│", " ").split()
    assert LAST_LINE in " ".join(words), "all of it"


async def restarting(pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch) -> Future[UnitOutcome]:
    """Restart a unit, and return the answer that the action gets once it is set."""
    answer: Future[UnitOutcome] = Future()
    played = {ListUnits: lambda _: GROUPS, ControlUnit: lambda _: answer}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await opened(pilot, "j", "j", "j", "x")
    await shown(pilot, "Restart unit nav of the server?")
    await pilot.press("y")
    await shown(pilot, "restart under way")
    return answer


@on_main(NARROW)
async def test_an_action_under_way_is_not_asked_twice(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = await restarting(pilot, monkeypatch)
    await pilot.press("x")
    await notified(pilot, UnitsScreenText.WAIT, name="nav", action="restart")
    answer.set_exception(EngineError("the link was lost"))
    await gone(pilot, "restart under way")


@on_main(NARROW)
async def test_a_result_outlives_the_screen(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = await restarting(pilot, monkeypatch)
    await pilot.press("escape")
    await gone(pilot, "restart under way")
    answer.set_result(UnitOutcome(seconds=4.2, state=UnitState.RUNNING))
    await notified(pilot, UnitsCommandText.ENDED, name="nav", side="the server")
    app.clear_notifications()
    await opened(pilot, "j", "j", "j")
    await shown(pilot, "unit nav of the server: it came back in 4.2 s")


@on_main(NARROW)
async def test_a_missing_right_is_named_with_its_remedy(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "j", "x")
    remedy = "may: {units: [gripper]}"
    await notified(pilot, SideText.LACKS, side="the server", act="restart unit gripper", entry=remedy)
    await shown(pilot, "file there")  # the end of it, in a message that is not cut
    assert told(app) == []


def _groups(problem: str) -> tuple[UnitGroup, ...]:
    return GROUPS[0], UnitGroup("robot1", problem=problem)


@on_main(NARROW)
async def test_a_problem_is_not_cut(app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch) -> None:
    problem = "the server does not let demo look: add may: {units: [nav]} to client demo in the session file of pc"
    monkeypatch.setattr("tests.console.scripted.answers", lambda: {ListUnits: lambda _: _groups(problem)})
    await pilot.press("U")
    await shown(pilot, "camera")
    words = " ".join(text(app).replace("│", " ").split())
    assert problem in words
    assert f"the server: {problem}" not in words


@on_main(NARROW)
async def test_problems_of_many_robots_leave_room_for_units(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = "not linked: no connection for 40 s, as the server does not answer; check that its bridge runs"
    groups = (GROUPS[0], *(UnitGroup(f"robot{number}", problem=problem) for number in range(8)))
    monkeypatch.setattr("tests.console.scripted.answers", lambda: {ListUnits: lambda _: groups})
    await pilot.press("U")
    await shown(pilot, "not linked")
    assert app.screen.table.is_seen()  # type: ignore[attr-defined]  # the screen of units
    assert "camera" in text(app)


@on_main(NARROW)
async def test_what_a_silent_side_has_said_is_no_state_of_now(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    AGED.set(monkeypatch, -UnitsScreen.EVERY)
    due: Future[tuple[UnitGroup, ...]] = Future()
    played: dict[object, object] = {ListUnits: lambda _: GROUPS}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await opened(pilot)
    played[ListUnits] = lambda _: due
    await shown(pilot, "ago: no answer since")
    due.set_result(GROUPS)
    await gone(pilot, "ago: no answer since")


def test_each_question_fits() -> None:
    for action in ACTIONS:
        assert len(UnitsScreenText[action.upper()]()) <= 80


@on_main(NARROW)
async def test_an_action_that_a_unit_lacks_is_named(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "S")
    await notified(pilot, UnitsScreenText.NO_ACTION, name="camera", action="stop", actions="restart")
    assert told(app) == []


@on_main(NARROW, readonly=True)
async def test_a_read_only_console_only_looks(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "x")
    await notified(pilot, UnitsScreenText.READ_ONLY)
    assert told(app) == []
