"""The screen of recordings: its list, how a fetch goes, and the keys."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace
from tests.console.driving import (
    NARROW,
    WIDE,
    drive,
    engine_of,
    gone,
    notified,
    on_main,
    scripted_app,
    shown,
    text,
    until,
)
from tests.console.scripted import ScriptedEngine, answers

from rsb_extras.courier.courier_records import LATEST
from rsb_extras.courier.courier_requests import ListFetches, ListRecordings
from rsb_extras.courier.courier_screen import RecordingsScreenText
from rsb_extras.courier.tests.scripted_answers import COMPLETED, DONE, DRIVE, FETCH

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from textual.pilot import Pilot

    from rsb_bridge.model.commands import Command
    from rsb_console.app import ConsoleApp
    from rsb_extras.courier.courier_requests import FetchReport


def told(app: ConsoleApp, what: str) -> list[tuple[object, ...]]:
    return [command for command in engine_of(app).commands if command[0] == what]


async def opened(pilot: Pilot[None], *down: str) -> None:
    await pilot.press("F")
    await shown(pilot, "noon.mcap")
    await pilot.press(*down)


@on_main(WIDE)
async def test_recordings_and_what_is_in_them_are_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "j")
    await shown(pilot, "[#####...............] 25%, 42 MB, 1.5 MB/s, 84 s left, fetching")
    assert DRIVE.name in text(app)
    await shown(pilot, "note: /scan stopped")
    await shown(pilot, "topics: /scan")
    await pilot.press("escape")
    await gone(pilot, "noon.mcap")


@on_main(NARROW)
async def test_a_recording_of_the_other_side_is_got(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "enter")
    await notified(pilot, RecordingsScreenText.HERE, name="noon.mcap")
    assert told(app, "fetch recording") == []
    await pilot.press("j", "enter")
    await notified(pilot, RecordingsScreenText.BEGUN, name=DRIVE.name, side="the server")
    ((_, link, recording, *_),) = told(app, "fetch recording")
    assert (link, recording) == ("robot1", DRIVE.id)


@on_main(NARROW)
async def test_a_fetch_is_given_up_after_a_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "x")
    await notified(pilot, RecordingsScreenText.NO_FETCH, name="noon.mcap")
    await pilot.press("j")
    await shown(pilot, "25%")
    await pilot.press("x")
    await shown(pilot, f"Give up {FETCH.name}?")
    await pilot.press("n")
    await gone(pilot, f"Give up {FETCH.name}?")
    assert told(app, "cancel fetch") == []
    await pilot.press("x")
    await shown(pilot, f"Give up {FETCH.name}?")
    await pilot.press("y")
    await gone(pilot, f"Give up {FETCH.name}?")
    assert [command[1] for command in told(app, "cancel fetch")] == [FETCH.name]


@on_main(NARROW)
async def test_a_recording_is_completed_by_what_is_here(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot, "c")
    await notified(pilot, RecordingsScreenText.HERE, name="noon.mcap")
    await pilot.press("j", "c")
    await shown(pilot, f"Complete {DRIVE.name} of the server")
    await shown(pilot, "185 MB cross, less what came live")
    await shown(pilot, "all that this bridge has recorded then")
    await pilot.press("enter")
    await notified(pilot, RecordingsScreenText.BEGUN, name=DRIVE.name, side="the server")
    await pilot.press("c")
    await shown(pilot, "Topics")
    await pilot.press("right", "tab", *"/scan /tf", "enter")
    await until(pilot, lambda: len(told(app, "fetch recording")) == 2, "both are begun")
    assert [command[3:] for command in told(app, "fetch recording")] == [
        ((), 0, LATEST, True, ""), (("/scan", "/tf"), 0, LATEST, True, "0" * 16),
    ]  # fmt: skip


def with_fetches(monkeypatch: pytest.MonkeyPatch, *fetches: FetchReport) -> None:
    known: Any = answers()
    monkeypatch.setitem(known, ListFetches, lambda _: fetches)


COMPLETE = replace(
    DONE, name=f"robot1-{DRIVE.name}-completed", recording=DRIVE.name, completes=True, completed=COMPLETED,
    path=f"/var/lib/robot1-{DRIVE.name}-completed.mcap",
)  # fmt: skip


def test_what_is_missing_after_a_completion_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    with_fetches(monkeypatch, COMPLETE)

    async def steps(pilot: Pilot[None]) -> None:
        await opened(pilot, "j")
        await shown(pilot, "m: what neither side has of it, and why")
        await pilot.press("m")
        await shown(pilot, "1.0 MB of 9.0 MB of messages over there were missing here")
        await shown(pilot, "        900           80       12 + ?  /scan (/front/scan over there)")
        await shown(pilot, "10:15:01.000: 12 messages, the")
        await shown(pilot, "any time to any time: the other side's recording begins later")
        await pilot.press("escape")
        await gone(pilot, "/front/scan")
        assert "noon.mcap" in text(pilot.app)

    drive(scripted_app(), steps, NARROW)


def test_names_of_the_other_side_are_no_markup(monkeypatch: pytest.MonkeyPatch) -> None:
    """Textual would end the console for a tag that nothing opens."""
    named = "noon.mcap[/red][1]"
    known: Any = answers()
    groups = known[ListRecordings](ListRecordings())
    there = (replace(group, recordings=(replace(DRIVE, name=named),)) if group.link else group for group in groups)
    monkeypatch.setitem(known, ListRecordings, lambda _, there=(*there,): there)
    with_fetches(
        monkeypatch, replace(COMPLETE, name=f"robot1-{named}", recording=named), replace(FETCH, recording=named)
    )

    async def steps(pilot: Pilot[None]) -> None:
        await opened(pilot, "j", "c")
        await shown(pilot, f"Complete {named} of the server")
        await pilot.press("escape", "m")
        await shown(pilot, f"robot1-{named}")
        await pilot.press("escape", "x")
        await shown(pilot, f"Give up {FETCH.name}?")
        await pilot.press("n")

    drive(scripted_app(), steps, WIDE)


def test_a_completion_under_way_is_awaited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a fetch of all, both are shown, and the one under way is given up."""
    running = replace(FETCH, name="robot1-completed", completes=True)
    with_fetches(monkeypatch, running, replace(DONE, recording=DRIVE.name))

    async def steps(pilot: Pilot[None]) -> None:
        await opened(pilot, "j")
        await shown(pilot, "robot1-completed [#####...............] 25%")
        await shown(pilot, DONE.path)
        await pilot.press("m")
        await notified(pilot, RecordingsScreenText.COMPLETING, name=DRIVE.name)
        await pilot.press("x")
        await shown(pilot, "Give up robot1-completed?")

    drive(scripted_app(), steps, NARROW)


@on_main(NARROW)
async def test_a_file_tells_itself_what_is_missing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The bridge knows of fetches since it began only."""
    await opened(pilot, "m")
    await shown(pilot, "        900           80       12 + ?  /scan (/front/scan over there)")
    assert told(app, "read completed") == [("read completed", "0" * 16)]
    await pilot.press("escape", "j", "m")
    await notified(pilot, RecordingsScreenText.NOT_COMPLETED, name=DRIVE.name)


@on_main(NARROW)
async def test_each_folder_is_looked_through_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(pilot)
    asked = {command[1:] for command in told(app, "list recordings")}
    assert asked == {("", True, False), ("", False, True)}, "this side's and the other sides', each alone"


class Silent(ScriptedEngine):
    """The other side answers no list."""

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        asks = isinstance(command, ListRecordings) and not command.here
        return Future() if asks else super()._execute(command, step)


def test_recordings_of_this_side_wait_for_no_other() -> None:
    async def steps(pilot: Pilot[None]) -> None:
        await opened(pilot)
        assert DRIVE.name not in text(pilot.app)

    drive(scripted_app(make_engine=Silent), steps, NARROW)
