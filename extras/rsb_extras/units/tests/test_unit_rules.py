"""Units and the right to ask for them in session files: their mistakes, what `check` says, and who sees them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.scripted import SESSION

from rsb_bridge.config.rights import rights_of_client, rights_of_server
from rsb_bridge.config.session_changes import changes, with_client
from rsb_bridge.config.session_file import SessionError, dump, load
from rsb_bridge.config.validation import build, validate
from rsb_bridge.model.session import Client
from rsb_extras.units import FEATURE, MAY_ASK, UNITS, ListedUnit
from rsb_extras.units.unit_records import MOST_UNITS

if TYPE_CHECKING:
    from pathlib import Path

ROBOT: dict[str, Any] = {
    "name": "robot1", "role": "client", "server_ip": "10.0.0.20", "server_port": 49152, "key_file": "r.key"
}  # fmt: skip
NAV = {"restart": ["systemctl", "restart", "nav.service"], "status": ["systemctl", "is-active", "nav.service"]}


def mistakes(**given: Any) -> dict[str, str]:
    return {problem.location: problem.message for problem in build({**ROBOT, **given})[1]}


def test_units_are_read_from_a_file_and_written_again(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(
        "name: robot1\nrole: client\nserver_ip: 10.0.0.20\nserver_port: 7060\nkey_file: r.key\n"
        "units:\n  nav:\n    restart: [systemctl, restart, nav.service]\n    nodes: [/planner_server]\n"
        "  lidar: {restart: [docker, restart, lidar], timeout: 10}\nmay: {units: [nav]}\n"
    )
    session = load(path)
    restart = ("systemctl", "restart", "nav.service")
    assert UNITS.of(session)["nav"] == ListedUnit(restart=restart, nodes=("/planner_server",))
    assert MAY_ASK.of(rights_of_server(session)) == ("nav",)
    again = tmp_path / "again.yaml"
    again.write_text(dump(session))
    assert load(again) == session


def test_mistakes_name_their_line(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(
        "name: robot1\nrole: client\nserver_ip: 10.0.0.20\nserver_port: 7060\nkey_file: r.key\n"
        "units:\n  nav:\n    restart: [bin/nav]\n    stop: systemctl stop nav\n"
    )
    with pytest.raises(SessionError) as raised:
        load(path)
    assert f"{path}:8: units.nav.restart: bin/nav: give an absolute path" in str(raised.value)
    assert f"{path}:9: units.nav.stop: 'systemctl stop nav' is not a list" in str(raised.value)


@pytest.mark.parametrize(
    ("units", "place"),
    [
        ({"a/b": NAV}, "units.a/b"),
        ({"../x": NAV}, "units.../x"),
        ({"": NAV}, "units."),
        ({"x" * 64: NAV}, f"units.{'x' * 64}"),
        ({"nav": {}}, "units.nav"),
        ({"nav": {"log": ["journalctl"]}}, "units.nav"),
        ({"nav": {**NAV, "start": [""]}}, "units.nav.start"),
        ({"nav": {**NAV, "start": ["./a"]}}, "units.nav.start"),
        ({"nav": {**NAV, "log": ["a", "b\0"]}}, "units.nav.log"),
        ({"nav": {**NAV, "log": ["a", "\ud800"]}}, "units.nav.log"),
        ({"nav": {**NAV, "start": ["a"] * 65}}, "units.nav.start"),
        ({"nav": {**NAV, "start": ["a" * 5000]}}, "units.nav.start"),
        ({"nav": {**NAV, "start": [1]}}, "units.nav.start[0]"),
        ({"nav": {**NAV, "timeout": 0.5}}, "units.nav.timeout"),
        ({"nav": {**NAV, "timeout": 121}}, "units.nav.timeout"),
        ({"nav": {**NAV, "nodes": ["planner"]}}, "units.nav.nodes[0]"),
        ({"nav": {**NAV, "nodes": ["/n"] * 65}}, "units.nav.nodes"),
        ({"nav": {**NAV, "shell": "x"}}, "units.nav.shell"),
        ({"nav": "x"}, "units.nav"),
        ({f"u{number}": NAV for number in range(MOST_UNITS + 1)}, "units"),
        (["nav"], "units"),
    ],
)
def test_a_mistake_is_found_at_its_place(units: Any, place: str) -> None:
    assert place in mistakes(units=units)


def test_may_names_units_of_this_session() -> None:
    assert mistakes(units={"nav": NAV}, may={"units": ["nav"]}) == {}
    assert "may.units[1]" in mistakes(units={"nav": NAV}, may={"units": ["nav", "lidar"]})
    assert "may.units[0]" in mistakes(may={"units": ["nav"]})
    assert "may.units" in mistakes(units={"nav": NAV}, may={"units": "nav"})
    assert "may.topics" in mistakes(may={"topics": ["/scan"]})
    assert "may" in mistakes(may="all")


def test_a_server_gives_the_right_to_each_client() -> None:
    clients = [{"name": "robot1", "key_file": "a", "may": {"units": ["nav"]}}, {"name": "robot2", "key_file": "b"}]
    server = {**ROBOT, "name": "pc", "role": "server", "units": {"nav": NAV}}
    session, problems = build({**server, "clients": clients})
    assert not problems
    assert [MAY_ASK.of(rights_of_client(each, "pc")) for each in session.listed_clients] == [("nav",), ()]
    assert {each.location for each in build({**server, "clients": clients, "may": {"units": ["nav"]}})[1]} == {"may"}
    session, _ = build({**server, "may": {"units": ["nav"]}})
    both = with_client(session, Client("robot2", key_file="l"))
    assert [MAY_ASK.of(client) for client in both.listed_clients] == [("nav",), ()]
    assert validate(both) == []


def test_check_says_what_may_be_run_and_warns(tmp_path: Path) -> None:
    program = tmp_path / "restart-nav"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o777)
    units = {
        "nav": {"restart": [str(program), "a b"], "log": ["journalctl", "-e"]},
        "lidar": {"status": ["no_such_program"]},
    }
    session, problems = build({**ROBOT, "units": units, "may": {"units": ["nav"]}})
    assert not problems
    assert list(FEATURE.effects(session)) == [
        f"unit nav: restart runs {program} 'a b'",
        "unit nav: log runs journalctl -e, after an action that failed",
        "unit lidar: status runs no_such_program, whenever an operator or any other side looks",
        "the server may start, stop and restart, as far as they have that: nav",
    ]
    advice = [each for each in FEATURE.advice(session, tmp_path / "robot1.yaml") if each[0] != "units.nav.log"]
    assert [place for place, _ in advice] == ["units.nav", "units.nav", "units.nav.restart", "units.lidar.status"]
    assert advice[2][1].startswith(f"other users can change {program}")
    assert advice[3][1].startswith("no program no_such_program in PATH")
    assert len(list(FEATURE.advice(session, None))) == 2


def test_a_reload_does_not_show_commands() -> None:
    units = {"nav": ListedUnit(restart=("program", "--password=secret"))}
    changed = msgspec.structs.replace(SESSION, features={UNITS.name: units})
    assert changes(SESSION, changed) == ["units none → another list of commands"]
    assert changes(changed, SESSION) == ["units a list of commands → none"]
