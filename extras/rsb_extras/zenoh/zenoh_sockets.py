"""The TCP sockets of this process's Zenoh links: Zenoh has no settings for their options."""

from __future__ import annotations

import contextlib
import os
import socket
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.transport import tcp

if TYPE_CHECKING:
    import zenoh

OVER_TCP = ("tcp", "tls", "ws")
"""Zenoh's protocols over TCP."""
_IP = (socket.AF_INET, socket.AF_INET6)


def prepare_socket(link: zenoh.Link) -> bool:
    """Set the options of this project's own TCP sockets on that of a link of this process.

    Zenoh has no settings for them. With the kernel's own, it takes twice as long as a cut lasted until a link carries
    again (retries double, up to 2 min), lost packets count as a full link, and what waits in the kernel is in no order
    of priority.

    Returns:
        whether the link has such a socket, and it was found.
    """
    protocol, _, here = link.src.partition("/")
    if protocol not in OVER_TCP:
        return False
    ends = _socket_address(here), _socket_address(link.dst.partition("/")[2])
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # it is closed meanwhile, or not connected
            if str(each.readlink()).startswith("socket:") and _prepared(int(each.name), ends):
                return True
    return False


def _prepared(descriptor: int, ends: tuple[object, object]) -> bool:
    # A copy: to close it leaves Zenoh's own open.
    with socket.socket(fileno=os.dup(descriptor)) as found:
        if found.family not in _IP or found.type != socket.SOCK_STREAM:
            return False
        if (_comparable(found.getsockname()), _comparable(found.getpeername())) != ends:
            return False
        tcp.set_options(found)
        return True


def _socket_address(address: str) -> tuple[object, int]:
    host, _, port = address.rpartition(":")
    return _comparable((host.strip("[]"), int(port)))


def _comparable(address: tuple[str, int] | tuple[str, int, int, int]) -> tuple[object, int]:
    ip = ip_address(address[0].partition("%")[0])
    return (isinstance(ip, IPv6Address) and ip.ipv4_mapped) or ip, address[1]
