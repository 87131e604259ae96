"""The network between each client and the server: a relay of one TCP and UDP port that can fail in several ways.

It needs no rights: clients call an address of their own (127.0.1.x), and the relay calls the server's.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

if TYPE_CHECKING:
    from collections.abc import Coroutine

Condition: TypeAlias = Literal["whole", "cut", "stalled", "refusing"]
"""What becomes of packets: all are carried; none, and nobody is told; those of UDP only; none, and TCP is reset."""

SERVER = "127.0.0.2"
_CHUNK = 65_536
_DATAGRAM = 65_536
_MOST_SOURCES = 8
"""Client addresses that the relay remembers: each process of the client has its own."""


class Network:
    """All relays, on a thread of their own.

    Args:
        port: of the server, and of all relays.
        clients: how many there are.
    """

    def __init__(self, port: int, clients: int) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="network", daemon=True)
        self._thread.start()
        self.paths = [Path(self, f"127.0.1.{number}", port) for number in range(1, clients + 1)]
        for path in self.paths:
            self.call(path.open())

    def call(self, work: Coroutine[Any, Any, None]) -> None:
        """Run something on the network's thread, and wait for its end."""
        asyncio.run_coroutine_threadsafe(work, self._loop).result(10)

    def close(self) -> None:
        """End everything."""
        for path in self.paths:
            self.call(path.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class Path:
    """The way of one client to the server.

    Attributes:
        address: where the client finds it.
        condition: as `become` last said.
    """

    def __init__(self, network: Network, address: str, port: int) -> None:
        self.address = address
        self.condition: Condition = "whole"
        self._network = network
        self._port = port
        self._carries = asyncio.Event()
        self._carries.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._listening: asyncio.Server | None = None
        self._datagrams: asyncio.DatagramTransport | None = None

    @property
    def carries_datagrams(self) -> bool:
        """Whether UDP gets through."""
        return self.condition in ("whole", "stalled")

    def become(self, condition: Condition) -> None:
        """Change what the network does."""
        self._network.call(self._become(condition))

    async def open(self) -> None:
        """Begin to relay."""
        await self._listen()
        loop = asyncio.get_running_loop()
        self._datagrams, _ = await loop.create_datagram_endpoint(
            lambda: _Datagrams(self, (SERVER, self._port)), local_addr=(self.address, self._port)
        )

    async def close(self) -> None:
        """End all connections."""
        if self._datagrams:
            self._datagrams.close()
        await self._refuse()
        self._carries.set()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _become(self, condition: Condition) -> None:
        self.condition = condition
        if condition in ("cut", "stalled"):
            self._carries.clear()
        else:
            self._carries.set()
        if condition == "refusing":
            await self._refuse()
        elif self._listening is None:
            await self._listen()

    async def _listen(self) -> None:
        self._listening = await asyncio.start_server(self._accept, self.address, self._port, limit=_CHUNK)

    async def _refuse(self) -> None:
        if self._listening:
            self._listening.close()
            self._listening = None
        for writer in tuple(self._writers):
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        far_writer = None
        try:
            await self._carries.wait()
            far_reader, far_writer = await asyncio.open_connection(SERVER, self._port, limit=_CHUNK)
            self._writers.add(far_writer)
            await asyncio.gather(self._pump(reader, far_writer), self._pump(far_reader, writer))
        except OSError:
            writer.transport.abort()  # the server is not there
        finally:
            self._writers -= {writer, far_writer}

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry bytes one way; their end, too, arrives only when the network carries."""
        with contextlib.suppress(OSError):
            while data := await reader.read(_CHUNK):
                await self._carries.wait()
                writer.write(data)
                await writer.drain()
        await self._carries.wait()
        writer.close()


class _Datagrams(asyncio.DatagramProtocol):
    """The client's side of the UDP port: a socket towards the server for each client address."""

    def __init__(self, path: Path, server: tuple[str, int]) -> None:
        self._path = path
        self._server = server
        self._far: dict[tuple[str, int], socket.socket] = {}
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if self._path.carries_datagrams:
            with contextlib.suppress(OSError):  # the server is not there
                (self._far.get(addr) or self._connect(addr)).send(data)

    def connection_lost(self, _: Exception | None) -> None:
        for address in tuple(self._far):
            self._forget(address)

    def error_received(self, _: Exception) -> None:
        """The client's socket is gone."""

    def _connect(self, address: tuple[str, int]) -> socket.socket:
        while len(self._far) >= _MOST_SOURCES:
            self._forget(next(iter(self._far)))
        far = self._far[address] = socket.socket(type=socket.SOCK_DGRAM)
        far.connect(self._server)
        far.setblocking(False)
        self._loop.add_reader(far, self._answered, far, address)
        return far

    def _forget(self, address: tuple[str, int]) -> None:
        far = self._far.pop(address)
        self._loop.remove_reader(far)
        far.close()

    def _answered(self, far: socket.socket, address: tuple[str, int]) -> None:
        try:
            data = far.recv(_DATAGRAM)
        except OSError:
            return
        if self._path.carries_datagrams and self._transport is not None:
            self._transport.sendto(data, address)
