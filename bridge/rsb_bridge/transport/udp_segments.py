"""Many datagrams of one size in one call, where the kernel has that (udp(7): UDP_SEGMENT, UDP_GRO)."""

from __future__ import annotations

import socket
import struct
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Sequence

Control: TypeAlias = tuple[int, int, bytes]
"""Ancillary data: level, type, content (sendmsg(2))."""

CONTROL_SPACE = socket.CMSG_SPACE(4)
"""Bytes of ancillary data to receive."""

_UDP_SEGMENT, _UDP_GRO = 103, 104
_MOST_SEGMENTS = 64
_MOST_BYTES = 65_507
"""Linux's limits of one call: UDP_MAX_SEGMENTS, and an IP packet without the headers."""
_SEGMENT_SIZE = struct.Struct("=H")
_RECEIVED_SIZE = struct.Struct("=i")


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
    most = min(begin + min(_MOST_SEGMENTS, _MOST_BYTES // size), len(datagrams))
    end = begin + 1
    while end < most:
        length = len(datagrams[end])
        if length != size:
            return end + 1 if 0 < length < size else end  # an empty one would vanish in the buffer
        end += 1
    return end


def segment(size: int) -> Control:
    """Return the ancillary data for the kernel to cut a buffer into datagrams of `size` bytes."""
    return socket.SOL_UDP, _UDP_SEGMENT, _SEGMENT_SIZE.pack(size)


def split(data: bytes, control: Sequence[Control]) -> list[bytes | memoryview]:
    """Split a received buffer into its datagrams."""
    for level, kind, content in control:
        if (level, kind) == (socket.SOL_UDP, _UDP_GRO):
            (size,) = _RECEIVED_SIZE.unpack_from(content)
            if 0 < size < len(data):
                view = memoryview(data)
                return [view[begin : begin + size] for begin in range(0, len(data), size)]
    return [data]
