"""The screen of recordings: its list, how a fetch goes, and the keys."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.console.driving import NARROW, WIDE, engine_of, gone, notified, on_main, shown, text

from rsb_extras.courier.courier_screen import RecordingsScreenText
from rsb_extras.courier.tests.scripted_answers import DRIVE, FETCH

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


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
