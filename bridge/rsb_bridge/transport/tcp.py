"""TCP."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from rsb_bridge.transport.listening import StreamListener, bind
from rsb_bridge.transport.names import look_up
from rsb_bridge.transport.streams import Address, Stream, StreamHandler
from rsb_bridge.transport.transport import Acceptor, Listener, StreamTransport
from rsb_bridge.wire.framing import MESSAGE_LIMIT

CONNECT_TIMEOUT = 3.0
"""s"""
_BACKLOG = 1024
"""Connections that the kernel holds until they are accepted; a client whose connection finds no room waits 1 s."""
_NOT_SENT_LOW_WATER = 32 * 1024
_TCP_NOTSENT_LOWAT = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
_IDLE, _KEEPALIVE_EVERY = 20, 5
"""s; the stingiest NATs forget an idle connection within a minute."""
_GIVEN_UP_AFTER_MS = 6_000
_TCP_RTO_MAX_MS = 44
_RETRIED_EVERY_MS = 1000
"""The kernel alone would wait ever longer between retransmissions, and so long after the network is back."""


class TcpStream(Stream):
    """A TCP connection. What waits, waits in this process, where old messages can be dropped, not in the kernel."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        _set_options(transport.get_extra_info("socket"))
        super().connection_made(transport)


class Tcp(StreamTransport):
    """TCP over IPv4 and IPv6."""

    name = "tcp"
    companions = ("udp",)
    largest_message = MESSAGE_LIMIT

    def carries_links_to(self, host: str) -> bool:
        return True

    async def connect(self, host: str, port: int, handler: StreamHandler) -> Stream:
        """Connect to the first of the host's addresses that answers; each has its share of `CONNECT_TIMEOUT`.

        Not asyncio's "happy eyeballs", which leaves a socket open when it is cancelled just as that has connected.
        """
        found = await look_up(host, port, CONNECT_TIMEOUT)
        failure: OSError = OSError(f"{host}: the name has no address")
        for family, kind, proto, _, address in found:
            try:
                async with asyncio.timeout(CONNECT_TIMEOUT / len(found)):
                    return await _connect(socket.socket(family, kind, proto), address, handler)
            except OSError as error:
                failure = error
        raise failure

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        sockets = await bind(host, port, socket.SOCK_STREAM)
        return StreamListener(sockets, _BACKLOG, lambda: TcpStream(acceptor.make_handler()), acceptor.shortage)

    def source_address(self, peer: Address) -> str:
        family = socket.AF_INET6 if len(peer) == 4 else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as probe:  # connecting sends nothing
            try:
                probe.connect(peer)
            except OSError:
                return ""
            return str(probe.getsockname()[0])


async def _connect(sock: socket.socket, address: Address, handler: StreamHandler) -> Stream:
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as unless_connected:
        unless_connected.callback(sock.close)
        sock.setblocking(False)
        await loop.sock_connect(sock, address)
        _, stream = await loop.create_connection(lambda: TcpStream(handler), sock=sock)
        unless_connected.pop_all()
    return stream


def _set_options(sock: socket.socket) -> None:
    """Have NATs remember idle connections, the kernel retry often, and give up a connection that carries nothing."""
    sock.setsockopt(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, _NOT_SENT_LOW_WATER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _IDLE)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _KEEPALIVE_EVERY)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _GIVEN_UP_AFTER_MS)
    with contextlib.suppress(OSError):  # Linux 6.15
        sock.setsockopt(socket.IPPROTO_TCP, _TCP_RTO_MAX_MS, _RETRIED_EVERY_MS)
