"""Findings of `rsb-console doctor` about a session's ports, keys and types, with real sockets and files."""

from __future__ import annotations

import os
import socket
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import LINK, ScriptedEngine
from tests.support import surroundings
from tests.support.addresses import foreign_address
from tests.support.ports import free_port, taken
from tests.support.wording import says

from rsb_bridge.config.keys import write_key
from rsb_bridge.model.finding import Finding, Grade, examine
from rsb_bridge.model.session import Operator, Session, Topic
from rsb_extras.doctor import session_needs
from rsb_extras.doctor.tests import doctor_places
from rsb_extras.zenoh import ZenohSettings

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from tests.support.control import Machine


def session(**changes: Any) -> Session:
    fields = {"name": "robot1", "role": "server", "server_ip": "127.0.0.1", "server_port": free_port()}
    return Session(**{**fields, "key_file": "robot1.key", **changes})


def found(code: str, of: Session, folder: Path, environ: Mapping[str, str] | None = None) -> list[Finding]:
    checks = session_needs.checks(of, folder / "session.yaml", environ or {"RSB_CONSOLE_ISOLATED": "1"}, folder)
    return list(examine(check for check in checks if check.code == code))


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_port_that_another_program_has(kind: socket.SocketKind, tmp_path: Path) -> None:
    server = session()
    assert [each.grade for each in found("ports", server, tmp_path)] == [Grade.OK]
    with taken(server.server_port, kind):
        (finding,) = found("ports", server, tmp_path)
    assert (finding.grade, finding.facts["port"]) == (Grade.WARNING, server.server_port)


def test_a_port_that_this_sessions_own_bridge_has(tmp_path: Path, machine: Machine) -> None:
    server = session()
    machine.serve(ScriptedEngine(), file=tmp_path / "session.yaml")
    with socket.create_server(("127.0.0.1", server.server_port)):
        (finding,) = found("ports", server, tmp_path, machine.environ)
        (of_another_file,) = found("ports", server, tmp_path / "another", machine.environ)
    assert (finding.grade, of_another_file.grade) == (Grade.OK, Grade.WARNING)
    assert says(finding.text, session_needs.NeedText.PORT_OWN, pid=os.getpid())


def test_multipath_of_session_names_what_it_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert found("multipath", session(), tmp_path) == []
    client = session(role="client", multipath=True)
    doctor_places.FURTHER_WAYS.set(monkeypatch, list)
    doctor_places.ADDRESSES.set(monkeypatch, lambda: [("wlan0", "127.0.0.1"), ("lte0", "192.0.2.7")])
    one_way, slow = found("multipath", client, tmp_path)
    assert (one_way.grade, slow.grade) == (Grade.WARNING, Grade.NOTE)
    assert "ip mptcp endpoint add 192.0.2.7 dev lte0 subflow backup" in one_way.remedy

    setting = tmp_path / "proc/sys/net/ipv4/tcp_rto_max_ms"
    setting.parent.mkdir(parents=True)
    setting.write_text("1000\n")
    doctor_places.FURTHER_WAYS.set(monkeypatch, lambda: ["192.0.2.7"])
    (ways,) = found("multipath", client, tmp_path)
    assert (ways.grade, ways.facts) == (Grade.OK, {"addresses": ["192.0.2.7"]})
    doctor_places.FURTHER_WAYS.set(monkeypatch, lambda: None)
    assert [each.grade for each in found("multipath", client, tmp_path)] == [Grade.UNKNOWN]
    assert [each.grade for each in found("multipath", session(multipath=True), tmp_path)] == [Grade.OK]

    doctor_places.MULTIPATH_PROBLEM.set(monkeypatch, lambda: "Protocol not supported")
    (none,) = found("multipath", client, tmp_path)
    assert none.grade == Grade.WARNING
    assert "Protocol not supported" in none.text


@pytest.mark.parametrize(("offset", "grade"), [(-30.0, Grade.WARNING), (30.0, Grade.WARNING), (0.02, Grade.OK)])
def test_the_clocks_of_a_running_bridges_peers(offset: float, grade: Grade, tmp_path: Path, machine: Machine) -> None:
    engine = ScriptedEngine()
    engine.now = replace(engine.now, links=(replace(LINK, clock_offset=offset, clock_uncertainty=0.004),))
    machine.serve(engine, file=tmp_path / "session.yaml")
    (finding,) = found("clock", session(), tmp_path, machine.environ)
    assert (finding.grade, finding.facts["offset"]) == (grade, offset)
    assert "the server" in finding.text  # a client's link has the client's own name
    domains = {**machine.environ, "ROS_DOMAIN_ID": "77"}
    (other,) = found("ros_domain", session(), tmp_path, domains)
    assert (other.grade, other.facts["running"]) == (Grade.WARNING, engine.now.domain_id)
    assert found("ros_domain", session(domain_id=engine.now.domain_id), tmp_path, domains) == []
    assert found("clock", session(), tmp_path / "of a bridge that does not run", machine.environ) == []


def test_port_that_another_program_has_over_ipv4_only(tmp_path: Path) -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("needs IPv6")
    server = session(server_ip="::")
    with socket.create_server(("0.0.0.0", server.server_port)):
        assert [each.grade for each in found("ports", server, tmp_path)] == [Grade.WARNING], "it binds IPv4, too"


def test_a_name_is_not_looked_up(tmp_path: Path) -> None:
    (finding,) = found("ports", session(server_ip="control.invalid"), tmp_path)
    assert finding.grade == Grade.UNKNOWN
    assert says(finding.text, session_needs.NeedText.NAME, address="control.invalid")
    assert [each.grade for each in found("ports", session(server_ip="localhost"), tmp_path)] == [Grade.OK]


def test_an_address_of_another_machine(tmp_path: Path) -> None:
    (finding,) = found("ports", session(server_ip=foreign_address()), tmp_path)
    assert (finding.grade, bool(finding.remedy)) == (Grade.ERROR, True)


def test_a_client_binds_no_port(tmp_path: Path) -> None:
    assert not found("ports", session(role="client"), tmp_path)


def test_key_files(tmp_path: Path) -> None:
    path = tmp_path / "robot1.key"
    assert [each.grade for each in found("keys", session(), tmp_path)] == [Grade.ERROR]
    write_key(path)
    assert [each.grade for each in found("keys", session(), tmp_path)] == [Grade.OK]
    path.chmod(0o644)
    assert [each.grade for each in found("keys", session(), tmp_path)] == [Grade.WARNING]
    unencrypted = session(use_encryption=False, key_file=None)
    assert [each.grade for each in found("keys", unencrypted, tmp_path)] == [Grade.OK]
    assert [each.grade for each in found("session", unencrypted, tmp_path)] == [Grade.WARNING]


def test_key_files_of_operators(tmp_path: Path) -> None:
    write_key(tmp_path / "robot1.key")
    server = session(operators=(Operator("anna", "anna.key", "change"),))
    of_operator, of_link = found("keys", server, tmp_path)
    assert (of_operator.grade, of_link.grade) == (Grade.ERROR, Grade.OK)
    assert "anna.key" in of_operator.text
    unencrypted = session(use_encryption=False, key_file=None, operators=server.operators)
    assert [each.grade for each in found("keys", unencrypted, tmp_path)] == [Grade.ERROR]


MAC = "00:11:22:33:44:55"


@pytest.mark.parametrize("changes", [{"server_ip": MAC, "server_port": 3}, {"bluetooth_address": MAC}])
def test_a_session_over_bluetooth_on_a_machine_without(
    changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = session(**changes)
    surroundings.offer_bluetooth(monkeypatch)
    (no_adapter,) = found("session", of, tmp_path)
    monkeypatch.delattr(socket, "AF_BLUETOOTH")
    (no_sockets,) = found("session", of, tmp_path)
    assert no_adapter.text != no_sockets.text
    for finding in (no_adapter, no_sockets):
        assert (finding.grade, finding.facts, bool(finding.remedy)) == (Grade.ERROR, {"lacks": "bluetooth"}, True)
    surroundings.offer_bluetooth(monkeypatch)
    (tmp_path / "sys/class/bluetooth/hci0").mkdir(parents=True)
    assert not found("session", of, tmp_path)


@pytest.mark.parametrize(
    ("server_ip", "grade", "facts"),
    [("zenoh", Grade.ERROR, {"lacks": "zenoh"}), ("127.0.0.1", Grade.WARNING, None)],
)
def test_a_session_with_zenoh_on_a_machine_without(
    server_ip: str, grade: Grade, facts: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without Zenoh, a link over IP only is not seen in its fleet."""
    of = session(server_ip=server_ip, features={"zenoh": ZenohSettings()})
    surroundings.hide_modules(monkeypatch, "zenoh")
    (finding,) = found("session", of, tmp_path)
    assert (finding.grade, finding.facts or None) == (grade, facts)
    assert "zenoh" in f"{finding.text} {finding.remedy}"


def test_types_that_are_not_installed(tmp_path: Path) -> None:
    client = session(role="client", topics=(Topic("/a", "transmit", type="no_such_msgs/msg/A"),))
    assert [(each.code, each.grade) for each in found("session", client, tmp_path)] == [("types", Grade.NOTE)]


@pytest.mark.parametrize(
    ("said", "grade"),
    [
        ('{"/cmd_vel": {"/base": {"cmd_vel_timeout": 0.5}}}', Grade.OK),
        ('{"/cmd_vel": {"/base": {"cmd_vel_timeout": 0.0}}}', Grade.WARNING),
        ('{"/cmd_vel": {"/base": {}}}', Grade.WARNING),
        ('{"/cmd_vel": {"/base": null}}', Grade.UNKNOWN),
        ('{"/cmd_vel": {}}', Grade.UNKNOWN),
        ("", Grade.UNKNOWN),
    ],
)
def test_whether_the_base_stops_by_itself(said: str, grade: Grade, tmp_path: Path) -> None:
    commands = Topic("/cmd_vel", "receive", arm=True)
    robot = session(role="client", topics=(commands,), domain_id=7)
    asked = tmp_path / "asked"
    command = ("sh", "-c", f"echo \"$@\" > {asked}; echo '{said}'", "sh")
    checks = session_needs.checks(robot, tmp_path / "robot.yaml", {}, tmp_path, command)
    (finding,) = examine(check for check in checks if check.code == "base")
    assert finding.grade == grade
    assert asked.read_text().split() == ["7", "/cmd_vel"]


@pytest.mark.parametrize("topic", [Topic("/cmd_vel", "transmit", arm=True), Topic("/cmd_vel", "receive")])
def test_base_is_asked_only_where_something_arrives_armed(topic: Topic, tmp_path: Path) -> None:
    robot = session(role="client", topics=(topic,))
    checks = session_needs.checks(robot, tmp_path / "robot.yaml", {}, tmp_path, ("false",))
    assert not list(examine(check for check in checks if check.code == "base"))
