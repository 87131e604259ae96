"""A network between client and server that can be slow, lossy or cut.

Clients connect to `Relay.HOST`; it passes everything on to the same port of `Relay.SERVER`, TCP and UDP, so that the
ports in a session mean the same with a relay between and without.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Coroutine

T = TypeVar("T")
Fate = Callable[[bytes], list[bytes]]
"""What becomes of a datagram from the client: nothing, itself, itself twice, another."""

_U32 = struct.Struct(">I")
_CHUNK = 65_536
_SMALL_BUFFER = 32 * 1024
_SO_RCVBUFFORCE = 33
_UDP_BUFFER = 8 << 20


def message_number(datagram: bytes) -> int | None:
    """Which of its route's messages a datagram belongs to (PROTOCOL.md, section 2); None: it is a probe."""
    route, number = _U32.unpack_from(datagram, 6)[0], _U32.unpack_from(datagram, 26)[0]
    return number if route else None


class Relay:
    """Relays some ports, on a thread of its own.

    Attributes:
        connections: that came in over TCP so far, oldest first.
        to_server: the fate of datagrams on their way to the server.
        to_client: likewise, the other way.
        datagrams: those that came from the client.
    """

    HOST = "127.0.0.3"
    SERVER = "127.0.0.2"

    def __init__(self, *ports: int) -> None:
        self.connections: list[Connection] = []
        self.to_server: Fate = lambda datagram: [datagram]
        self.to_client: Fate = lambda datagram: [datagram]
        self.datagrams: list[bytes] = []
        self._stalls_new = False
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay", daemon=True)
        self._thread.start()
        self._servers: list[asyncio.Server] = []
        self._sockets: list[asyncio.BaseTransport] = []
        for port in ports:
            self._call(self._open(port))

    def cut(self) -> None:
        """End every TCP connection that stands."""
        self._call(self._cut())

    def stall(self, stalled: bool = True, *, new: bool = False) -> None:
        """Carry nothing more on any TCP connection that stands, with `new` on later ones either, or go on."""
        self._stalls_new = stalled and new
        for connection in self.connections:
            connection.stall(stalled)

    def close(self) -> None:
        """End everything."""
        self._call(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _call(self, work: Coroutine[None, None, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(60)

    async def _open(self, port: int) -> None:
        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            connection = Connection(self._loop)
            self.connections.append(connection)
            if self._stalls_new:
                connection.stall()
            await connection.run(reader, writer, port)

        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SMALL_BUFFER)  # so that a stall is soon felt
        listening.bind((self.HOST, port))
        self._servers.append(await asyncio.start_server(accept, sock=listening, limit=_CHUNK))
        transport, _ = await self._loop.create_datagram_endpoint(
            lambda: _Datagrams(self, port), local_addr=(self.HOST, port)
        )
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _UDP_BUFFER)
        self._sockets.append(transport)

    async def _cut(self) -> None:
        for connection in self.connections:
            connection.abort()

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        for transport in self._sockets:
            transport.close()
        await self._cut()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        await asyncio.gather(*others, return_exceptions=True)
        await asyncio.sleep(0)  # transports close on the loop's next turn


class Connection:
    """One TCP connection through the relay.

    Attributes:
        sent: what the client has sent so far, the first 64 KiB of it.
        sent_bytes: how much it was.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.sent = bytearray()
        self.sent_bytes = 0
        self._loop = loop
        self._damages = False
        self._flows = asyncio.Event()
        self._flows.set()
        self._writers: list[asyncio.StreamWriter] = []

    def stall(self, stalled: bool = True) -> None:
        """Carry nothing more either way, or go on."""
        self._loop.call_soon_threadsafe(self._flows.clear if stalled else self._flows.set)

    def damage(self, damages: bool = True) -> None:
        """Change the last byte of whatever comes."""
        self._damages = damages

    def abort(self) -> None:
        """End it, on the relay's thread."""
        self._flows.set()
        for writer in self._writers:
            writer.transport.abort()

    async def run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, port: int) -> None:
        """Carry bytes both ways until one side closes."""
        self._writers.append(writer)
        try:
            far_reader, far_writer = await asyncio.open_connection(Relay.SERVER, port, limit=_CHUNK)
        except OSError:
            self.abort()
            return
        self._writers.append(far_writer)
        await asyncio.gather(self._pump(reader, far_writer, self._record), self._pump(far_reader, writer, len))

    def _record(self, data: bytes) -> None:
        self.sent_bytes += len(data)
        self.sent += data[: _CHUNK - len(self.sent)]

    async def _pump(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, note: Callable[[bytes], object]
    ) -> None:
        """Carry bytes one way; the end of it is the end of both."""
        with contextlib.suppress(OSError):
            await self._flows.wait()
            while data := await reader.read(_CHUNK):
                await self._flows.wait()
                note(data)
                writer.write(data[:-1] + bytes((data[-1] ^ 1,)) if self._damages else data)
                await writer.drain()
        self.abort()


class _Datagrams(asyncio.DatagramProtocol):
    """The client's side of a UDP port: a socket towards the server for each client address."""

    def __init__(self, relay: Relay, port: int) -> None:
        self._relay = relay
        self._port = port
        self._far: dict[object, socket.socket] = {}
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._relay.datagrams.append(data)
        far = self._far.get(addr) or self._connect(addr)
        for datagram in self._relay.to_server(data):
            far.send(datagram)

    def connection_lost(self, _: Exception | None) -> None:
        for far in self._far.values():
            self._loop.remove_reader(far)
            far.close()

    def error_received(self, _: Exception) -> None:
        """The client's socket is gone."""

    def _connect(self, address: tuple[str, int]) -> socket.socket:
        far = self._far[address] = socket.socket(type=socket.SOCK_DGRAM)
        far.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _UDP_BUFFER)
        far.connect((Relay.SERVER, self._port))
        far.setblocking(False)
        self._loop.add_reader(far, self._answered, far, address)
        return far

    def _answered(self, far: socket.socket, address: tuple[str, int]) -> None:
        try:
            data = far.recv(_CHUNK)
        except OSError:
            return  # nothing there after all, or the server's socket is gone
        for datagram in self._relay.to_client(data):
            self._transport.sendto(datagram, address)
