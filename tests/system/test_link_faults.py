"""Why a link is down, in the JSON that the programs of both sides print: their events, and their status."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.waiting import eventually

from rsb_bridge.config.keys import fingerprint, read_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge

    from rsb_bridge.model.session import Session

_PROGRAM = """
import sys
from rsb_bridge.wire import preamble
preamble.VERSION = int(sys.argv[1])
from rsb_console.cli import main
sys.exit(main(["run", *sys.argv[2:]]))
"""
_VERSION = 2


class Program:
    """`rsb-console run --no-ui`, and what it prints."""

    def __init__(self, folder: Path, name: str, session: Session, version: int) -> None:
        path, self._log = folder / f"{name}.yaml", folder / f"{name}.log"
        save(session, path)
        options = ("--no-ui", "--log-format", "json", "--status-every", "0.2", "--control", f"{path}.sock")
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, str(version), str(path), *options],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def _lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._log.read_text().splitlines(keepends=True) if line.endswith("}\n")]

    def link(self) -> dict[str, Any]:
        """What the newest status says of the link."""
        found = [line["status"]["links"] for line in self._lines if "status" in line]
        links: dict[str, dict[str, Any]] = found[-1] if found else {}
        return links.get("robot1", {"state": "", "cause": "", "reason": "", "peer": ""})

    def events(self, code: EventCode) -> list[dict[str, Any]]:
        """Those of a kind."""
        return [line for line in self._lines if line.get("code") == code]

    def stop(self) -> None:
        """End it, as a service manager does."""
        self._process.terminate()
        assert self._process.wait(30) == 0, self._log.read_text()


class Sides:
    """Starts programs; all end with the test."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._programs: list[Program] = []

    def server(self, version: int = _VERSION, **changes: Any) -> Program:
        return self._start("server", self._bridge.server_session(**changes), version)

    def client(self, version: int = _VERSION, **changes: Any) -> Program:
        return self._start("client", self._bridge.client_session(**changes), version)

    def _start(self, role: str, session: Session, version: int) -> Program:
        program = Program(self._bridge.folder, f"{role}{len(self._programs)}", session, version)
        self._programs.append(program)
        return program

    def close(self) -> None:
        for program in self._programs:
            program.stop()


@pytest.fixture
def sides(bridge: Bridge) -> Iterator[Sides]:
    made = Sides(bridge)
    yield made
    made.close()


def has_cause(program: Program, cause: str) -> dict[str, Any]:
    """Wait until the status names the cause of the link's fault."""
    return eventually(lambda: (shown := program.link())["cause"] == cause and shown, what=f"{cause}: {program.link()}")


def test_the_keys_differ(sides: Sides, bridge: Bridge) -> None:
    other = bridge.make_key("other")
    server, client = sides.server(), sides.client(key_file=other)
    marks = [fingerprint(read_key(bridge.folder / name)) for name in (other, bridge.key_file)]
    words = f"the keys of 'robot1' differ: {marks[0]} on the client, {marks[1]} on the server"
    for program, code in ((server, EventCode.LINK_WRONG_KEY), (client, EventCode.LINK_REFUSED)):
        shown = has_cause(program, "wrong_key")
        assert (shown["state"], words in shown["reason"]) == ("down", True)
        (event,) = program.events(code)
        assert words in event["text"]
        assert event["link"] == "robot1"
    assert "127.0.0.1" in server.link()["reason"]


@pytest.mark.parametrize(("there", "older", "newer"), [(1, "client", "server"), (3, "server", "client")])
def test_the_versions_differ(sides: Sides, there: int, older: str, newer: str) -> None:
    server, client = sides.server(), sides.client(version=there)
    programs = {"server": server, "client": client}
    for role in (older, newer):
        shown = has_cause(programs[role], "wrong_version")
        assert shown["state"] == "down"
        assert f"version {_VERSION}" in shown["reason"]
        assert f"version {there}" in shown["reason"]
        which = "this side" if role == older else "the peer"
        assert f"update rsb-console on {which}, which is older" in shown["reason"]
    assert len(server.events(EventCode.LINK_REJECTED)) == len(client.events(EventCode.LINK_REFUSED)) == 1


def test_two_clients_of_one_name(sides: Sides) -> None:
    server, first = sides.server(), sides.client()
    eventually(lambda: first.link()["state"] == "ok")
    second = sides.client()
    shown = has_cause(second, "name_taken")
    assert shown["state"] == "down"
    assert "is linked already, since 2" in shown["reason"]
    assert server.link()["peer"] in shown["reason"]
    shown = has_cause(server, "name_taken")
    assert shown["state"] == "ok"
    assert "a second client, from 127.0.0.1" in shown["reason"]
    (event,) = server.events(EventCode.LINK_NAME_TAKEN)
    assert (event["link"], event["level"]) == ("robot1", "WARNING")
    assert (first.link()["state"], first.link()["cause"]) == ("ok", "")


def test_a_robot_that_should_be_there_and_is_not(sides: Sides) -> None:
    server, client = sides.server(), sides.client()
    seen_at = eventually(lambda: server.link()["state"] == "ok" and server.link()["peer"])
    server_at = client.link()["peer"]
    client.stop()
    shown = has_cause(server, "closed")
    assert (shown["state"], shown["peer"]) == ("down", seen_at)
    assert "the client left" in shown["reason"]
    (event,) = server.events(EventCode.LINK_CLOSED_BY_PEER)
    assert f"link with {seen_at} closed" in event["text"]
    again = sides.client()
    eventually(lambda: again.link()["state"] == "ok" and server.link()["cause"] == "")

    server.stop()
    shown = has_cause(again, "unreachable")
    assert (shown["state"], shown["peer"]) == ("down", server_at)
    refusals = eventually(lambda: again.events(EventCode.LINK_UNREACHABLE))
    assert [event["level"] for event in refusals] == ["WARNING"], "the server said goodbye before"
