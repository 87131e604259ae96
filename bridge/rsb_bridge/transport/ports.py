"""A server's sockets: the shared port, and those that topics name for themselves."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.transport import rfcomm, tcp, udp

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.transport.streams import StreamHandler
    from rsb_bridge.transport.udp import Received, UdpSocket


@dataclass(slots=True)
class _Port:
    users: int = 0
    streams: asyncio.Server | None = None
    udp: list[UdpSocket] = field(default_factory=list)

    def close(self) -> None:
        if self.streams is not None:
            self.streams.close()
        for socket in self.udp:
            socket.close()


class Ports:
    """Sockets by transport and port, each open as long as somebody uses it."""

    def __init__(
        self,
        host: str,
        adapter: str | None,
        make_handler: Callable[[], StreamHandler],
        received: Received,
    ) -> None:
        self._host = host
        self._adapter = adapter
        self._make_handler = make_handler
        self._received = received
        self._ports: dict[tuple[str, int], _Port] = {}
        self._opening = asyncio.Lock()

    async def open(self, transport: str, number: int) -> Callable[[], None]:
        """Use a port; it is bound if nobody does yet.

        Returns:
            What to call when it is no longer used.

        Raises:
            ListenError: it can't be bound.
        """
        key = (transport, number)
        async with self._opening:
            port = self._ports.get(key)
            if port is None:
                port = await self._bind(transport, number)
                self._ports[key] = port
        port.users += 1
        return lambda: self._release(key, port)

    async def _bind(self, transport: str, number: int) -> _Port:
        if transport == "udp":
            return _Port(udp=await udp.bind(self._host, number, self._received))
        if transport == "tcp":
            return _Port(streams=await tcp.listen(self._host, number, self._make_handler))
        if self._adapter is None:
            raise tcp.ListenError("the server's session names no bluetooth_address: add it, or use tcp or udp")
        return _Port(streams=await rfcomm.listen(self._adapter, number, self._make_handler))

    def _release(self, key: tuple[str, int], port: _Port) -> None:
        port.users -= 1
        if not port.users and self._ports.get(key) is port:
            del self._ports[key]
            port.close()

    def close(self) -> None:
        """Close them all."""
        for port in self._ports.values():
            port.close()
        self._ports.clear()
