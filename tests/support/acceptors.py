"""Servers of tests: one that takes the streams and datagrams of a listening transport, and the end of asyncio's own."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.transport.streams import StreamHandler

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.transport.transport import Datagrams, DatagramSocket


_TURNS = 10
"""More turns of a loop than asyncio takes to serve a connection that it has accepted."""


def _ignore(_: str) -> None:
    """Tell nobody."""


def _drop(_: DatagramSocket, __: Datagrams) -> None:
    """Take nothing."""


@dataclass
class Accepting:
    """An `Acceptor` whose server has functions for what a test wants to see."""

    make_handler: Callable[[], StreamHandler] = StreamHandler
    datagrams: Callable[[DatagramSocket, Datagrams], None] = _drop
    shortage: Callable[[str], None] = _ignore
    others: Callable[[str], None] = _ignore

    async def prove(self, hosts: list[str]) -> list[str]:
        return []


async def close_server(server: asyncio.Server) -> None:
    """Close asyncio's own server; closed while it accepts, it would leave that connection's socket open."""
    for listening in server.sockets:
        asyncio.get_running_loop().remove_reader(listening)
    for _ in range(_TURNS):
        await asyncio.sleep(0)
    server.close()
