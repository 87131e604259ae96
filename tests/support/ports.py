"""Ports that no other run of these tests takes meanwhile."""

from __future__ import annotations

import contextlib
import functools
import itertools
import socket
from collections.abc import Iterator

from tests.support.locks import locked

from rsb_bridge.model.limits import discovery_domain

_BLOCK = 130
_BLOCKS = range(27_400, 32_600, _BLOCK)
"""Between the ports of the tests' domains (7400 + 250 a domain), which a server refuses in its own domain, and those
that the kernel gives out. Discovery of ROS domains needs up to half of a block."""


def free_port(host: str = "127.0.0.1") -> int:
    """A port that neither TCP nor UDP has in use, and that no ROS domain needs for discovery."""
    return free_ports(1, host)[0]


def free_ports(count: int, host: str = "127.0.0.1") -> tuple[int, ...]:
    """Return so many different ones; a program has to set SO_REUSEADDR to listen on one with TCP, as bridges do.

    Raises:
        AssertionError: fewer are free.
    """
    once_round = itertools.islice(_ports(), _BLOCK)
    free = (port for port in once_round if discovery_domain(port) is None and _is_free(host, port))
    found = tuple(itertools.islice(free, count))
    assert len(found) == count, f"{len(found)} of this run's {_BLOCK} ports are free, {count} are needed"
    return found


@contextlib.contextmanager
def taken(port: int, kind: socket.SocketKind) -> Iterator[None]:
    """Have another program listen on a port."""
    with socket.socket(type=kind) as squatter:
        if kind is socket.SOCK_STREAM:
            squatter.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        squatter.bind(("127.0.0.1", port))
        if kind is socket.SOCK_STREAM:
            squatter.listen()
        yield


@functools.cache
def _ports() -> Iterator[int]:
    first = locked("ports", _BLOCKS)
    return itertools.cycle(range(first, first + _BLOCK))


def _is_free(host: str, port: int) -> bool:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        # A connection keeps its server's port for a minute after its end: those of a run before had all but a few.
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tcp.bind((host, port))
            udp.bind((host, port))
        except OSError:
            return False
    return True
