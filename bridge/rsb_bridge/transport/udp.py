"""UDP sockets on the I/O loop, with what asyncio's datagram transport lacks: draining, segmentation, path MTU."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.transport_traits import UdpTraits
from rsb_bridge.transport.listening import bind
from rsb_bridge.transport.transport import (
    RECEIVE_BUFFER,
    Acceptor,
    Datagrams,
    DatagramSocket,
    DatagramTransport,
    SendPath,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.transport.streams import Address

# Round figures, if no source is named.
_DATAGRAMS_PER_WAKE, _BYTES_PER_WAKE = 64, 1024 * 1024  # that are read before the I/O loop turns to other work
# s. Wake-ups that are closer than this read until nothing is left. Others read once: one read mostly returns all that
# came together (UDP_GRO), a further one that finds nothing costs 1.3 µs, a quarter of a message's way through the
# kernel (bench/README.md, *UDP*), and the loop calls again if something is left.
_DENSE = 0.0001
# s until the kernel is asked again for the path's MTU, which ICMP may have changed, or to cut what is sent at once.
_SIZE_HOLDS = 1.0
_SIZES_KEPT = 256  # addresses whose path's MTU is kept; a peer that roams has a new one each time
# Bytes that wait for the kernel: senders of messages stop while the socket is congested, so that only probes, receipts
# and urgent messages come on top.
_BACKLOG_LIMIT = 16 * 1024 * 1024

# Of Linux.
_LARGEST = 65_535  # bytes of a datagram with its headers
_HEADERS = {socket.AF_INET: 28, socket.AF_INET6: 48}
_MOST_SEGMENTS, _LARGEST_RUN = 64, 65_507  # of one call: UDP_MAX_SEGMENTS, and an IP packet without the headers
# The option that forces a buffer's size, and the one that asks for it.
_RECEIVE_BUFFER, _SEND_BUFFER = (33, socket.SO_RCVBUF), (32, socket.SO_SNDBUF)
_IP_PKTINFO, _IP_MTU, _IPV6_MTU = 8, 14, 24
_UDP_SEGMENT, _UDP_GRO = 103, 104
_CONTROL_SPACE = socket.CMSG_SPACE(4)  # for the ancillary data of a received buffer
_SEGMENT_SIZE, _RECEIVED_SIZE = struct.Struct("=H"), struct.Struct("=i")
# The request for the time (wall clock) at which the kernel took the packet that was read last (socket(7)). The first
# one has the kernel stamp packets; to read a stamp with each datagram would cost every message.
_SIOCGSTAMPNS, _TIMESPEC = 0x8907, struct.Struct("@ll")

Received: TypeAlias = Callable[[DatagramSocket, Datagrams], None]


class UdpSocket:
    """A `DatagramSocket` of the kernel's, bound or connected."""

    def __init__(self, sock: socket.socket, received: Received) -> None:
        sock.setblocking(False)
        enlarge_buffers(sock)
        self._sock = sock
        self._received = received
        self._loop = asyncio.get_running_loop()
        self._segments = can_segment(sock)
        self._one_by_one_until = 0.0
        self._read_at = 0.0
        coalesce(sock)
        self._backlog: deque[tuple[Sequence[bytes], SendPath | None]] = deque()
        self._sizes: dict[Address, tuple[int, float]] = {}
        self.congested = False
        self.waiting_bytes = 0
        self.when_writable: set[Callable[[], None]] = set()
        self.arrived_at()  # the kernel stamps packets from now on
        self._loop.add_reader(sock, self._read)

    @property
    def port(self) -> int:
        return int(self._sock.getsockname()[1])

    @property
    def receive_buffer(self) -> int:
        """The granted size; a refused one is asked for again."""
        granted = granted_receive_buffer(self._sock)
        if granted < RECEIVE_BUFFER:
            _enlarge(self._sock, *_RECEIVE_BUFFER)
            granted = granted_receive_buffer(self._sock)
        return granted

    def arrived_at(self) -> float:
        now = self._loop.time()
        try:
            seconds, nanoseconds = _TIMESPEC.unpack(fcntl.ioctl(self._sock, _SIOCGSTAMPNS, bytes(_TIMESPEC.size)))
        except OSError:  # no packet yet
            return now
        waited: float = time.time() - seconds - nanoseconds / 1e9
        return now - max(0.0, waited)

    def path(self, source: str, address: Address) -> SendPath:
        """Name the source (IP_PKTINFO, IPV6_PKTINFO): the kernel alone might choose another."""
        if len(address) == 4:
            content = struct.pack("=16sI", socket.inet_pton(socket.AF_INET6, source), 0)
            return SendPath(address, [(socket.IPPROTO_IPV6, socket.IPV6_PKTINFO, content)])
        content = struct.pack("=I4s4x", 0, socket.inet_aton(source))
        return SendPath(address, [(socket.IPPROTO_IP, _IP_PKTINFO, content)])

    def send(self, datagrams: Sequence[bytes], path: SendPath | None) -> None:
        if self.congested:
            if self.waiting_bytes < _BACKLOG_LIMIT:
                self._wait(datagrams, path)
            return
        taken = self._send_all(datagrams, path)
        if taken < len(datagrams):
            self._wait(datagrams[taken:], path)
            self._loop.add_writer(self._sock, self._flush)

    def _wait(self, datagrams: Sequence[bytes], path: SendPath | None) -> None:
        self.congested = True
        self._backlog.append((datagrams, path))
        self.waiting_bytes += sum(map(len, datagrams))

    def datagram_size(self, address: Address) -> int:
        """Return what crosses without IP fragmentation, as far as the kernel knows."""
        now = self._loop.time()
        size, until = self._sizes.get(address, (0, 0.0))
        if now >= until:
            if len(self._sizes) >= _SIZES_KEPT:  # no order to keep: each size is asked for again within a second
                self._sizes.clear()
            size = min(_path_mtu(self._sock.family, address), _LARGEST) - _HEADERS[self._sock.family]
            self._sizes[address] = (size, now + _SIZE_HOLDS)
        return size

    def close(self) -> None:
        # Before the socket: its number may be another one's as soon as it is closed.
        self._loop.remove_reader(self._sock)
        self._loop.remove_writer(self._sock)
        self._backlog.clear()
        self.congested = False
        self.waiting_bytes = 0
        self._sock.close()

    def _read(self) -> None:
        now = self._loop.time()
        dense, self._read_at = now - self._read_at < _DENSE, now
        datagrams: Datagrams = []
        size, more = 0, True
        while more:
            try:
                data, control, _, address = self._sock.recvmsg(_LARGEST, _CONTROL_SPACE)
            except OSError:  # nothing is left, or ICMP refused an earlier send: the control connection tells who lives
                break
            if control:
                datagrams += [(datagram, address) for datagram in split_run(data, control)]
            else:
                datagrams.append((data, address))
            size += len(data)
            more = dense and len(datagrams) < _DATAGRAMS_PER_WAKE and size < _BYTES_PER_WAKE
        if datagrams:
            self._received(self, datagrams)

    def _send_all(self, datagrams: Sequence[bytes], path: SendPath | None) -> int:
        """Send until the kernel has no room; returns how many it has taken, or lost as UDP may."""
        begin, count = 0, len(datagrams)
        while begin < count:
            together = self._segments and begin + 1 < count and self._loop.time() >= self._one_by_one_until
            end = end_of_run(datagrams, begin) if together else begin + 1
            control, address = ([], None) if path is None else (path.control, path.address)
            if end - begin > 1:  # the kernel cuts them
                control = [*control, (socket.SOL_UDP, _UDP_SEGMENT, _SEGMENT_SIZE.pack(len(datagrams[begin])))]
            try:
                if control:
                    self._sock.sendmsg(datagrams[begin:end], control, 0, address)
                else:
                    self._sock.send(datagrams[begin])
            except BlockingIOError:
                return begin
            except OSError:
                self._sizes.clear()  # EMSGSIZE: the path changed
                if end - begin > 1:  # by the interface (EIO), or because of the path (EINVAL): one by one they may go
                    self._one_by_one_until = self._loop.time() + _SIZE_HOLDS
                    continue
            begin = end
        return count

    def _flush(self) -> None:
        while self._backlog:
            datagrams, path = self._backlog[0]
            taken = self._send_all(datagrams, path)
            self.waiting_bytes -= sum(map(len, datagrams[:taken]))
            if taken < len(datagrams):
                self._backlog[0] = datagrams[taken:], path
                return
            self._backlog.popleft()
        self.congested = False
        self._loop.remove_writer(self._sock)
        for writable in tuple(self.when_writable):  # a channel that closes in its turn leaves
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
    """A round figure: one lost fragment loses the message."""

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


def enlarge_buffers(sock: socket.socket) -> None:
    """Ask the kernel for `RECEIVE_BUFFER` bytes in each direction; it may grant less."""
    _enlarge(sock, *_SEND_BUFFER)
    _enlarge(sock, *_RECEIVE_BUFFER)


def granted_receive_buffer(sock: socket.socket) -> int:
    """Return the bytes that may wait in a socket. The kernel counts its overhead double."""
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def can_segment(sock: socket.socket) -> bool:
    """Whether the kernel cuts what is sent at once into datagrams (Linux 4.18)."""
    try:
        sock.getsockopt(socket.SOL_UDP, _UDP_SEGMENT)
    except OSError:
        return False
    return True


def coalesce(sock: socket.socket) -> bool:
    """Have the kernel hand over datagrams that came together at once (Linux 5.0); whether it does."""
    try:
        sock.setsockopt(socket.SOL_UDP, _UDP_GRO, 1)
    except OSError:
        return False
    return True


def end_of_run(datagrams: Sequence[bytes], begin: int) -> int:
    """Return the index behind the last datagram that one call may send from `begin` on: one size, the last shorter."""
    size = len(datagrams[begin])
    if not size:  # the kernel cuts nothing into pieces of 0 bytes
        return begin + 1
    most = min(begin + min(_MOST_SEGMENTS, _LARGEST_RUN // size), len(datagrams))
    end = begin + 1
    while end < most:
        length = len(datagrams[end])
        if length != size:
            return end + 1 if 0 < length < size else end  # an empty one would vanish in the buffer
        end += 1
    return end


def split_run(data: bytes, control: Sequence[tuple[int, int, bytes]]) -> list[bytes | memoryview]:
    """Split a received buffer into its datagrams."""
    for level, kind, content in control:
        if (level, kind) == (socket.SOL_UDP, _UDP_GRO):
            (size,) = _RECEIVED_SIZE.unpack_from(content)
            if 0 < size < len(data):
                view = memoryview(data)
                return [view[begin : begin + size] for begin in range(0, len(data), size)]
    return [data]


def _enlarge(sock: socket.socket, forced: int, asked: int) -> None:
    try:
        sock.setsockopt(socket.SOL_SOCKET, forced, RECEIVE_BUFFER)  # beyond net.core.?mem_max: with CAP_NET_ADMIN only
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, asked, RECEIVE_BUFFER)


def _path_mtu(family: int, address: Address) -> int:
    """Return the kernel's path MTU (ip(7) IP_MTU, ipv6(7) IPV6_MTU); 1280 (RFC 8200) if it knows none."""
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        if family == socket.AF_INET6:
            return probe.getsockopt(socket.IPPROTO_IPV6, _IPV6_MTU)
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return 1280
