"""UDP sockets on the I/O loop, with what asyncio's datagram transport lacks: draining, pacing, path MTU."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.transports import UdpTraits
from rsb_bridge.transport.listening import bind
from rsb_bridge.transport.transport import (
    Acceptor,
    Datagrams,
    DatagramSocket,
    DatagramTransport,
    SendPath,
)

if TYPE_CHECKING:
    from rsb_bridge.transport.streams import Address

_READS_PER_WAKE = 64
_BUFFER = 8 * 1024 * 1024
"""Bytes of each kernel buffer, if it grants that much."""
_LARGEST = 65_535
"""Bytes of a datagram with its headers."""
_BURST = 128 * 1024
_BURST_PAUSE = 0.001
"""A message larger than `_BURST` bytes is sent in bursts with pauses of so many s between them."""
_SO_RCVBUFFORCE, _SO_SNDBUFFORCE = 33, 32
_IP_PKTINFO, _IP_MTU, _IPV6_MTU = 8, 14, 24
_HEADERS = {socket.AF_INET: 28, socket.AF_INET6: 48}
_SIZE_HOLDS = 1.0
"""s until the kernel is asked again for the path's MTU, which ICMP may have changed."""
_SIZES_KEPT = 256
"""Addresses whose path's MTU is kept; a peer that roams has a new one each time."""
_BACKLOG_LIMIT = 16 * 1024 * 1024
"""Bytes that wait for the kernel, or for their turn."""


Received: TypeAlias = Callable[[DatagramSocket, Datagrams], None]


class UdpSocket:
    """A bound or connected UDP socket.

    Attributes:
        when_writable: called when the socket was congested and takes more again.
        waiting_bytes: what waits for the kernel, or for its turn.
    """

    def __init__(self, sock: socket.socket, received: Received) -> None:
        sock.setblocking(False)
        _enlarge_buffers(sock)
        self._sock = sock
        self._received = received
        self._loop = asyncio.get_running_loop()
        self._backlog: deque[tuple[bytes, SendPath | None]] = deque()
        self._sizes: dict[Address, tuple[int, float]] = {}
        self._timer: asyncio.TimerHandle | None = None
        self.waiting_bytes = 0
        self.when_writable: set[Callable[[], None]] = set()
        self._loop.add_reader(sock, self._read)

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._sock.getsockname()[1])

    @property
    def congested(self) -> bool:
        return bool(self._backlog)

    def path(self, source: str, address: Address) -> SendPath:
        """See `DatagramSocket.path`; the kernel alone might choose another source (IP_PKTINFO, IPV6_PKTINFO)."""
        if len(address) == 4:
            content = struct.pack("=16sI", socket.inet_pton(socket.AF_INET6, source), 0)
            return SendPath(address, [(socket.IPPROTO_IPV6, socket.IPV6_PKTINFO, content)])
        content = struct.pack("=I4s4x", 0, socket.inet_aton(source))
        return SendPath(address, [(socket.IPPROTO_IP, _IP_PKTINFO, content)])

    def send(self, datagrams: list[bytes], path: SendPath | None) -> None:
        """See `DatagramSocket.send`.

        A message larger than a burst is paced at 128 MB/s: the far kernel's buffer is small, and nothing on loopback or
        a fast link would slow us down.
        """
        if self._backlog:
            if self.waiting_bytes < _BACKLOG_LIMIT:
                self._wait(datagrams, path)
            return
        burst = _BURST
        for index, datagram in enumerate(datagrams):
            burst -= len(datagram)
            if burst < 0 and index:
                self._wait(datagrams[index:], path)
                self._timer = self._loop.call_later(_BURST_PAUSE, self._flush)
                return
            if not self._send_one(datagram, path):
                self._wait(datagrams[index:], path)
                self._loop.add_writer(self._sock, self._flush)
                return

    def _wait(self, datagrams: list[bytes], path: SendPath | None) -> None:
        self._backlog.extend((datagram, path) for datagram in datagrams)
        self.waiting_bytes += sum(map(len, datagrams))

    def datagram_size(self, address: Address) -> int:
        """See `DatagramSocket.datagram_size`; without IP fragmentation, as far as the kernel knows."""
        now = self._loop.time()
        size, until = self._sizes.get(address, (0, 0.0))
        if now >= until:
            if len(self._sizes) >= _SIZES_KEPT:
                self._sizes.clear()
            size = min(_path_mtu(self._sock.family, address), _LARGEST) - _HEADERS[self._sock.family]
            self._sizes[address] = (size, now + _SIZE_HOLDS)
        return size

    def close(self) -> None:
        """Close it; what waits is lost."""
        if self._timer:
            self._timer.cancel()
        self._loop.remove_reader(self._sock)
        self._loop.remove_writer(self._sock)
        self._backlog.clear()
        self.waiting_bytes = 0
        self._sock.close()

    def _read(self) -> None:
        datagrams: Datagrams = []
        # An OSError is an ICMP error of an earlier send: the control connection tells whether the peer lives.
        with contextlib.suppress(OSError):
            while len(datagrams) < _READS_PER_WAKE:
                datagrams.append(self._sock.recvfrom(_LARGEST))
        if datagrams:
            self._received(self, datagrams)

    def _send_one(self, datagram: bytes, path: SendPath | None) -> bool:
        try:
            if path is None:
                self._sock.send(datagram)
            else:
                self._sock.sendmsg((datagram,), path.control, 0, path.address)
        except BlockingIOError:
            return False
        except OSError:
            self._sizes.clear()  # EMSGSIZE: the path changed; other errors: lost, as UDP may
        return True

    def _flush(self) -> None:
        self._loop.remove_writer(self._sock)
        self._timer = None
        burst = _BURST
        while self._backlog:
            datagram, path = self._backlog[0]
            burst -= len(datagram)
            if burst < 0:
                self._timer = self._loop.call_later(_BURST_PAUSE, self._flush)
                return
            if not self._send_one(datagram, path):
                self._loop.add_writer(self._sock, self._flush)
                return
            self._backlog.popleft()
            self.waiting_bytes -= len(datagram)
        for writable in tuple(self.when_writable):
            writable()


@dataclass(frozen=True, slots=True)
class _Bound:
    """The sockets of one port, one for each address."""

    sockets: list[UdpSocket]

    def close(self) -> None:
        for udp in self.sockets:
            udp.close()


class Udp(UdpTraits, DatagramTransport):
    """UDP over IPv4 and IPv6."""

    largest_message = 8 * 1024 * 1024

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> _Bound:
        sockets = await bind(host, port, socket.SOCK_DGRAM)
        return _Bound([UdpSocket(sock, acceptor.datagrams) for sock in sockets])

    def connect(self, peer: Address, received: Received) -> UdpSocket:
        family = socket.AF_INET6 if len(peer) == 4 else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.connect(peer)
        except OSError:
            sock.close()
            raise
        return UdpSocket(sock, received)


def _enlarge_buffers(sock: socket.socket) -> None:
    for forced, asked in ((_SO_RCVBUFFORCE, socket.SO_RCVBUF), (_SO_SNDBUFFORCE, socket.SO_SNDBUF)):
        try:
            sock.setsockopt(socket.SOL_SOCKET, forced, _BUFFER)  # beyond net.core.?mem_max: root only
        except OSError:
            sock.setsockopt(socket.SOL_SOCKET, asked, _BUFFER)


def _path_mtu(family: int, address: Address) -> int:
    """The kernel's path MTU (ip(7) IP_MTU, ipv6(7) IPV6_MTU); 1280 (RFC 8200) if it knows none."""
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        if family == socket.AF_INET6:
            return probe.getsockopt(socket.IPPROTO_IPV6, _IPV6_MTU)
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return 1280
