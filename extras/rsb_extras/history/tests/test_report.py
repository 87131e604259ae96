"""`rsb-console report` of a running bridge and of a stopped one, as text, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import platform
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import LINK, NOW, ScriptedEngine
from tests.support import surroundings
from tests.support.wording import says

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level, State
from rsb_console.command.formatting import where_and_why
from rsb_extras.history import history_files
from rsb_extras.history.history_data import Gap, Track
from rsb_extras.history.history_report import ReportText, csv_report, did, length, parse_span, percent, text_report
from rsb_extras.history.report_command import ReportProblem
from rsb_extras.history.tests import history_places
from rsb_extras.history.tests.scripted_answers import REMEMBERED
from rsb_extras.history.tests.world import World
from rsb_extras.history.timeline import FROM_THE_FUTURE

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.control import Machine


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("TZ", "UTC")
    history_places.SERVICES_STATE.set(monkeypatch, tmp_path / "none")
    (tmp_path / "state" / "rsb-console").mkdir(parents=True)
    return tmp_path / "state" / "rsb-console"


def test_a_hand_over_begins_with_the_totals(ran: Any, machine: Machine) -> None:
    engine = machine.have(ScriptedEngine())
    report = ran("report", "--last", "1h")
    assert report.code == 0
    assert engine.commands == [("history", 3600.0, "")]
    lines = report.out.splitlines()
    assert lines[0].startswith("robot1 (client): the last 1 h, ")
    assert lines[1:7] == [
        ReportText.RAN_ALL_THE_TIME(stopped=""),
        "robot1: linked 93.6 % of the time; 1 outage, 3 min 50 s in all.",
        "2 topics: 0 without an outage, 2 with.",
        "  robot1 ← /robot1/map: up 86.1 % of the time; 2 outages (1 with the link), 8 min 20 s in all.",
        "  robot1 ← /robot1/scan: up 93.6 % of the time; 1 outage (1 with the link), 3 min 50 s in all.",
        "",
    ]
    outages = [line.strip() for line in lines[7:]]
    assert outages[:3] == ["Outages", "robot1", "link"]
    assert outages[3].endswith("DOWN  3 min 50 s: the server does not answer (2 topics with it)")
    assert outages[4] == "← /robot1/map"
    assert outages[5].endswith("STALE  4 min 28 s, still so: =nothing for 15 s")
    assert outages[7] == ReportText.ACTIONS()
    assert outages[8].endswith("anna: /robot1/odom: paused")
    assert outages[9].endswith("anna: /robot1/scan: edited (max_rate: 5 → max_rate: 2)")


def test_for_programs_and_for_a_spreadsheet(ran: Any, machine: Machine) -> None:
    machine.serve(ScriptedEngine())
    report = json.loads(ran("report", "--json").out)
    assert report["span"] == 8 * 3600
    assert report["outages"][0]["cause"] == "the server does not answer"
    assert report["operator_machine"]["host"] == platform.node(), "not the bridge's, which may be another one"
    assert "machine" not in report
    assert report["tracks"][0]["up_ratio"] == 3370 / 3600
    rows = list(csv.DictReader(io.StringIO(ran("report", "--csv").out)))
    assert [row["kind"] for row in rows] == ["outage"] * 3 + ["event"] * 2 + ["outage"]
    assert rows[-1]["cause"] == "'=nothing for 15 s", "no formula"
    assert (rows[4]["who"], rows[4]["old"], rows[4]["new"]) == ("anna", "max_rate: 5", "max_rate: 2")


@pytest.mark.parametrize(
    ("text", "cell"),
    [(each, f"'{each}") for each in ("=1+1", "+1", "-1", "@x", "＝1+1")]
    + [("\t=1", "\\t=1"), ("\r=1", "\\r=1"), ("\n=1", "\\n=1")],
)
def test_a_cell_is_never_a_formula(text: str, cell: str) -> None:
    outage = replace(REMEMBERED.outages[0], cause=text)
    (row, *_) = csv.DictReader(io.StringIO(csv_report(replace(REMEMBERED, outages=(outage,)))))
    assert row["cause"] == cell


def test_report_of_stopped_bridge_reads_its_files(ran: Any, state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World("/scan")
    world.go(600)
    world.put("/scan", State.DOWN, "no publisher of /scan")
    world.go(60)
    world.timeline.cut()
    history_files.write_history(state / "robot1.history", world.recorder.save())
    surroundings.set_wall_clock(monkeypatch, lambda: world.clock.wall + 600)
    report = ran("report", "robot1")
    assert report.code == 0
    assert ReportText.STOPPED().strip() in report.out
    assert "DOWN  at least 1 min: no publisher of /scan" in report.out
    assert says(report.out, ReportText.RAN_PARTLY)
    assert "11 min" in report.out
    assert ran("report").code == 0, "it is the only one"
    (state / "robot2.history").write_bytes((state / "robot1.history").read_bytes())
    several = ran("report")
    assert several.code == 2
    assert f"robot2: {state / 'robot2.history'}" in several.err
    (state / "robot1.history").write_bytes(b"nonsense")
    damaged = ran("report", "robot1")
    assert (damaged.code, "it is damaged" in damaged.err) == (3, True)


def test_what_it_cannot_do_is_said(ran: Any, machine: Machine) -> None:
    assert ran("report").code == 3
    assert says(ran("report", "robot9").err, ReportProblem.NOTHING_OF_BRIDGE, name="robot9")
    machine.serve(ScriptedEngine())
    assert says(ran("report", "--last", "8").err, ReportText.NO_TIME, span="8")
    assert says(ran("report", "--last", "3d").err, ReportText.TOO_LONG_AGO, span="3d")


def test_words() -> None:
    assert [parse_span(text) for text in ("90s", "30m", "30min", "8h", "1d", "1.5h")] == [
        90, 1800, 1800, 28800, 86400, 5400,
    ]  # fmt: skip
    assert [length(seconds) for seconds in (0.2, 12, 60, 220, 3600, 28320)] == [
        "under 1 s", "12 s", "1 min", "3 min 40 s", "1 h", "7 h 52 min",
    ]  # fmt: skip
    assert [percent(ratio) for ratio in (None, 1.0, 0.99999, 0.5)] == ["—", "100 %", "99.9 %", "50.0 %"]


def test_what_only_waited_was_neither_up_nor_out() -> None:
    track = Track("robot1", "/map", True, 0.0, 0.0, 0, (), 3600.0, "no publisher of /map")
    later = replace(track, topic="/scan", up=1200.0, waiting=2400.0, waits_for="")
    robot2 = replace(track, link="robot2", topic="", waits_for="not connected yet")
    report = replace(REMEMBERED, outages=(), actions=(), tracks=(track, later, robot2))
    assert list(text_report(report))[2:5] == [
        "robot2: waited 1 h (not connected yet).",
        "2 topics: 1 without an outage, 1 without any message yet.",
        "  robot1 → /map: waited 1 h (no publisher of /map).",
    ]
    assert percent(track.up_ratio) == "—"
    out = replace(later, out=1200.0, outages=1)
    words = "  robot1 → /scan: up 50.0 % of the time, waited 40 min; 1 outage, 20 min in all."
    assert words in list(text_report(replace(report, tracks=(out,))))
    short = replace(out, waiting=5.0)
    assert "waited" not in "".join(text_report(replace(report, tracks=(short,))))


def test_day_is_said_where_it_is_another_one() -> None:
    began = NOW - 10 * 3600
    night = replace(REMEMBERED, span=12 * 3600.0, outages=(replace(REMEMBERED.outages[0], start=began),))
    lines = list(text_report(night))
    assert lines[0].endswith(time.strftime(" to %a %Y-%m-%d %H:%M:%S", time.gmtime(NOW)))
    hour = next(text_report(REMEMBERED))
    assert hour.endswith(f"{time.strftime('%a %Y-%m-%d %H:%M:%S', time.gmtime(NOW - 3600))} to {_time(NOW)}")
    assert time.gmtime(began).tm_yday != time.gmtime(NOW).tm_yday
    (line,) = (line for line in lines if "DOWN" in line)
    assert line.strip().startswith(time.strftime("%a %H:%M:%S  DOWN", time.gmtime(began)))
    event = REMEMBERED.actions[0]
    assert f"  {_time(event.time)}  anna: {event.text}" in lines


def _time(moment: float) -> str:
    return time.strftime("%H:%M:%S", time.gmtime(moment))


def test_values_are_said_once() -> None:
    paused = replace(REMEMBERED.actions[0], code=EventCode.OPERATOR_PAUSED, text="/scan: paused by anna")
    assert did(replace(paused, old="not paused", new="paused")) == "/scan: paused by anna"
    edited = replace(paused, code=EventCode.OPERATOR_EDITED, text="/scan: edited by anna", old="5", new="2")
    assert did(edited) == "/scan: edited by anna (5 → 2)"
    assert did(replace(edited, text="/scan: added by anna", old="")) == "/scan: added by anna (2)"
    assert did(replace(edited, text="/scan: removed by anna", new="")) == "/scan: removed by anna (was 5)"
    called = replace(edited, code=EventCode.OPERATOR_CALL_ENDED, text="/dock: called (failed) by anna")
    assert did(replace(called, old="", new="failed")) == called.text


def test_files_from_future_say_so(ran: Any, state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World("/scan")
    world.go(60)
    history_files.write_history(state / "robot1.history", world.recorder.save())
    surroundings.set_wall_clock(monkeypatch, lambda: world.clock.wall + 600)
    event = Event(1, world.clock.wall + 1e8, Level.INFO, EventCode.ROUTE_PAUSED, "paused by anna", who="anna")
    (state / "robot1.jsonl").write_bytes(history_files.encode_event(event))
    report = ran("report", "robot1", "--last", "1h")
    assert report.code == 0
    assert says(report.out, ReportText.RAN_PARTLY, watched="1 min", share="1.7 %")
    assert "anna" not in report.out
    surroundings.set_wall_clock(monkeypatch, lambda: world.clock.wall - 1e6)
    report = ran("report", "robot1")
    assert (report.code, FROM_THE_FUTURE in report.err) == (3, True)


def test_a_quiet_night_is_short() -> None:
    fine = replace(REMEMBERED, outages=(), actions=(), tracks=(replace(REMEMBERED.tracks[0], out=0.0, outages=0),))
    assert list(text_report(fine))[1:] == [
        ReportText.RAN_ALL_THE_TIME(stopped=""),
        "robot1: linked 100 % of the time.",
        "",
        ReportText.NO_OUTAGES(),
    ]
    gap = replace(fine, gaps=(Gap(NOW - 1800, 900.0),))
    assert says("\n".join(text_report(gap)), ReportText.RAN_PARTLY, watched="45 min", share="75.0 %")


@pytest.mark.parametrize(
    "reason", ["10.0.0.20:49152: Connection refused", "10.0.0.20:49152 answers as HTTP", "no answer", ""]
)
def test_a_link_names_its_peer_once(reason: str) -> None:
    said = where_and_why(replace(LINK, state=State.DOWN, reason=reason, peer="10.0.0.20:49152"))
    assert said.count("10.0.0.20:49152") == 1
    assert reason.removeprefix("10.0.0.20:49152: ") in said
