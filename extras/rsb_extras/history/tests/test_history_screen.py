"""The time line: what happened, how long, why and who; filtered, ordered, exported, attached and read-only."""

import csv
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from tests.console.driving import (
    NARROW,
    WIDE,
    drive,
    engine_of,
    gone,
    on_main,
    scripted_app,
    shown,
    shown_at_the_end,
    text,
    until,
)
from tests.console.scripted import NOW, ScriptedEngine, answers, refused
from tests.support.control import Machine
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import State
from rsb_console.app import ConsoleApp
from rsb_extras.history.history_data import Gap, HistoryReport, Outage, ReportHistory
from rsb_extras.history.history_report import ReportText
from rsb_extras.history.history_screen import HELP, HistoryScreen, HistoryText
from rsb_extras.history.tests.scripted_answers import REMEMBERED, answer


def spans(engine: ScriptedEngine) -> list[object]:
    """The spans that were asked for, without repetitions."""
    asked = [command[1] for command in engine.commands if command[0] == "history"]
    return list(dict.fromkeys(asked))


@on_main(*long(WIDE), NARROW)
async def test_outages_and_actions_have_cause_and_length(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("h")
    await shown(pilot, "linked 93.6 % of the time; 1 outage, 3 min 50 s in all")
    await shown(pilot, "4 min 28 s …")
    picture = text(app)
    assert picture.index("▲ STALE") < picture.index("anna") < picture.index("✗ DOWN"), "the newest first"
    await shown(pilot, "=nothing for 15 s")
    await shown(pilot, HELP[-30:])
    await shown_at_the_end(pilot, "the server does not answer (2 topics with it)")
    await shown(pilot, "rate")
    await pilot.press("k", "k")
    await shown(pilot, "edited (max_rate: 5 → max_rate: 2)")
    await pilot.press("escape")
    await gone(pilot, "What happened")


@on_main(WIDE, NARROW)
async def test_columns_are_as_wide_as_their_texts(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    long = "the server does not answer, and has not done so for a long time; look at its log and at the network between"
    states = (State.STOPPED, State.WAITING, "stuck")  # the last one is a newer bridge's
    outages = [
        Outage(NOW - 300.0 * at, 3000.0 + at, "robot1-left", "/robot1/goal_pose", False, state, long)
        for at, state in enumerate(states)
    ]
    answers()[ReportHistory] = partial(answer, report=replace(REMEMBERED, outages=tuple(outages), actions=()))
    await pilot.press("h")
    for word in "■ STOPPED", "◌ WAIT", "STUCK":
        await shown(pilot, word)
    rows = [row for row in text(app).splitlines() if "robot1-left" in row]
    assert rows
    assert all("…" in row[-8:] for row in rows), "a cause that is cut shows that"


@on_main()
async def test_long_line_stays_one_line(app: ConsoleApp, pilot: Pilot[None]) -> None:
    links = [replace(REMEMBERED.tracks[0], link=f"robot{number}") for number in (2, 3)]
    tracks = (*REMEMBERED.tracks, *links)
    answers()[ReportHistory] = partial(answer, report=replace(REMEMBERED, tracks=tracks, outages_left_out=1))
    await pilot.press("h")
    await shown(pilot, HistoryText.LINES_LEFT_OUT, more="1 more line", name="robot1")
    await shown(pilot, HistoryText.OUTAGES_LEFT_OUT, more="1 more outage")


@on_main(NARROW)
async def test_rows_have_room_below_long_totals(app: ConsoleApp, pilot: Pilot[None]) -> None:
    names = [f"robot{number}-on-the-second-floor" for number in range(2, 9)]
    tracks = (*REMEMBERED.tracks, *(replace(each, link=name) for name in names for each in REMEMBERED.tracks))
    outages = tuple(replace(REMEMBERED.outages[0], start=NOW - 3000.0 + at, link="robot1") for at in range(20))
    report = replace(REMEMBERED, tracks=tracks, outages=(*outages, *REMEMBERED.outages[3:]), outages_left_out=3)
    answers()[ReportHistory] = partial(answer, report=report)
    await pilot.press("h")
    await shown(pilot, "▲ STALE")
    await shown(pilot, "rate")
    await until(pilot, lambda: text(app).count("✗ DOWN") >= 3, "rows of outages")


@on_main()
async def test_the_span_the_order_and_the_filter(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("h")
    await shown(pilot, "What happened ▸ last 1 h")
    await pilot.press("h")
    await shown(pilot, "last 8 h")
    await until(pilot, lambda: spans(engine_of(app)) == [3600.0, 28800.0], "asked for 8 h")
    await pilot.press("h")
    await shown(pilot, "last 24 h")
    await pilot.press("h")
    await shown(pilot, "last 1 h")
    await shown(pilot, "✗ DOWN")
    await pilot.press("s")
    await shown(pilot, HistoryText.BY_TOPIC)
    await shown(pilot, "✗ DOWN")
    assert text(app).index("✗ DOWN") > text(app).index("START")
    await pilot.press("slash")
    await pilot.press(*"anna", "enter")
    await shown(pilot, "/anna")
    await gone(pilot, "✗ DOWN")
    await pilot.press("escape")
    await shown(pilot, "✗ DOWN")


@on_main()
async def test_what_is_not_known_is_said(app: ConsoleApp, pilot: Pilot[None]) -> None:
    answers()[ReportHistory] = lambda _: refused("no bridge")
    await pilot.press("h")
    await shown(pilot, HistoryText.NOT_KNOWN, error="no bridge")


@on_main()
async def test_a_report_that_takes_long_is_waited_for(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Another one is asked for before only if it is to be about another span."""
    asked: list[Future[HistoryReport]] = []

    def ask(_: object) -> Future[HistoryReport]:
        asked.append(Future())
        return asked[-1]

    answers()[ReportHistory] = ask
    await pilot.press("h")
    await until(pilot, lambda: len(asked) == 1, "a question")
    assert isinstance(app.screen, HistoryScreen)
    app.screen.renew()
    await pilot.pause()
    assert len(asked) == 1
    await pilot.press("h")
    await until(pilot, lambda: len(asked) == 2, "a question about another span")
    asked[-1].set_result(REMEMBERED)
    await shown(pilot, "✗ DOWN")
    app.screen.renew()
    await until(pilot, lambda: len(asked) == 3, "a newer report")


@on_main()
async def test_a_time_that_nobody_watched_is_told(app: ConsoleApp, pilot: Pilot[None]) -> None:
    answers()[ReportHistory] = partial(
        answer, report=replace(REMEMBERED, outages=(), actions=(), gaps=(Gap(NOW - 2000, 1800.0),))
    )
    await pilot.press("h")
    await shown(pilot, ReportText.RAN_PARTLY, watched="30 min", share="50.0 %")
    await shown(pilot, HistoryText.GAP)


@on_main()
async def test_export_as_text_and_csv(
    app: ConsoleApp, pilot: Pilot[None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    await pilot.press("h")
    await shown(pilot, "✗ DOWN")
    await pilot.press("x")
    await shown(pilot, "written to")
    (lines,) = tmp_path.glob("rsb-history-*.txt")
    assert "anna: /robot1/scan: edited (max_rate: 5 → max_rate: 2)" in lines.read_text()
    (table,) = tmp_path.glob("rsb-history-*.csv")
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows].count("outage") == 4
    assert "'=nothing for 15 s" in [row["cause"] for row in rows]


def test_attached_and_readonly(machine: Machine) -> None:
    engine = machine.have(ScriptedEngine())
    app: ConsoleApp = scripted_app(session=None, path=None, attach_to=machine.folder / "robot1.sock", readonly=True)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press("h")
        await shown(pilot, "the server does not answer (2")
        assert spans(engine) == [3600.0]

    drive(app, steps)
    app.stop()
