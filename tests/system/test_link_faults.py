"""Causes of a link that is down, on both screens and in the JSON of both programs: events and status.

The programs run headless, and a console in a real terminal is attached to each.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import signal
import socket
import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.live import COMMAND
from tests.console.tmux import Tmux
from tests.support.forker import Forked
from tests.support.log_lines import check_lines
from tests.support.long import long_cases
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.keys import fingerprint, read_key
from rsb_bridge.config.session_file import save
from rsb_bridge.link.refused_clients import SameName
from rsb_bridge.model.codes import EventCode
from rsb_bridge.wire.preamble import RefusalText

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge

    from rsb_bridge.model.session import Session

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="it needs tmux (apt install tmux)")

_VERSION = 1
_WIDE = (240, 30)
"""Columns and lines: a sentence fits in a line."""


class Program:
    """`rsb-console run --no-ui`, what it prints, and a console that is attached to it."""

    def __init__(self, folder: Path, name: str, session: Session, version: int) -> None:
        path, self._log = folder / f"{name}.yaml", folder / f"{name}.log"
        self._folder, self._control = folder / name, folder / f"{name}.sock"
        self._screen: Tmux | None = None
        save(session, path)
        options = ("--no-ui", "--log-format", "json", "--status-every", "0.2", "--control", str(self._control))
        with self._log.open("w") as log:
            program = ("rsb_console",) if version == _VERSION else ("tests.system.other_version", str(version))
            self._process = Forked(*program, "run", str(path), *options, stdout=log, stderr=subprocess.STDOUT)

    @property
    def _lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._log.read_text().splitlines(keepends=True) if line.endswith("}\n")]

    def link(self) -> dict[str, Any]:
        """Return the link of the newest status."""
        found = [line["status"]["links"] for line in self._lines if "status" in line]
        links: dict[str, dict[str, Any]] = found[-1] if found else {}
        return links.get("robot1", {"state": "", "cause": "", "reason": "", "peer": ""})

    def events(self, *codes: EventCode) -> list[dict[str, Any]]:
        """Wait for events of some kinds: a status may be written before the event that causes it."""
        return eventually(lambda: [line for line in self._lines if line.get("code") in codes], what=f"{codes}")

    def screen(self, *words: str) -> str:
        """Wait until the console shows these words, each of which may be drawn by itself; all that it shows then."""
        if self._screen is None:
            eventually(self._control.exists, what="it serves consoles")
            self._folder.mkdir()
            command = (str(COMMAND), "attach", "--control", str(self._control))
            self._screen = Tmux(self._folder, *command, size=_WIDE)
        picture = ""
        while not all(each in picture for each in words):
            for each in words:
                picture = self._screen.wait_for(each)
        return picture

    def freeze(self) -> None:
        """It falls silent, without an end of its connections."""
        self._process.send_signal(signal.SIGSTOP)

    def stop(self) -> None:
        """End it, as a service manager does. Every line that it wrote names the link."""
        if self._screen is not None:
            self._screen.__exit__()
            self._screen = None
        self._process.terminate()
        self._process.send_signal(signal.SIGCONT)
        assert self._process.wait(60) == 0, self._log.read_text()
        check_lines(line for line in self._lines if "code" in line)


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
        with contextlib.ExitStack() as programs:  # all of them, in any order
            for program in self._programs:
                programs.callback(program.stop)


@pytest.fixture
def sides(bridge: Bridge) -> Iterator[Sides]:
    with contextlib.closing(Sides(bridge)) as made:
        yield made


def has_cause(program: Program, cause: str) -> dict[str, Any]:
    """Wait until the status names the cause of the link's fault."""
    return eventually(lambda: (shown := program.link())["cause"] == cause and shown, what=f"{cause}: {program.link()}")


def test_the_keys_differ(sides: Sides, bridge: Bridge) -> None:
    other = bridge.make_key("other")
    server, client = sides.server(), sides.client(key_file=other)
    marks = [fingerprint(read_key(bridge.folder / name)) for name in (other, bridge.key_file)]
    words = RefusalText.KEYS_DIFFER(name="robot1", theirs=marks[0], there="client", ours=marks[1], here="server")
    for program, code in ((server, EventCode.LINK_WRONG_KEY), (client, EventCode.LINK_REFUSED)):
        shown = has_cause(program, "wrong_key")
        assert (shown["state"], words in shown["reason"]) == ("down", True)
        (event,) = program.events(code)
        assert words in event["text"]
        assert event["link"] == "robot1"
        program.screen("✗ robot1: ", words)
    assert (event["state"], event["cause"]) == ("down", "wrong_key")
    assert event["since"] <= event["time"]
    assert "127.0.0.1" in server.link()["reason"]
    server.screen(f"✗ robot1: refused 127.0.0.1: {words}")


@pytest.mark.parametrize(("there", "older", "newer"), [(0, "client", "server"), *long_cases((2, "server", "client"))])
def test_the_versions_differ(sides: Sides, there: int, older: str, newer: str) -> None:
    server, client = sides.server(), sides.client(version=there)
    programs = {"server": server, "client": client}
    versions = {"server": _VERSION, "client": there}
    for role, other in ((older, newer), (newer, older)):
        shown = has_cause(programs[role], "wrong_version")
        assert shown["state"] == "down"
        code = RefusalText.THIS_SIDE_OLDER if role == older else RefusalText.PEER_OLDER
        words = code(ours=versions[role], theirs=versions[other])
        assert words in shown["reason"]
        programs[role].screen("✗ robot1: ", words)
    assert len(server.events(EventCode.LINK_REJECTED)) == len(client.events(EventCode.LINK_REFUSED)) == 1


def test_two_clients_of_one_name(sides: Sides) -> None:
    server, first = sides.server(), sides.client()
    eventually(lambda: first.link()["state"] == "ok")
    second, address = sides.client(), f"127.0.0.1 (host {socket.gethostname()})"
    shown = has_cause(second, "name_taken")
    assert shown["state"] == "down"
    assert says(shown["reason"], SameName.TAKEN, name="robot1")
    assert server.link()["peer"] in shown["reason"]
    shown = has_cause(server, "name_taken")
    assert shown["state"] == "ok"
    assert says(shown["reason"], SameName.SECOND, name="robot1", address=address)
    (event,) = server.events(EventCode.LINK_NAME_TAKEN)
    assert (event["link"], event["level"]) == ("robot1", "WARNING")
    shown = has_cause(first, "name_taken")
    assert shown["state"] == "ok"
    assert says(shown["reason"], SameName.SECOND, name="robot1", address=address)
    peer = f"{server.link()['peer']} (host {socket.gethostname()})"
    said = second.screen("✗ robot1: ", peer)
    assert says(said, SameName.TAKEN, name="robot1", address=peer)
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", said)
    for side in (server, first):
        side.screen(f"robot1: {SameName.SECOND(name='robot1', address=address)}", "● LINKED")


def test_restart_takes_place_of_one_that_is_silent(sides: Sides) -> None:
    server, old = sides.server(), sides.client()
    before = eventually(lambda: server.link()["state"] == "ok" and server.link()["peer"])
    old.freeze()
    new = sides.client()
    eventually(lambda: new.link()["state"] == "ok")
    # A machine on which the new one takes five seconds to start has noticed the silence by itself.
    (event,) = server.events(EventCode.LINK_REPLACED, EventCode.LINK_LOST)
    assert event["level"] == "WARNING"
    eventually(lambda: server.link()["peer"] != before, what="its status")
    assert event["text"].startswith(f"link with the client at {before} ")
    server.screen(f"WARN  link   robot1: link with the client at {before} ", "● LINKED")
    new.screen("● LINKED")


def test_robot_that_should_be_there_and_is_not(sides: Sides) -> None:
    server, client = sides.server(), sides.client()
    seen_at = eventually(lambda: server.link()["state"] == "ok" and server.link()["peer"])
    server_at = eventually(lambda: client.link()["state"] == "ok" and client.link()["peer"])
    client.stop()
    shown = has_cause(server, "closed")
    assert (shown["state"], shown["peer"]) == ("down", seen_at)
    assert "the client left" in shown["reason"]
    (event,) = server.events(EventCode.LINK_CLOSED_BY_PEER)
    assert f"link with the client at {seen_at} closed" in event["text"]
    said = server.screen(f", last seen at {seen_at}: the client left")
    assert re.search(r"✗ robot1: missing since \d\d:\d\d, last seen at ", said)
    again = sides.client()
    eventually(lambda: again.link()["state"] == "ok" and server.link()["cause"] == "")

    server.stop()
    shown = has_cause(again, "unreachable")
    assert (shown["state"], shown["peer"]) == ("down", server_at)
    refusals = again.events(EventCode.LINK_UNREACHABLE)
    assert [event["level"] for event in refusals] == ["WARNING"], "the server said goodbye before"
    again.screen(f"✗ robot1: {server_at}: ")
