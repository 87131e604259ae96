"""What `rsb-console doctor` finds out about a session's ports, keys and types: real sockets and files."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.ports import free_port

from rsb_bridge.config.keys import write_key
from rsb_bridge.doctor import session_needs
from rsb_bridge.doctor.finding import Finding, Grade, examine
from rsb_bridge.model.session import Session, Topic

if TYPE_CHECKING:
    from pathlib import Path


def session(**changes: Any) -> Session:
    """A server's."""
    fields = {"name": "robot1", "role": "server", "server_ip": "127.0.0.1", "server_port": free_port()}
    return Session(**{**fields, "key_file": "robot1.key", **changes})


def found(code: str, of: Session, folder: Path) -> list[Finding]:
    """The findings of one check."""
    checks = session_needs.checks(of, folder / "session.yaml", {})
    return list(examine(check for check in checks if check.code == code))


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_port_that_another_program_has(kind: socket.SocketKind, tmp_path: Path) -> None:
    server = session()
    assert [each.grade for each in found("ports", server, tmp_path)] == [Grade.OK]
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("127.0.0.1", server.server_port))
        if kind == socket.SOCK_STREAM:
            other.listen()
        (finding,) = found("ports", server, tmp_path)
    assert (finding.grade, finding.facts["port"]) == (Grade.WARNING, server.server_port)


def test_an_address_of_another_machine(tmp_path: Path) -> None:
    assert [each.grade for each in found("ports", session(server_ip="192.0.2.1"), tmp_path)] == [Grade.ERROR]


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


def test_types_that_are_not_installed(tmp_path: Path) -> None:
    client = session(role="client", topics=(Topic("/a", "transmit", type="no_such_msgs/msg/A"),))
    assert [(each.code, each.grade) for each in found("session", client, tmp_path)] == [("types", Grade.NOTE)]
