"""The ports that tests are given."""

from __future__ import annotations

import socket

import pytest
from tests.support.ports import free_port, free_ports, taken

ALL = 200
"""More ports than one run has."""


def all_free() -> set[int]:
    return {free_port() for _ in range(ALL)}


def test_ended_connection_leaves_port_free() -> None:
    port = free_port()
    with socket.create_server(("127.0.0.1", port)) as server:
        near = socket.create_connection(("127.0.0.1", port))
        far, _ = server.accept()
        far.close()  # who closes first keeps the port for a minute
        assert near.recv(1) == b""
        near.close()
    assert port in all_free()
    with taken(port, socket.SOCK_STREAM):
        pass


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_taken_port_is_not_free(kind: socket.SocketKind) -> None:
    port = free_port()
    with taken(port, kind):
        assert port not in all_free()
    assert port in all_free()


def test_ports_given_together_differ() -> None:
    found = free_ports(40)
    assert len(set(found)) == 40


def test_too_few_free_ports_fail() -> None:
    with pytest.raises(AssertionError, match="are needed"):
        free_ports(ALL)
