"""TCP: connect and listen."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from typing import TYPE_CHECKING, Any

from rsb_bridge.transport.names import look_up
from rsb_bridge.transport.streams import Stream, StreamHandler, os_error_message

if TYPE_CHECKING:
    from collections.abc import Callable

CONNECT_TIMEOUT = 3.0
_BACKLOG = 128


class ListenError(Exception):
    """An address can't be bound; the message says why and what to do."""


async def connect(host: str, port: int, handler: StreamHandler) -> Stream:
    """Connect to the first of the host's addresses that answers; each has its share of `CONNECT_TIMEOUT`.

    Not asyncio's "happy eyeballs", which leaves a socket open when it is cancelled just as that has connected.

    Raises:
        OSError: none did, or the name is not known.
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


async def _connect(sock: socket.socket, address: tuple[Any, ...], handler: StreamHandler) -> Stream:
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as unless_connected:
        unless_connected.callback(sock.close)
        sock.setblocking(False)
        await loop.sock_connect(sock, address)
        _, stream = await loop.create_connection(lambda: Stream(handler), sock=sock)
        unless_connected.pop_all()
    return stream


def own_address(peer: tuple[Any, ...]) -> str:
    """The address that this machine would connect to a peer from; empty: there is no way to it now."""
    family = socket.AF_INET6 if len(peer) == 4 else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:  # connecting sends nothing
        try:
            probe.connect(peer)
        except OSError:
            return ""
        return str(probe.getsockname()[0])


async def listen(host: str, port: int, make_handler: Callable[[], StreamHandler]) -> asyncio.Server:
    """Accept connections on all the host's addresses, each with a handler of its own.

    Raises:
        ListenError: in words.
    """
    loop = asyncio.get_running_loop()

    def accept() -> Stream:
        return Stream(make_handler())

    try:
        return await loop.create_server(accept, host, port, backlog=_BACKLOG, reuse_address=True)
    except OSError as error:
        raise ListenError(listen_error_message(error, f"{host}:{port}", "TCP")) from None


def listen_error_message(error: OSError, address: str, kind: str) -> str:
    """Why an address can't be bound, and the remedy."""
    if error.errno == errno.EADDRINUSE:
        return f"{kind} {address} is taken by another process: stop it, or choose another port (ss -lntup shows whose)"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{address} is not an address of this machine: use one that `ip addr` shows, or 0.0.0.0 for all"
    if error.errno == errno.EACCES:
        return f"{kind} {address}: ports below 1024 need root; choose a higher one"
    if isinstance(error, socket.gaierror):
        remedy = "set server_ip in this side's session file to an address that `ip addr` shows, or 0.0.0.0 for all"
        return f"{address}: the name is not known ({error.strerror}): {remedy}"
    return f"{kind} {address}: {os_error_message(error)}"
