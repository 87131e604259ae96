"""Servers of tests."""

from __future__ import annotations

import asyncio
import socket

from tests.support.acceptors import close_server


def test_connection_accepted_at_the_end_is_served() -> None:
    """Else its socket stays open, and warns in any later test."""
    served: list[asyncio.BaseTransport] = []

    class Protocol(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            served.append(transport)
            transport.close()

    async def play() -> None:
        server = await asyncio.get_running_loop().create_server(Protocol, "127.0.0.1", 0)
        with socket.create_connection(server.sockets[0].getsockname()):
            await asyncio.sleep(0)
            await asyncio.sleep(0)  # it has accepted, and serves in the loop's next turn
            await close_server(server)

    asyncio.run(play())
    assert len(served) == 1
