"""The input of the `on_fault` command: one object of plain ASCII, for all texts of a peer."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from tests.console.scripted import LINK, NOW, route

from rsb_bridge.model.faults import ChangeKind, FaultChange
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PatternSnapshot, State
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_extras.exporters.fault_hook import fault_report

WICKED = "\x1b]0;gone\x07\n\u202e$(reboot)`id`\ud800" + "x" * 5000


def report(change: FaultChange) -> dict[str, Any]:
    line, count = fault_report([change], time=NOW, bridge="robot1", role="client", ongoing=2, merged=3)
    assert count == 1
    assert line.isascii()
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    content: dict[str, Any] = json.loads(line)
    return content


def test_a_route() -> None:
    scan = route("/scan", State.SLOW, cause=Cause.SLOW, reason="3 of 10 Hz", since=NOW - 3, from_peer=True)
    assert report(FaultChange(ChangeKind.BEGUN, scan, before=("ok", ""))) == {
        "version": 1,
        "event": "begun",
        "time": NOW,
        "bridge": "robot1",
        "role": "client",
        "what": "route",
        "kind": "topic",
        "name": "/scan",
        "link": "robot1",
        "outgoing": False,
        "state": "slow",
        "cause": "slow",
        "text": "3 of 10 Hz",
        "since": NOW - 3,
        "from_peer": True,
        "previous_state": "ok",
        "previous_cause": "",
        "ongoing": 2,
        "merged": 3,
        "others": [],
    }


def test_a_link_and_its_warning() -> None:
    link = replace(LINK, cause=LinkCause.NAME_TAKEN, warning="a second robot1", warning_since=NOW - 7)
    found = report(FaultChange(ChangeKind.CHANGED, link, before=("down", "lost")))
    names = ("event", "what", "name", "state", "cause", "text", "previous_state", "previous_cause")
    assert [found[name] for name in names] == [
        "changed", "link", "robot1", "ok", "name_taken", "a second robot1", "down", "lost",
    ]  # fmt: skip


def test_fault_of_running_link_begins_with_its_warning() -> None:
    full = replace(LINK, cause=LinkCause.FULL, warning="link full", warning_since=NOW - 7)
    assert report(FaultChange(ChangeKind.BEGUN, full))["since"] == NOW - 7
    assert report(FaultChange(ChangeKind.OVER, LINK))["since"] == LINK.since


def test_a_pattern() -> None:
    spec = Topic("/c/*", "transmit")
    partly = PatternSnapshot("key", "robot1", spec, State.DOWN, "1 not bridged", here=True, source="/c/*")
    found = report(FaultChange(ChangeKind.BEGUN, partly, before=("ok", ""), seen=NOW - 3))
    names = ("what", "kind", "name", "link", "outgoing", "state", "cause", "text", "since", "from_peer")
    assert [found[name] for name in names] == [
        "pattern", "topic", "/c/*", "robot1", True, "down", "", "1 not bridged", NOW - 3, False,
    ]  # fmt: skip


def test_what_was_removed() -> None:
    found = report(FaultChange(ChangeKind.OVER, route("/scan", State.SLOW), removed=True, before=("slow", "slow")))
    assert (found["state"], found["cause"], found["text"], found["since"]) == ("removed", "", "", NOW)


def test_a_peers_text_does_nothing_and_is_short() -> None:
    scan = route(f"/{WICKED}", State.SLOW, cause=WICKED, reason=WICKED, link=WICKED)
    line, _ = fault_report(
        [FaultChange(ChangeKind.BEGUN, scan, before=(WICKED, WICKED))],
        time=NOW, bridge=WICKED, role="client", ongoing=1, merged=0,
    )  # fmt: skip
    assert len(line) < 16_384, "it fits into a pipe that nobody reads"
    for text in json.loads(line).values():
        assert not isinstance(text, str) or text.isprintable()


def test_as_many_as_a_pipe_holds() -> None:
    changes = [
        FaultChange(ChangeKind.BEGUN, route(f"/t{number}", State.SLOW, reason="\u202e\U0001f600" * 500))
        for number in range(100)
    ]
    line, count = fault_report(changes, time=NOW, bridge="robot1", role="client", ongoing=100, merged=0)
    assert len(line) < 65_536
    assert 1 < count < 100
    assert [each["name"] for each in json.loads(line)["others"]] == [f"/t{number}" for number in range(1, count)]
