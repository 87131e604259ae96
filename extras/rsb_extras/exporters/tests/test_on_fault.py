"""The session's `on_fault` command at a bridge that runs: links and topics that fail, a reload, and its end."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.engine.reloading_helpers import Edited
from tests.support import constants
from tests.support.bridge import carries, find, link, linked, route
from tests.support.domain import text
from tests.support.operators import ANNA, BOB, Reachable
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import read_key
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.wire.messages import Follow, Followed
from rsb_extras.exporters import ON_FAULT
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.tests import exporter_places

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain


class Told:
    """A command that keeps its input."""

    def __init__(self, folder: Path, name: str = "told") -> None:
        self.program = folder / f"{name}.sh"
        self.file = folder / name
        self.program.write_text(f"#!/bin/sh\ncat >> '{self.file}'\n")
        self.program.chmod(0o755)

    def all(self) -> list[dict[str, Any]]:
        """Return all changes; one command lists its own in order."""
        if not self.file.exists():
            return []
        lines = [line for line in self.file.read_text().splitlines(keepends=True) if line.endswith("\n")]
        return [change for report in map(json.loads, lines) for change in (report, *report["others"])]

    def about(self, name: str) -> list[tuple[str, str]]:
        """Return a link's or a topic's events and states."""
        return [(each["event"], each["state"]) for each in self.all() if each["name"] == name]


def test_a_link_that_is_down_and_comes_up(bridge: Bridge, tmp_path: Path) -> None:
    told = Told(tmp_path)
    client = bridge.client(features={"on_fault": str(told.program)})
    eventually(lambda: told.about("robot1") == [("begun", "down")])
    bridge.server()
    eventually(lambda: linked(client))
    eventually(lambda: told.about("robot1") == [("begun", "down"), ("over", "ok")])
    first, last = told.all()
    assert (first["bridge"], first["role"], first["what"], first["ongoing"]) == ("robot1", "client", "link", 1)
    assert (last["previous_state"], last["previous_cause"], last["ongoing"]) == ("down", first["cause"], 0)


def test_publisher_leaves_and_returns_on_both_sides(bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path) -> None:
    """One side has the pattern that made the topic, and the other one only what that proposes."""
    here, there = Told(tmp_path, "here"), Told(tmp_path, "there")
    chat = pc.listener("/chat")
    topic = Topic("/ch*", "transmit", expected_rate=2.0, stale_after=3.0)  # this test looks, and publishes, at 4 Hz
    server, client = (
        bridge.server(features={"on_fault": str(there.program)}),
        bridge.client(topic, features={"on_fault": str(here.program)}),
    )
    out = robot.publisher("/chat")
    eventually(lambda: linked(client) and linked(server) and chat.matched)
    carries([out], server, ["/chat"])

    def publishes() -> bool:
        out.publish(text("hello"))
        return (route := find(client, "/chat")) is not None and route.state is State.OK

    eventually(publishes)
    assert route(client, "/chat").pattern
    for told in (here, there):
        eventually(lambda told=told: [event for event, _ in told.about("/chat")][-1:] in (["begun"], ["changed"]))
        found = [each for each in told.all() if each["name"] == "/chat"][-1]  # a link's end may come after it
        assert (found["kind"], found["what"]) == ("topic", "route")
        assert found["cause"]
        assert found["state"] in (State.STALE, State.STOPPED, State.SLOW)

    def over(told: Told) -> bool:
        publishes()
        return told.about("/chat")[-1] == ("over", "ok")

    for told in (here, there):
        try:
            eventually(lambda told=told: over(told), 150)  # the command is run ten times a minute at most
        except AssertionError:
            raise AssertionError(f"it is not over: {told.all()}") from None


def test_silent_topic_after_reconnection_is_not_over(bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path) -> None:
    """Its publisher went meanwhile."""
    told = Told(tmp_path)
    chat, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = (
        bridge.server(),
        bridge.client(Topic("/chat", "transmit", stale_after=3.0), features={"on_fault": str(told.program)}),
    )
    eventually(lambda: linked(client) and chat.matched)
    carries([out], server, ["/chat"])

    def has_a_rate() -> bool:
        out.publish(text("hello"))
        return route(client, "/chat").expected_rate is not None

    eventually(has_a_rate)
    eventually(lambda: [state for _, state in told.about("/chat")][-1:] == [State.STOPPED])
    before = len(told.about("/chat"))
    server.stop()
    eventually(lambda: [state for _, state in told.about("robot1")][-1:] == [State.DOWN])
    out.destroy()
    bridge.server()
    eventually(lambda: told.about("robot1")[-1] == ("over", State.OK))
    eventually(lambda: [each["cause"] for each in told.all() if each["name"] == "/chat"][-1] == Cause.PUBLISHER_GONE)
    assert told.about("/chat")[-1] == ("changed", State.STOPPED)
    again = robot.publisher("/chat")

    def over() -> bool:
        again.publish(text("hello"))
        return told.about("/chat")[-1] == ("over", State.OK)

    eventually(over)
    assert [event for event, _ in told.about("/chat")[before:]].count("over") == 1


def test_pattern_that_peer_cannot_follow_and_its_end(
    bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # the client keeps silent
    told = Told(tmp_path)
    pattern = Topic("/ch*", "transmit")
    robot = Client("robot1", key_file=bridge.key_file, topics=(pattern,))
    server = bridge.server(key_file=None, clients=(robot,), features={"on_fault": str(told.program)})
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as client:
        client.say(Followed(client.wait_for(Follow).request, more=1))  # more names than it can list
        eventually(lambda: told.about(pattern.topic) == [("begun", State.DOWN)])
        found = told.all()[-1]
        assert (found["what"], found["kind"], found["link"], found["outgoing"]) == ("pattern", "topic", "robot1", False)
        server.remove_topic(link(server).patterns[0].key).result(60)
        eventually(lambda: told.about(pattern.topic)[1:] == [("over", "removed")])


def test_reload_of_file_names_another_command_and_none(bridge: Bridge, tmp_path: Path) -> None:
    one, two = Told(tmp_path, "one"), Told(tmp_path, "two")
    client = bridge.client()
    file = Edited(client, tmp_path / "robot1.yaml")
    assert len(file.reload(features={"on_fault": "./one.sh"}).changed) == 1
    eventually(lambda: one.about("robot1") == [("begun", "down")])
    file.reload(features={"on_fault": ("./two.sh",)})
    eventually(lambda: two.about("robot1") == [("begun", "down")])
    file.reload(features={})
    bridge.server()
    eventually(lambda: linked(client))
    assert len(one.all()) == len(two.all()) == 1


def test_operators_elsewhere_neither_read_nor_reload_command(bridge: Bridge, machine: Machine, tmp_path: Path) -> None:
    told = Told(tmp_path)
    server = bridge.server()
    file = Edited(server, tmp_path / "robot1.yaml")
    file.reload(features={"on_fault": "/bin/true secret"})
    reachable = Reachable(machine, server)
    anna, bob = reachable.attach("anna", ANNA), reachable.attach("bob", BOB)
    for operator in (anna, bob):
        assert ON_FAULT.of(operator.session) is None
        assert operator.session.name == "robot1"
    assert ON_FAULT.of(machine.attach().session) == "/bin/true secret", "saving the file has to keep it"
    with pytest.raises(EngineError):
        bob.reload().result(60)
    assert ON_FAULT.of(server.session) == "/bin/true secret"
    assert not told.file.exists()


def test_a_command_that_hangs_holds_up_nothing(bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.FAULT_COMMAND_RUNS_FOR.set(monkeypatch, 1e6)  # its own time does not end it
    program = tmp_path / "hang.sh"
    program.write_text("#!/bin/sh\ntrap '' TERM\ntouch runs\nwhile :; do sleep 1; done\n")
    program.chmod(0o755)
    client = bridge.client(features={"on_fault": str(program)})
    eventually((bridge.folder / "runs").exists)
    server = bridge.server()
    eventually(lambda: linked(client) and linked(server))
    client.stop()  # the fixture sees that no thread is left
    assert [event for event in client.events() if event.code == ExporterCode.ON_FAULT] == []
