"""Patterns on the command line: named as they are written, and told with what they bridge."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.scripted import LINK, SESSION, ScriptedEngine, route

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PatternSnapshot, State
from rsb_console.command.check import summary

if TYPE_CHECKING:
    from tests.support.control import Machine

CAMERA = Topic("/camera/**", "transmit", excepts=("/camera/debug",))
NAV = Topic("/nav/*", "receive", kind="service")
IMAGE = route("/camera/image", outgoing=True, spec=Topic("/camera/image", "transmit"), pattern="/camera/**")


def pattern(spec: Topic, state: State = State.OK, **changes: Any) -> PatternSnapshot:
    return PatternSnapshot(f"key of {spec.topic}", LINK.name, spec, state, "1 bridged", True, spec.topic, **changes)


@pytest.fixture
def engine(machine: Machine) -> ScriptedEngine:
    made = ScriptedEngine(msgspec.structs.replace(SESSION, topics=(CAMERA, NAV)), routes=(IMAGE,))
    link = replace(LINK, patterns=(pattern(CAMERA, routes=1), pattern(NAV, State.WAITING)))
    made.now = replace(made.now, links=(link,))
    machine.serve(made)
    return made


def test_a_topic_says_which_pattern_it_comes_from(ran: Any, engine: ScriptedEngine) -> None:
    told = ran("topics", "--json").json
    assert [each["pattern"] for each in told["topics"]] == ["/camera/**"]
    found = told["links"][LINK.name]["patterns"]
    assert [(each["pattern"], each["state"], each["routes"], each["except"]) for each in found] == [
        ("/camera/**", "ok", 1, ["/camera/debug"]),
        ("/nav/*", "waiting", 0, []),
    ]
    assert "[/camera/**]" in ran("topics").out


def test_pattern_at_limit_is_wrong_waiting_is_fine(ran: Any, engine: ScriptedEngine) -> None:
    assert ran("status").code == 0
    full = replace(LINK, patterns=(pattern(CAMERA, State.DOWN, routes=100, beyond=3),))
    engine.now = replace(engine.now, links=(full,))
    status = ran("status", "--json")
    assert (status.code, len(status.json["wrong"])) == (1, 1)
    assert "/camera/**" in status.json["wrong"][0]


def test_a_pattern_is_named_as_it_is_written(ran: Any, engine: ScriptedEngine) -> None:
    assert ran("remove", "/camera/**").code == 0
    assert ran("edit", "/camera/**", "max_rate=5", "except=/camera/a, /camera/b/*").code == 0
    assert ran("pause", "--kind", "service", "/nav/*").code == 0
    assert ran("add", "/map/*", "transmit", "except=/map/raw").code == 0
    edited = msgspec.structs.replace(CAMERA, max_rate=5.0, excepts=("/camera/a", "/camera/b/*"))
    assert engine.commands == [
        ("remove", "key of /camera/**"),
        ("edit", "key of /camera/**", edited),
        ("pause", "key of /nav/*", True),
        ("add", Topic("/map/*", "transmit", excepts=("/map/raw",)), ""),
    ]


@pytest.mark.parametrize(
    "arguments",
    [("remove", "/camera/*"), ("edit", "/camera/**", "except=camera"), ("add", "/a**", "transmit"), ("echo", "/nav/*")],
    ids=" ".join,
)
def test_what_is_no_pattern_is_not_done(arguments: tuple[str, ...], ran: Any, engine: ScriptedEngine) -> None:
    assert ran(*arguments).code == 2
    assert engine.commands == []


def test_pattern_that_is_there_twice_needs_more_words(ran: Any, engine: ScriptedEngine) -> None:
    both = (CAMERA, msgspec.structs.replace(CAMERA, direction="receive"))
    engine.now = replace(engine.now, links=(replace(LINK, patterns=tuple(map(pattern, both))),))
    assert ran("remove", "/camera/**").code == 2
    assert ran("remove", "/camera/**", "--direction", "receive").code == 0


def test_check_names_pattern_and_what_it_leaves_out() -> None:
    lines = list(summary(msgspec.structs.replace(SESSION, topics=(CAMERA, NAV))))
    assert any("matches /camera/**" in line and "/camera/debug" in line for line in lines)
    assert any("service that matches /nav/*" in line for line in lines)
