"""A topic, a service, an action and a node's parameters of the same name."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from typing import TYPE_CHECKING

from tests.console.scripted import route

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.model.session import Kind, Topic
from rsb_bridge.model.snapshot import Ledger, State
from rsb_extras.history import history_files
from rsb_extras.history.history_report import csv_report, json_report, text_report
from rsb_extras.history.history_screen import rows_of
from rsb_extras.history.tests.world import World
from rsb_extras.history.timeline import Timeline

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_extras.history.history_data import HistoryReport

NAME = "/planner"
KINDS: tuple[Kind, ...] = ("topic", "service", "action", "parameters")


def lived() -> World:
    """Play ten minutes of a route of each kind: the service has an outage, the action two calls a second."""
    world = World()
    for kind in KINDS:
        calls = None if kind == "topic" else CallsSnapshot()
        spec = Topic(NAME, "receive", kind=kind)
        world.routes[kind] = replace(route(NAME, ledger=Ledger()), key=kind, spec=spec, calls=calls)
    world.go(301)  # from the first second on they are there
    world.put("service", State.DOWN, "no server")
    for second in range(60):
        world.routes["action"] = replace(world.routes["action"], calls=CallsSnapshot(asked=2 * second))
        world.go(1)
    world.put("service", State.OK)
    world.go(240)
    return world


def check(report: HistoryReport) -> None:
    (outage,) = report.outages
    assert (outage.topic, outage.kind, outage.seconds) == (NAME, "service", 60)
    tracks = {each.kind: each for each in report.tracks if each.topic}
    assert tracks.keys() == set(KINDS)
    assert [(tracks[kind].up, tracks[kind].out) for kind in KINDS] == [(600, 0), (540, 60), (600, 0), (600, 0)]
    assert [each.kind for each in report.tracks if not each.topic] == ["link"]
    assert max(rate or 0.0 for rate in tracks["topic"].rates) == 10
    assert 1.5 < max(rate or 0.0 for rate in tracks["action"].rates) <= 2


def test_each_has_a_line_of_its_own() -> None:
    check(lived().report())


def test_they_are_told_apart_after_a_restart(tmp_path: Path) -> None:
    world = lived()
    world.timeline.cut()
    path = tmp_path / "robot1.history"
    history_files.write_history(path, world.recorder.save())
    check(
        Timeline.restore(history_files.read_history(path), "robot1", "client").report(
            world.clock.wall, 3600.0, running=False
        )
    )


def test_text_csv_json_and_time_line_say_which() -> None:
    world = lived()
    world.put_link(State.DOWN, "no answer")
    world.go(20)
    report = world.report()
    lines = list(text_report(report))
    assert [line for line in lines if NAME in line] == [
        "  robot1 ← /planner: up 96.8 % of the time; 1 outage (1 with the link), 20 s in all.",
        "  robot1 ← service /planner: up 87.1 % of the time; 2 outages (1 with the link), 1 min 20 s in all.",
        "  robot1 ← action /planner: up 96.8 % of the time; 1 outage (1 with the link), 20 s in all.",
        "  robot1 ← parameters /planner: up 96.8 % of the time; 1 outage (1 with the link), 20 s in all.",
        "    ← service /planner",
    ]
    assert any("(1 topic, 1 service, 1 action, parameters of 1 node with it)" in line for line in lines)
    rows = list(csv.DictReader(io.StringIO(csv_report(report))))
    assert sorted(row["is_a"] for row in rows if row["kind"] == "outage") == sorted((*KINDS, "service", "link"))
    told = json.loads(json_report(report))
    assert {each["kind"] for each in told["tracks"]} == {*KINDS, "link"}
    assert sorted(each["kind"] for each in told["outages"]) == sorted((*KINDS, "service", "link"))
    (row,) = [row for row in rows_of(report) if NAME in row.topic]
    assert row.topic == "← service /planner"
    assert row.track is not None
    assert (row.track.kind, row.track.outages) == ("service", 2)
