"""The options of the sockets that Zenoh opens."""

from __future__ import annotations

import asyncio
import os
import socket
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.support.waiting import eventually

from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.network import Network
from rsb_extras.zenoh.zenoh_sockets import prepare_socket

pytest.importorskip("zenoh")
from rsb_extras.zenoh.tests.zenoh_router import Router

LOW_WATER = getattr(socket, "TCP_NOTSENT_LOWAT", 25)


def link(protocol: str, near: socket.socket, host: str) -> SimpleNamespace:
    here, there = (f"{protocol}/{host}:{address[1]}" for address in (near.getsockname(), near.getpeername()))
    return SimpleNamespace(src=here, dst=there)


def low_water(near: socket.socket) -> int:
    return near.getsockopt(socket.IPPROTO_TCP, LOW_WATER)


def to_port(port: int) -> list[int]:
    """The low water of this process's connections to a port of this machine."""
    found = []
    for each in Path("/proc/self/fd").iterdir():
        try:
            if not str(each.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(each.name))) as near:
                if near.family == socket.AF_INET and near.getpeername()[1] == port:
                    found.append(low_water(near))
        except OSError:
            continue
    return found


@pytest.mark.parametrize(("protocol", "host", "family"), [
    ("tcp", "127.0.0.1", socket.AF_INET), ("tls", "127.0.0.1", socket.AF_INET), ("ws", "[::1]", socket.AF_INET6),
    ("tcp", "[::ffff:127.0.0.1]", socket.AF_INET),
])  # fmt: skip
def test_only_links_socket_is_touched(protocol: str, host: str, family: int) -> None:
    with socket.create_server(("::1" if family == socket.AF_INET6 else "127.0.0.1", 0), family=family) as server:
        near, other = (socket.create_connection(server.getsockname()[:2]) for _ in range(2))
        before = {*os.listdir("/proc/self/fd")}  # noqa: PTH208 (the numbers, and the listing's own)
        with near, other:
            assert prepare_socket(link(protocol, near, host))  # type: ignore[arg-type]
            assert low_water(near) == 32 * 1024
            assert low_water(other) == 0
            near.getsockname()  # it is still open
            assert not {*os.listdir("/proc/self/fd")} - before  # noqa: PTH208 (other threads may close some)


def test_link_without_local_socket_is_left_alone() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        with socket.create_connection(server.getsockname()) as near:
            quic, gone = link("quic", near, "127.0.0.1"), link("tcp", near, "127.0.0.1")
            assert not prepare_socket(quic)  # type: ignore[arg-type]
            assert low_water(near) == 0
        assert not prepare_socket(gone)  # type: ignore[arg-type]


def test_zenohs_own_connection_has_them() -> None:
    with closing(Router()) as router:
        network = Network(ZenohSettings(connect=(router.endpoint,)), Path())
        asyncio.run(network.open())
        try:
            eventually(lambda: to_port(router.port) == [32 * 1024])
        finally:
            network.close()
