"""The screen that chooses numbers to plot."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from tests.console.driving import engine_as, notified, on_main, shown, text, until
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import Topics
from rsb_bridge.model.snapshot import TopicInfo
from rsb_extras.pictures.field_chooser import ChooserText, FieldChooser
from rsb_extras.pictures.layouts import Subject
from rsb_extras.pictures.picture import TOPICS_AT_ONCE, FieldNumber, Picture, Viewed
from rsb_extras.pictures.plots import MOST_CURVES
from rsb_extras.pictures.tests.looking_engine import LookingEngine

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from textual.pilot import Pilot

    from rsb_bridge.model.commands import Command
    from rsb_console.app import ConsoleApp

SCAN = "/robot2/scan"
VALUES = (("twist.x", 0.25), ("twist.z", -1.5), ("bad", None))
NUMBERS = tuple(FieldNumber("/odom", path, value) for path, value in VALUES)
OTHER = FieldNumber("/battery", "voltage", 24.5)
TOPICS = tuple(
    TopicInfo(name, "pkg/msg/Name", "", None, 1, 0)
    for name in ("/odom", "/battery", *(f"/t{at}" for at in range(TOPICS_AT_ONCE)))
)


class Engine(LookingEngine):
    """Has topics on the other side."""

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        return self._done(TOPICS, "topics") if isinstance(command, Topics) else super()._execute(command, step)


choosing = functools.partial(on_main, landmark=SCAN, make_engine=Engine)


async def opened(app: ConsoleApp, pilot: Pilot[None], chosen: tuple[str, ...] = ()) -> list[Any]:
    """Open the screen; return the list that its result comes into."""
    results: list[Any] = []
    app.push_screen(FieldChooser(app, Subject(("/odom",)), chosen), results.append)
    await comes(app, pilot, *NUMBERS)
    await shown(pilot, "twist.x")
    return results


async def comes(app: ConsoleApp, pilot: Pilot[None], *numbers: FieldNumber) -> tuple[str, ...]:
    """Answer the screen's question, and return the topics of it."""
    engine = engine_as(app, LookingEngine)
    await until(pilot, lambda: not engine.viewing.done(), "a question for numbers")
    asked: Any = (
        engine.commands[-1]
        if engine.commands[-1][0] == "look"
        else [each for each in engine.commands if each[0] == "look"][-1]
    )
    engine.viewing.set_result(Viewed(Picture(numbers=numbers, messages=3), "robot1"))
    topics: tuple[str, ...] = asked[1]
    assert asked[2].how == "fields"
    return topics


@choosing()
async def test_numbers_are_listed_with_values(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot)
    for each in ("0.25", "-1.5", "/odom", "/battery"):
        assert each in text(app)
    assert says(text(app), ChooserText.TITLE, count=0, most=MOST_CURVES)


@choosing()
async def test_enter_plots_number_under_cursor(app: ConsoleApp, pilot: Pilot[None]) -> None:
    results = await opened(app, pilot)
    await pilot.press("down", "down", "enter")
    assert results == [("twist.z",)]


@choosing()
async def test_search_and_space_choose_several(app: ConsoleApp, pilot: Pilot[None]) -> None:
    results = await opened(app, pilot, ("twist.x",))
    await pilot.press(*"bad", "space")
    await until(pilot, lambda: says(text(app), ChooserText.TITLE, count=2, most=MOST_CURVES), "two chosen ones")
    await pilot.press("enter")
    assert results == [("twist.x", "bad")]


@choosing()
async def test_chosen_number_is_taken_away(app: ConsoleApp, pilot: Pilot[None]) -> None:
    results = await opened(app, pilot, ("twist.x", "twist.z"))
    await pilot.press(*"twist.x", "space", "enter")
    assert results == [("twist.z",)]


@choosing()
async def test_escape_changes_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    results = await opened(app, pilot, ("twist.x",))
    await pilot.press("escape")
    assert results == [None]


@choosing()
async def test_another_topic_opens_below(app: ConsoleApp, pilot: Pilot[None]) -> None:
    results = await opened(app, pilot, ("twist.x",))
    await shown(pilot, "/battery")
    await pilot.press(*"/battery", "space")

    while await comes(app, pilot, *NUMBERS, OTHER) != ("/odom", "/battery"):
        await pilot.pause()
    await shown(pilot, "voltage")
    await pilot.press("down", "space", "enter")
    assert results == [("/odom:twist.x", "/battery:voltage")]


@choosing()
async def test_topics_of_chosen_numbers_are_open(app: ConsoleApp, pilot: Pilot[None]) -> None:
    app.push_screen(FieldChooser(app, Subject(("/odom",)), ("/battery:voltage",)))
    assert await comes(app, pilot, *NUMBERS, OTHER) == ("/odom", "/battery")


@choosing()
async def test_too_many_curves_and_topics_are_refused(app: ConsoleApp, pilot: Pilot[None]) -> None:
    chosen = tuple(f"field{at}" for at in range(MOST_CURVES))
    await opened(app, pilot, chosen)
    await pilot.press(*"twist.x", "space")
    await notified(pilot, ChooserText.TOO_MANY)
    await pilot.press(*["backspace"] * len("twist.x"))
    for at in range(TOPICS_AT_ONCE):
        await pilot.press("/", "t", str(at), "space", *["backspace"] * 3)
    await notified(pilot, ChooserText.TOO_MANY_TOPICS)


@choosing()
async def test_refusal_is_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    app.push_screen(FieldChooser(app, Subject(("/odom",)), ()))
    engine = engine_as(app, LookingEngine)
    await until(pilot, lambda: not engine.viewing.done(), "a question for numbers")
    await pilot.press(*"nothing matches")
    engine.viewing.set_exception(EngineError("robot1 denies /odom"))
    await shown(pilot, "robot1 denies /odom")


@choosing()
async def test_closed_screen_ends_its_view(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot)
    await pilot.press("escape")
    engine = engine_as(app, LookingEngine)
    await until(pilot, lambda: any("end_look" in map(str, each) for each in engine.commands), "the end of the view")
