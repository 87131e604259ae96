"""The log on the main screen, key by key."""

from dataclasses import replace

from tests.console.driving import NARROW, engine_of, gone, listed, on_main, put, shown, text, until
from tests.console.scripted import LINK, NOW
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import Event, Level
from rsb_console.app import ConsoleApp


def happen(app: ConsoleApp, *events: Event) -> None:
    engine_of(app).happened += events
    app.pull()


MORE = [Event(n, NOW, Level.INFO, "link.up", f"more {n}") for n in range(5, 40)]
NEWEST = Event(40, NOW, Level.INFO, "link.up", "newest")


@on_main()
async def test_log_levels_and_search(app: ConsoleApp, pilot: Pilot[None]) -> None:
    happen(app, Event(5, NOW, Level.DEBUG, "link.up", "a detail"))
    await gone(pilot, "a detail")
    await pilot.press("L")
    await shown(pilot, "Log ▸ WARN+")
    await until(pilot, lambda: "flowing" not in text(app).split("Log ▸")[1], "no INFO in the log")
    await pilot.press("L")
    await shown(pilot, "Log ▸ ERROR+")
    await pilot.press("L")
    await shown(pilot, "a detail")
    await pilot.press("l", "slash", *"linked", "enter")
    await gone(pilot, "a detail")
    await shown(pilot, "linked to 10.0.0.20")
    assert len(listed(app)) == 8  # the filter is the log's


@on_main()
async def test_log_follows_at_top_and_holds_below(app: ConsoleApp, pilot: Pilot[None]) -> None:
    log = app.main.log_pane
    await pilot.press("l", "j")
    held = log.selected
    happen(app, *MORE)
    assert log.selected == held
    await pilot.press("g")
    await shown(pilot, "more 39")
    happen(app, NEWEST)
    await shown(pilot, "newest")
    assert log.selected is not None
    assert log.selected.text == "newest"


@on_main()
async def test_log_follows_again_when_another_pane_gets_focus(app: ConsoleApp, pilot: Pilot[None]) -> None:
    log = app.main.log_pane
    await pilot.press("l", "G")
    held = log.selected
    happen(app, *MORE)
    await pilot.press("slash")
    await until(pilot, lambda: not log.has_focus, "the prompt")
    await pilot.press("escape")
    await until(pilot, lambda: log.has_focus, "the log again")
    assert log.selected == held, "the filter's prompt is not another pane"
    app.app_focus = False
    await until(pilot, lambda: not log.has_focus, "another window")
    app.app_focus = True
    await until(pilot, lambda: log.has_focus, "the log again")
    assert log.selected == held, "nor is another window"
    await pilot.press("l")
    await shown(pilot, "more 39")
    happen(app, NEWEST)
    await shown(pilot, "newest")


@on_main(NARROW)
async def test_long_line_of_log_can_be_read_whole(app: ConsoleApp, pilot: Pilot[None]) -> None:
    words = " ".join(f"word{number}" for number in range(40))
    engine_of(app).happened.append(Event(5, NOW, Level.ERROR, "link.up", words, "robot1"))
    put(app, links=(LINK,))
    await shown(pilot, "word0 ")
    line = next(line for line in text(app).splitlines() if "ERROR" in line and "word0 " in line)
    assert line.rstrip().endswith("…")
    await pilot.press("l")
    await shown(pilot, "⏎ whole line")
    await pilot.press("enter")
    await shown(pilot, "word39")
    await pilot.press("enter")
    await gone(pilot, "word39")
    engine_of(app).now = replace(engine_of(app).now, routes=())
    app.pull()
    await pilot.press("enter")
    await shown(pilot, "word39")
