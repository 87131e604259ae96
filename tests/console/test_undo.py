"""The key `u` takes back what this console has changed, after a question, and nothing of anybody else's."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
from tests.console.changing import ARMED, SCAN, ChangingEngine
from tests.console.driving import (
    NARROW,
    WIDE,
    Decorator,
    choose,
    engine_as,
    fill,
    gone,
    notices,
    notified,
    on_main,
    shown,
    text,
    until,
)
from tests.console.scripted import LINK, NOW, ScriptedEngine, route
from tests.console.scripted import refused as refused_by
from tests.support.long import long

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddTopic, EditTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, Event, Level, PatternSnapshot, Snapshot, State
from rsb_console.operations.topic_operations import OperationText
from rsb_console.screens.dialog import ConfirmScreen, UndoScreen
from rsb_console.session.changes import STEPS, Changes, Paused

if TYPE_CHECKING:
    from textual.pilot import Pilot
    from textual.screen import Screen

    from rsb_console.app import ConsoleApp


def on_scan(*sizes: Any, select: str = "/scan", **options: Any) -> Decorator:
    """A test's steps run with the cursor on a topic; they get the engine, too."""

    async def selected(pilot: Pilot[None]) -> dict[str, Any]:
        app: Any = pilot.app
        while app.main.topics.selected is None or app.main.topics.selected.topic != select:
            await pilot.press("j" if app.main.topics.selected is None or app.main.topics.position == 0 else "k")
        return {"engine": engine_as(app, ChangingEngine)}

    made = {"make_engine": ChangingEngine, **options}
    return on_main(*sizes, landmark="/cmd_vel", opening=selected, makes=("engine",), **made)


async def question(app: ConsoleApp, pilot: Pilot[None]) -> UndoScreen:
    """Press the key, and wait for the question."""
    await pilot.press("u")
    await until(pilot, lambda: isinstance(app.screen, UndoScreen), "a question")
    assert isinstance(app.screen, UndoScreen)
    screen = app.screen
    await until(pilot, lambda: screen.focused is not None, "a focus")
    return screen


def focus(screen: Screen[Any]) -> str:
    assert screen.focused is not None
    return screen.focused.id or ""


async def slowed(app: ConsoleApp, pilot: Pilot[None], engine: ChangingEngine) -> None:
    """Limit the topic's rate."""
    await pilot.press("e")
    await fill(pilot, max_rate="2.5")
    await pilot.press("enter")
    await until(pilot, lambda: engine.spec("/scan").max_rate == 2.5, "an edit")
    await until(pilot, lambda: app.screen is app.main, "the form closed")


async def removed(pilot: Pilot[None], topic: str) -> None:
    await pilot.press("d")
    await shown(pilot, f"Remove {topic}?")
    await pilot.press("y")
    await gone(pilot, f"Remove {topic}?")


async def refused(app: ConsoleApp, pilot: Pilot[None], *words: str) -> None:
    """Press the key, and return the reason why nothing is undone."""
    await pilot.press("u")
    await shown(pilot, "Not undone")
    assert all(any(each in told.message for told in notices(app)) for each in words)
    assert app.screen is app.main


@on_scan()
async def test_nothing_to_undo(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    assert "undo" not in text(app)
    await pilot.press("u")
    await shown(pilot, "nothing to undo")
    assert engine.commands == []
    assert not app.changes.dropped


@on_scan(*long(WIDE), NARROW)
async def test_removed_topic_comes_back_with_all_its_fields(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await removed(pilot, "/scan")
    screen = await question(app, pilot)
    assert focus(screen) == "no"
    await shown(pilot, "max_rate: 5.0")
    await shown(pilot, "priority: high")
    await pilot.press("enter")  # the focus is on No
    assert engine.undone == []
    await question(app, pilot)
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")
    assert engine.undone == [("add", SCAN, "robot1")]
    await pilot.press("u")
    await shown(pilot, OperationText.NOTHING_MORE_TO_UNDO)


@on_scan(select="/cmd_vel")
async def test_what_has_to_be_armed_comes_back_disarmed(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await removed(pilot, "/cmd_vel")
    await question(app, pilot)
    await shown(pilot, "stays disarmed")
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")
    assert engine.undone == [("add", ARMED, "robot1")]
    assert not [command for command in engine.commands if command[0] == "arm"]


async def asked_about_demand(pilot: Pilot[None], engine: ChangingEngine) -> None:
    """Remove an entry that demands arming, up to the question about the demand."""
    engine.session = msgspec.structs.replace(engine.session, topics=engine.specs)
    await removed(pilot, "/cmd_vel")
    await shown(pilot, "Drop the demand to arm /cmd_vel, too?")


@on_scan(select="/cmd_vel")
async def test_removal_of_armed_entry_asks_once_preselecting_no(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await asked_about_demand(pilot, engine)
    assert focus(app.screen) == "no"
    assert engine.commands == []
    await pilot.press("y")
    await until(pilot, lambda: engine.commands, "a removal")
    assert engine.commands == [("remove", "/cmd_vel", "drop_arm")]


@on_scan(select="/cmd_vel")
async def test_removal_keeps_demand_without_agreement(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await asked_about_demand(pilot, engine)
    await pilot.press("escape")
    await until(pilot, lambda: engine.commands, "a removal")
    assert engine.commands == [("remove", "/cmd_vel")]


@on_scan(select="/cmd_vel")
async def test_removal_asks_nothing_if_another_line_demands_arming_too(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    engine.session = msgspec.structs.replace(engine.session, topics=engine.specs)
    demanded = ArmingSnapshot(armed=False, demanded_by=("robot.yaml:14", "robot.yaml:20"))
    routes = [replace(each, arming=demanded) if each.topic == "/cmd_vel" else each for each in engine.now.routes]
    engine.show(*routes)
    app.pull()
    await removed(pilot, "/cmd_vel")
    await until(pilot, lambda: engine.commands, "a removal")
    assert engine.commands == [("remove", "/cmd_vel")]


@on_scan()
async def test_an_edit_is_put_back(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    await slowed(app, pilot, engine)
    await shown(pilot, "undo")
    screen = await question(app, pilot)
    assert focus(screen) == "yes"
    await shown(pilot, "max_rate 2.5 → 5.0")
    await pilot.press("enter")
    await until(pilot, lambda: engine.undone, "an undo")
    assert engine.undone == [("edit", "/scan", SCAN)]


@on_scan()
async def test_a_safety_demand_is_not_dropped_unnamed(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await pilot.press("e")
    await shown(pilot, "Edit /scan")
    await choose(pilot, "arm", "yes")
    await pilot.press("enter")
    await until(pilot, lambda: engine.spec("/scan").arm, "an edit")
    await until(pilot, lambda: app.screen is app.main, "the form closed")
    screen = await question(app, pilot)
    assert focus(screen) == "no"
    await shown(pilot, "arm true → false")
    await shown(pilot, "without being armed")
    await pilot.press("n")
    assert engine.spec("/scan").arm
    await question(app, pilot)
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")
    assert engine.undone == [("edit", "/scan", SCAN, "drop_arm")]


@on_scan()
async def test_edit_that_drops_demand_asks_preselecting_no(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    engine.put("/scan", msgspec.structs.replace(SCAN, arm=True))
    app.pull()
    await pilot.press("e")
    await shown(pilot, "Edit /scan")
    for answer in ("enter", "y"):  # the focus is on No
        await choose(pilot, "arm", "")
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "a question")
        assert focus(app.screen) == "no"
        assert engine.spec("/scan").arm
        await pilot.press(answer)
        await until(pilot, lambda: not isinstance(app.screen, ConfirmScreen), "an answer")
    await until(pilot, lambda: not engine.spec("/scan").arm, "an edit")
    assert [command[-1] for command in engine.commands if command[0] == "edit"] == ["drop_arm"]


@on_scan()
async def test_added_topic_is_removed_again_after_question(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await pilot.press("a")
    await shown(pilot, "Add a topic")
    await pilot.press(*"/new", "enter")
    await fill(pilot, max_rate="3")
    await pilot.press("enter")
    await until(pilot, lambda: any(command[0] == "add" for command in engine.commands), "added")
    await until(pilot, lambda: app.screen is app.main, "the form closed")
    screen = await question(app, pilot)
    assert focus(screen) == "no"
    await pilot.click("#yes")
    await until(pilot, lambda: engine.undone, "an undo")
    assert engine.undone == [("remove", "/new")]


@on_scan()
async def test_steps_back_one_by_one(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    await pilot.press("p")
    await pilot.press("p")
    screen = await question(app, pilot)
    assert focus(screen) == "yes"  # nothing crosses that does not now
    await pilot.press("y")
    await until(pilot, lambda: engine.spec("/scan").paused, "paused")
    screen = await question(app, pilot)
    assert focus(screen) == "no"
    await pilot.press("y")
    await until(pilot, lambda: not engine.spec("/scan").paused, "resumed")
    assert engine.undone == [("pause", "/scan", True), ("pause", "/scan", False)]


def other(number: int, code: EventCode = EventCode.OPERATOR_EDITED, who: str = "anna on pts/3") -> Event:
    return Event(number, NOW, Level.INFO, code, "/scan: …", link="robot1", topic="/scan", who=who)


async def paused_and_resumed(engine: ChangingEngine, pilot: Pilot[None]) -> None:
    """Pause a topic, which somebody else then resumes."""
    await pilot.press("p")
    await until(pilot, lambda: engine.spec("/scan").paused, "paused")
    engine.happened += [other(5, EventCode.OPERATOR_PAUSED, "me"), other(6, EventCode.OPERATOR_RESUMED)]


@on_scan()
async def test_change_by_others_since_is_left_alone(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await paused_and_resumed(engine, pilot)
    engine.put("/scan", SCAN)
    await refused(app, pilot, "meanwhile by anna on pts/3")
    assert engine.undone == []
    await pilot.press("u")
    await shown(pilot, OperationText.NOTHING_MORE_TO_UNDO)


@on_scan()
async def test_pause_renewed_by_others_is_theirs(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    await paused_and_resumed(engine, pilot)
    engine.happened.append(other(7, EventCode.OPERATOR_PAUSED))
    await refused(app, pilot, "anna on pts/3")
    assert engine.spec("/scan").paused


@on_scan()
async def test_undo_with_changed_effect_asks_again(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    engine.now = with_pattern(engine, Topic("/s*", "transmit"))
    await removed(pilot, "/scan")
    first = await question(app, pilot)
    engine.now = with_pattern(engine, Topic("/s*", "transmit", excepts=("/scan",)))
    await pilot.press("y")
    await until(pilot, lambda: isinstance(app.screen, UndoScreen) and app.screen is not first, "another question")
    assert engine.undone == []
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")


@on_scan()
async def test_change_during_question_is_left_alone(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await slowed(app, pilot, engine)
    await question(app, pilot)
    engine.put("/scan", msgspec.structs.replace(SCAN, max_rate=9.0))
    await pilot.press("y")
    await shown(pilot, "Not undone")
    assert any("max_rate 2.5 → 9.0" in told.message for told in notices(app))
    assert engine.undone == []


@on_scan()
async def test_open_form_undoes_nothing_of_others(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    await pilot.press("e")
    await fill(pilot, max_rate="2.5")
    engine.put("/scan", msgspec.structs.replace(SCAN, paused=True))
    await pilot.press("enter")
    await shown(pilot, "it was changed meanwhile")
    assert engine.spec("/scan") == msgspec.structs.replace(SCAN, paused=True)


@on_scan()
async def test_edit_ends_without_its_form_and_undoes(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    under_way: Future[str] = Future()
    engine.answering = lambda command: under_way if isinstance(command, EditTopic) else None
    await pilot.press("e")
    await fill(pilot, max_rate="2.5")
    await pilot.press("enter")
    form = app.screen
    form.dismiss(None)
    await until(pilot, lambda: not form.is_running, "the form closed")
    under_way.set_result("/scan")
    await notified(pilot, OperationText.AFTER_ALL, topic="/scan")
    assert len(app.changes) == 1


@on_scan()
async def test_what_is_bridged_again_is_not_added_twice(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await removed(pilot, "/scan")
    engine.show(*engine.now.routes, route("/scan", spec=SCAN))
    await refused(app, pilot, "bridged again")
    assert engine.undone == []


@on_scan()
async def test_what_the_bridge_refuses_can_be_tried_again(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    await removed(pilot, "/scan")
    engine.answering = lambda command: refused_by("not now") if isinstance(command, AddTopic) else None
    await question(app, pilot)
    await pilot.press("y")
    await shown(pilot, "not now")
    engine.answering = lambda _: None
    assert engine.undone == []
    await question(app, pilot)
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")


@on_scan()
async def test_another_session_forgets_them(app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]) -> None:
    await pilot.press("p")
    await until(pilot, lambda: len(app.changes) == 1, "a change")
    await app.run_session(engine.session, app.path)
    assert app.changes.last is None


def test_a_bounded_number_is_remembered() -> None:
    changes = Changes()
    for number in range(STEPS + 5):
        changes.add(Paused("robot1", f"/t{number}", number, key=str(number), paused=True))
    assert len(changes) == STEPS
    assert changes.last is not None
    assert changes.last.topic == f"/t{STEPS + 4}"


# --- patterns


def with_pattern(engine: ScriptedEngine, spec: Topic) -> Snapshot:
    pattern = PatternSnapshot(f"pattern {spec.topic}", "robot1", spec, State.OK, "", here=True, source=spec.topic)
    return replace(engine.now, links=(replace(LINK, patterns=(pattern,)),))


@on_scan()
async def test_what_a_pattern_has_made_is_its_again(
    app: ConsoleApp, engine: ChangingEngine, pilot: Pilot[None]
) -> None:
    """A removal makes an exception in the pattern; an undo takes only that back."""
    pattern = Topic("/camera/**", "receive", excepts=("/camera/raw",), max_rate=4.0)
    left_out = msgspec.structs.replace(pattern, excepts=("/camera/raw", "/camera/a"))
    engine.now = with_pattern(engine, pattern)
    made = route("/camera/a", pattern="/camera/**", spec=Topic("/camera/a", "receive", max_rate=4.0))
    engine.show(made, *engine.now.routes)
    app.pull()
    app.main.topics.move_to(next(n for n, each in enumerate(app.main.topics.listed) if each.topic == "/camera/a"))
    await removed(pilot, "/camera/a")
    engine.now = with_pattern(engine, msgspec.structs.replace(left_out, max_rate=3.0))
    await question(app, pilot)
    await pilot.press("y")
    await until(pilot, lambda: engine.undone, "an undo")
    ((what, key, spec),) = engine.undone
    assert (what, key) == ("edit", "pattern /camera/**")
    assert spec == msgspec.structs.replace(pattern, max_rate=3.0)


# --- in a terminal
