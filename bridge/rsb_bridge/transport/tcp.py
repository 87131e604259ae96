"""TCP."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import socket
import struct
from typing import TYPE_CHECKING

from aiohappyeyeballs import start_connection

from rsb_bridge.model.transport_traits import TcpTraits
from rsb_bridge.transport import multipath
from rsb_bridge.transport.listening import LookUpProblem, StreamListener, bind, listen_error_message, look_up
from rsb_bridge.transport.network_news import NetworkNews, news_of_kernel
from rsb_bridge.transport.streams import (
    PacketCounts,
    Stream,
    StreamHandler,
    StreamProblem,
    os_error_message,
)
from rsb_bridge.transport.transport import Acceptor, Listener, ListenError, StreamTransport
from rsb_bridge.wire.framing import MESSAGE_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.multipath import Subflow

# s. On a path with 2 s each way, the first packet's answer takes 4 s. Linux before 6.5 sends the next ones after 1, 3
# and 7 s: with a longer timeout, a network that is back would be found later.
CONNECT_TIMEOUT = 5.0
_NEXT_ADDRESS_AFTER = 0.25  # s, the Connection Attempt Delay that RFC 8305 recommends
_BACKLOG = 1024  # connections that wait to be accepted; a client whose connection finds no room tries again after 1 s
# Bytes that the kernel keeps unsent: 13 ms of 20 Mbit/s. A round figure: more would wait where no newer message can
# replace it, and with less the connection may run dry between two turns of the loop.
_NOT_SENT_LOW_WATER = 32 * 1024
_MOST_DISCARDED = 4 << 20  # bytes that a peer may go on to send to a closed connection (PROTOCOL.md, 1)
_IDLE, _KEEPALIVE_EVERY = 20, 5  # s; the stingiest NATs forget an idle connection within a minute
_GIVEN_UP_AFTER_MS = 6_000  # a second after the link itself is given up (`link.keepalive.DEAD_AFTER`)
RETRIED_AFTER = 1
"""s, the longest wait between retransmissions: the kernel alone would wait ever longer, and so long after the network
is back."""
# Round trips and s that it waits at most on a slow path. In a tunnel of 5 kB/s with round trips of 1 to 2 s, a wait of
# 1 s had the kernel send every second byte twice, and end a connection after 14 s (`bench.robot`); 8 s, none.
_ROUND_TRIPS, _MOST_RETRIED_AFTER = 4, 8
BBR = "bbr"
"""The congestion control that does not take a radio's lost packets for a full link (bench/README.md, *Thin links*)."""

# Of Linux.
_TCP_NOTSENT_LOWAT = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
_TCP_CONGESTION = getattr(socket, "TCP_CONGESTION", 13)
TCP_RTO_MAX_MS = 44
"""An option since Linux 6.15."""
# The kernel's tcp_info (linux/tcp.h), in part: `tcpi_retransmits`, `tcpi_total_retrans`, `tcpi_bytes_acked`,
# `tcpi_data_segs_out`, `tcpi_bytes_sent`, `tcpi_bytes_retrans` and `tcpi_dsack_dups`. Linux has the last ones since
# 4.19; without them there are no counts.
_TCP_INFO = struct.Struct("=2xB 97x I 16x Q 28x I 40x Q Q I")
_ANY_PORT = 9
_NAME_SIZE = 16  # bytes of the name of a congestion control: TCP_CA_NAME_MAX
_RESETS = struct.pack("ii", 1, 0)  # SO_LINGER of a socket whose `close` resets the connection


class _Discarding(StreamHandler):
    """Reads on from a stream that ends here, for its former handler, which wants to know the end only."""

    def __init__(self, stream: Stream, former: StreamHandler) -> None:
        self._stream, self._former = stream, former
        self._discarded = 0

    def received(self, data: bytes) -> None:
        self._discarded += len(data)
        if self._discarded > _MOST_DISCARDED:
            self._stream.abort("the peer does not stop sending")

    def closed(self, reason: Reason) -> None:
        self._former.closed(reason)


class TcpStream(Stream):
    """A TCP connection. What waits, waits in this process, where old messages can be dropped, not in the kernel.

    To close, it ends its own direction and reads on until the peer has closed, too. A socket that is closed with unread
    bytes resets the connection (RFC 1122, section 4.2.2.13), and then the last words may be lost in both kernels.

    Args:
        ending: the streams that wait for their peers to close, which it joins and leaves.
    """

    def __init__(self, handler: StreamHandler, ending: set[TcpStream]) -> None:
        super().__init__(handler)
        self._ending = ending
        self._given_up_after = 0.0
        self._retried_after = 0  # s, of the kernel: unknown

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        set_options(transport.get_extra_info("socket"))
        super().connection_made(transport)

    def _end(self, transport: asyncio.Transport) -> None:
        self._ending.add(self)
        self.handler = _Discarding(self, self.handler)
        # While bytes wait, asyncio would end the direction later, and an error of that would be an internal one.
        if not self.congested:
            self._end_sending(transport)

    def _go_on(self) -> None:
        super()._go_on()
        if self._closing and self._transport is not None:
            self._end_sending(self._transport)

    def _end_sending(self, transport: asyncio.Transport) -> None:
        try:
            transport.write_eof()
        except OSError as error:  # the peer has reset the connection
            self.abort(os_error_message(error))

    def connection_lost(self, error: Exception | None) -> None:
        self._ending.discard(self)
        super().connection_lost(error)

    def give_up_after(self, seconds: float) -> None:
        if self._transport is not None and seconds != self._given_up_after:  # it is called each second
            # Multipath TCP refuses it, until the stream falls back to plain TCP, which may be at any time.
            with contextlib.suppress(OSError):
                sock = self._transport.get_extra_info("socket")
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(seconds * 1000))
                self._given_up_after = seconds

    def round_trip_is(self, seconds: float) -> None:
        """Have the kernel wait for acknowledgements longer than so long.

        Its longest wait is short, so that it sends soon once the network is back. If that is less than a round trip, as
        in a tunnel of 5 kB/s, it sends all packets twice, takes the link for broken, and ends the connection.
        """
        wanted = min(_MOST_RETRIED_AFTER, max(RETRIED_AFTER, int(_ROUND_TRIPS * seconds)))
        if self._transport is not None and wanted != self._retried_after:
            with contextlib.suppress(OSError):  # as above, or the kernel has none
                _retry_after(self._transport.get_extra_info("socket"), wanted)
                self._retried_after = wanted

    def packets(self) -> PacketCounts | None:
        if self._transport is None:
            return None
        sock = self._transport.get_extra_info("socket")
        try:
            if (whole := multipath.stream_bytes(sock)) is None:
                infos: Sequence[bytes] = [sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO.size)]
            else:
                infos = multipath.tcp_infos(sock, _TCP_INFO.size)
        except OSError:
            return None
        counts = [_packet_counts(info) for info in infos if len(info) == _TCP_INFO.size]
        if whole is None or not counts:
            return counts[0] if counts else None
        # A way that answers nothing is no loss while another one carries.
        carrying = [each for each in counts if not each.tries] or counts
        sent, lost = sum(each.sent for each in carrying), sum(each.lost for each in carrying)
        waiting = max(0, whole.sent - whole.again - whole.acknowledged)
        return PacketCounts(sent, lost, whole.acknowledged, waiting, min(each.tries for each in counts))

    def subflows(self) -> Sequence[Subflow]:
        if self._transport is None:
            return ()
        sock = self._transport.get_extra_info("socket")
        try:
            return () if multipath.stream_bytes(sock) is None else multipath.subflows(sock)
        except OSError:
            return ()


def _packet_counts(info: bytes) -> PacketCounts:
    tries, repeated, acknowledged, segments, sent, again, needless = _TCP_INFO.unpack(info)
    lost, waiting = max(0, repeated - needless), max(0, sent - again - acknowledged)
    return PacketCounts(segments, lost, acknowledged, waiting, tries)


class Tcp(TcpTraits, StreamTransport):
    """TCP over IPv4 and IPv6."""

    largest_message = MESSAGE_LIMIT

    def __init__(self, *, several_ways: bool = False) -> None:
        """Connect and listen; with `several_ways` by Multipath TCP if the kernel has it."""
        self._ending: set[TcpStream] = set()
        self._several_ways = several_ways and not multipath.problem()

    def close(self) -> None:
        for stream in tuple(self._ending):
            stream.abort(StreamProblem.CLOSED_HERE())

    async def connect(self, host: str, port: int, handler: StreamHandler, rank: int | None = None) -> Stream:
        """Connect to the first of the host's addresses that answers, within `CONNECT_TIMEOUT` (RFC 8305)."""
        found = await look_up(host, port, CONNECT_TIMEOUT)
        if not found:
            raise OSError(LookUpProblem.NO_ADDRESS(host=host))
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT):
                sock = await start_connection(
                    found,
                    happy_eyeballs_delay=_NEXT_ADDRESS_AFTER,
                    socket_factory=lambda address: self._socket(*address[:3]),
                )
        except OSError as error:
            raise _most_telling(error) from None
        # A cancellation in between would leave a socket behind, or a reset: then it has no peer's name.
        with contextlib.ExitStack() as unless_connected:
            unless_connected.callback(sock.close)
            # While nobody listens there, a kernel that chose this port for the connection's own end connects it to
            # itself, and no server could have the port.
            if sock.getsockname() == sock.getpeername():
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESETS)  # else the port is kept for a minute
                raise OSError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
            loop = asyncio.get_running_loop()
            _, stream = await loop.create_connection(lambda: self._stream(handler), sock=sock)
            unless_connected.pop_all()
        return stream

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        sockets = await bind(host, port, socket.SOCK_STREAM, self._socket)
        try:
            return StreamListener(sockets, _BACKLOG, acceptor, self._stream)
        except OSError as error:
            raise ListenError(listen_error_message(error, f"{host}:{port}", "TCP")) from None

    def _socket(self, family: int, kind: int, protocol: int) -> socket.socket:
        return multipath.new_socket(family, kind) if self._several_ways else socket.socket(family, kind, protocol)

    def _stream(self, handler: StreamHandler) -> TcpStream:
        return TcpStream(handler, self._ending)

    def source_address(self, host: str) -> str:
        with contextlib.suppress(OSError):  # it is a name, or nothing leads there
            flags = socket.AI_NUMERICHOST
            family, _, _, _, address = socket.getaddrinfo(host, _ANY_PORT, type=socket.SOCK_DGRAM, flags=flags)[0]
            with socket.socket(family, socket.SOCK_DGRAM) as probe:  # connecting sends nothing
                probe.connect(address)
                return str(probe.getsockname()[0])
        return ""

    def network_news(self, changed: Callable[[], None]) -> NetworkNews | None:
        return news_of_kernel(changed)


def _most_telling(error: OSError) -> OSError:
    """Return the error of a refusal, else the last error, if several addresses' errors were merged into one."""
    numbers = [int(number) for number in re.findall(r"\[Errno (\d+)\]", str(error))]
    if error.errno is not None or not numbers:
        return error
    number = errno.ECONNREFUSED if errno.ECONNREFUSED in numbers else numbers[-1]
    return OSError(number, os.strerror(number))


def set_options(sock: socket.socket) -> None:
    """Have NATs remember idle connections, the kernel retry often, and give up a connection that carries nothing."""
    sock.setsockopt(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, _NOT_SENT_LOW_WATER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _IDLE)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _KEEPALIVE_EVERY)
    with contextlib.suppress(OSError):  # Multipath TCP has none: the link finds out itself
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _GIVEN_UP_AFTER_MS)
    with contextlib.suppress(OSError):
        _retry_after(sock, RETRIED_AFTER)
    prefer_bbr(sock)


def _retry_after(sock: socket.socket, seconds: int) -> None:
    """Have the kernel wait for so long at most between retransmissions.

    Raises:
        OSError: it has no such option, or Multipath TCP refuses it.
    """
    sock.setsockopt(socket.IPPROTO_TCP, TCP_RTO_MAX_MS, seconds * 1000)


def prefer_bbr(sock: socket.socket) -> None:
    """Have a TCP socket use `BBR`, if this machine has it and lets this user."""
    # The kernel's default takes each lost packet for a full link: at 2 % it carried a sixth of what BBR did.
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.IPPROTO_TCP, _TCP_CONGESTION, BBR.encode())


def congestion_control(sock: socket.socket) -> str:
    """Return the name of the congestion control that a TCP socket uses.

    Raises:
        OSError: the kernel does not tell.
    """
    return sock.getsockopt(socket.IPPROTO_TCP, _TCP_CONGESTION, _NAME_SIZE).rstrip(b"\0").decode(errors="replace")
