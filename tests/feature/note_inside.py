"""The feature of docs/a-feature.md, where it is installed: `test_a_feature` runs this in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from rsb_note import KEEP_NOTES, NOTE  # type: ignore[import-not-found]
from rsb_note.bridge import WriteNote  # type: ignore[import-not-found]
from tests.command.conftest import here, ran
from tests.console.driving import drive, engine_of, scripted_app, shown, until
from tests.console.scripted import ROUTES
from tests.support.bridge import happened, is_accepted, reloaded, route
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import dump, save
from rsb_bridge.config.validation import build
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from textual.pilot import Pilot

    from rsb_bridge.engine.engine import Engine

__all__ = ["here", "ran"]  # fixtures
SCAN = Topic("/scan", "transmit", type="std_msgs/msg/String")


def shows(engine: Engine, text: str) -> None:
    eventually(lambda: NOTE.of(route(engine, "/scan")) == text, what=f"the note {text!r}")


def write(engine: Engine, text: str) -> None:
    engine.do(WriteNote(route(engine, "/scan").key, text)).result(60)


def test_both_sides_show_a_note(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    write(client, "lens is dirty")
    shows(client, "lens is dirty")
    shows(server, "lens is dirty")
    assert happened(client, "note.written", "lens is dirty")  # type: ignore[arg-type]
    write(server, "")
    shows(client, "")


def test_note_written_while_unlinked_crosses_later(bridge: Bridge) -> None:
    client = bridge.client(SCAN)
    write(client, "wheel rubs")
    server = bridge.server()
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    shows(server, "wheel rubs")


def test_note_ends_after_the_sessions_time(bridge: Bridge, tmp_path: Path) -> None:
    client = bridge.client(SCAN)
    write(client, "soon gone")
    shows(client, "soon gone")
    path = tmp_path / "robot1.yaml"
    save(client.session, path)
    client.use_file(path)
    assert reloaded(client, path, features={"keep_notes": 0.1}).changed == ("keep_notes 3600.0 → 0.1",)
    shows(client, "")


def test_session_file_has_its_key() -> None:
    fine = {"name": "robot1", "role": "server", "server_ip": "127.0.0.1", "server_port": 7060, "use_encryption": False}
    assert [(each.location, each.message) for each in build(fine | {"keep_notes": -1})[1]] == [
        ("keep_notes", "give seconds above 0")
    ]
    session, problems = build(fine | {"keep_notes": 60})
    assert not problems
    assert KEEP_NOTES.of(session) == 60.0
    assert "keep_notes: 60" in dump(session)


def test_a_key_of_the_console_writes_a_note() -> None:
    app = scripted_app(routes=ROUTES)
    given: list[Any] = []

    def take(command: Any) -> Future[Any]:
        given.append(command)
        done: Future[Any] = Future()
        done.set_result(None)
        return done

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, ROUTES[0].topic)
        await shown(pilot, "NOTE")
        engine_of(app).answering = take
        await pilot.press("M", *"ok", "enter")
        await until(pilot, lambda: given, "a command")

    drive(app, steps, size=(240, 36))
    assert [type(each) for each in given] == [WriteNote]
    assert given[0].text == "ok"


def test_a_subcommand_writes_a_note(bridge: Bridge, machine: Any, ran: Any) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    machine.serve(client)
    assert ran("note", "/scan", "lens is dirty").code == 0
    shows(server, "lens is dirty")
    (shown_route,) = (each for each in ran("status", "--json").json["routes"] if each["topic"] == "/scan")
    assert shown_route["note"] == "lens is dirty"
    assert ran("note", "/none", "lens is dirty").code == 2


def test_a_subcommand_costs_nothing_until_it_runs() -> None:
    program = "import sys; from rsb_console.command.arguments import parser_and_commands; parser_and_commands()"
    program += "; print('rsb_note' in sys.modules, {'rsb_note.console', 'rsb_note.bridge', 'textual'} & {*sys.modules})"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=180, check=True)
    assert ran.stdout == "True set()\n"
