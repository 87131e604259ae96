"""Multipath TCP (RFC 8684) of the kernel: a stream that several ways of this machine carry.

The kernel opens further subflows from the addresses that an operator has named (`ip mptcp endpoint`), and sends over a
backup only while no other way answers. An end without it makes a stream a plain TCP connection.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

_PROTOCOL, _SO_PROTOCOL = 262, 38
_SOL_MPTCP = 284
_MPTCP_INFO, _MPTCP_TCPINFO, _MPTCP_SUBFLOW_ADDRS = 1, 2, 3  # linux/mptcp.h
_FALLBACK = 1
_INFO = struct.Struct("=8x I 36x Q Q 8x Q")
"""Of struct mptcp_info: flags, and bytes sent again, sent and acknowledged; Linux has these since 6.5."""
_INFO_SIZE = 256  # bytes: more than it has
_HEADER = struct.Struct("=IIII")  # struct mptcp_subflow_data: its size, subflows, the kernel's size of each, and ours
_ADDRESS_SIZE = 128  # of a struct sockaddr_storage
_MOST = 8  # subflows that are read; the kernel opens at most as many besides the first one
_ENDED = ("0.0.0.0", "::")  # noqa: S104 -- the addresses of a subflow that the kernel has given up
_REPETITIONS = 2  # in a row, after which a way does not answer; one happens where packets get lost
_TCP_INFO = struct.Struct("=2xB 41x I")  # of struct tcp_info: `tcpi_retransmits` and `tcpi_last_data_sent` (ms)


class Bytes(NamedTuple):
    """Bytes of a stream on all its ways together."""

    again: int
    sent: int
    acknowledged: int


class Subflow(NamedTuple):
    """One subflow of a stream.

    Attributes:
        own: its address on this machine.
        peer: its address at the other end.
        sent_ago: s since data went that way.
        answers: whether it has not been sent the same bytes again and again.
    """

    own: str
    peer: str
    sent_ago: float
    answers: bool


def problem() -> str:
    """Return why the kernel opens no such streams, or an empty string."""
    try:
        new_socket(socket.AF_INET, socket.SOCK_STREAM).close()
    except OSError as error:
        return os.strerror(error.errno or 0)
    return ""


def new_socket(family: int, kind: int) -> socket.socket:
    """Return a socket of Multipath TCP. Its `proto` is that of TCP, by which asyncio looks up addresses.

    Raises:
        OSError: the kernel has none.
    """
    return socket.socket(family, kind, socket.IPPROTO_TCP, fileno=socket.socket(family, kind, _PROTOCOL).detach())


def stream_bytes(sock: socket.socket) -> Bytes | None:
    """Return what a stream has carried, or None if it is plain TCP or the kernel does not count that."""
    try:
        if sock.getsockopt(socket.SOL_SOCKET, _SO_PROTOCOL) != _PROTOCOL:
            return None
        info = sock.getsockopt(_SOL_MPTCP, _MPTCP_INFO, _INFO_SIZE)
    except OSError:
        return None
    if len(info) < _INFO.size:
        return None
    flags, *counts = _INFO.unpack_from(info)
    return None if flags & _FALLBACK else Bytes(*counts)


def tcp_infos(sock: socket.socket, size: int) -> Sequence[bytes]:
    """Return the first bytes of the kernel's tcp_info of each subflow.

    Raises:
        OSError: the stream is plain TCP, or over.
    """
    return _of_subflows(sock, _MPTCP_TCPINFO, size)


def subflows(sock: socket.socket) -> Sequence[Subflow]:
    """Return the subflows of a stream; raises as `tcp_infos`."""
    infos = [_TCP_INFO.unpack(each) for each in tcp_infos(sock, _TCP_INFO.size)]
    addresses = _of_subflows(sock, _MPTCP_SUBFLOW_ADDRS, 2 * _ADDRESS_SIZE)
    found = [
        Subflow(_host(each), _host(each[_ADDRESS_SIZE:]), sent_ago / 1000, repeated < _REPETITIONS)
        for each, (repeated, sent_ago) in zip(addresses, infos, strict=False)  # one may end in between
    ]
    return [each for each in found if each.own not in _ENDED]


def _host(address: bytes) -> str:
    family = int.from_bytes(address[:2], "little")
    if family == socket.AF_INET:
        return socket.inet_ntop(family, address[4:8])
    host = socket.inet_ntop(socket.AF_INET6, address[8:24])
    return host.removeprefix("::ffff:")


def _of_subflows(sock: socket.socket, option: int, size: int) -> Sequence[bytes]:
    # Not `socket.getsockopt`: the kernel reads from the buffer how much of each subflow is wanted.
    buffer = ctypes.create_string_buffer(_HEADER.size + _MOST * size)
    _HEADER.pack_into(buffer, 0, _HEADER.size, 0, 0, size)
    length = ctypes.c_uint(len(buffer))
    library = ctypes.CDLL(None, use_errno=True)
    if library.getsockopt(sock.fileno(), _SOL_MPTCP, option, buffer, ctypes.byref(length)):
        number = ctypes.get_errno() or errno.EOPNOTSUPP
        raise OSError(number, os.strerror(number))
    count = min(_HEADER.unpack_from(buffer)[1], _MOST)
    return [buffer.raw[_HEADER.size + each * size : _HEADER.size + (each + 1) * size] for each in range(count)]
