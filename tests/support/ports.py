"""Ports that no other run of these tests takes meanwhile."""

from __future__ import annotations

import functools
import itertools
import socket
from collections.abc import Iterator

from tests.support.locks import locked

from rsb_bridge.model.limits import discovery_domain

_BLOCK = 130
_BLOCKS = range(27_400, 32_600, _BLOCK)
"""Between the ports of the tests' domains (7400 + 250 a domain), which a server refuses in its own domain, and those
that the kernel gives out."""


def free_port(host: str = "127.0.0.1") -> int:
    """A port that neither TCP nor UDP has in use, and that no ROS domain needs for discovery."""
    return next(port for port in _ports() if discovery_domain(port) is None and _is_free(host, port))


@functools.cache
def _ports() -> Iterator[int]:
    first = locked("ports", _BLOCKS)
    return itertools.cycle(range(first, first + _BLOCK))


def _is_free(host: str, port: int) -> bool:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        try:
            tcp.bind((host, port))
            udp.bind((host, port))
        except OSError:
            return False
    return True
