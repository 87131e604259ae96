"""Bluetooth RFCOMM: connect and listen. Addresses are MACs, ports are channels.

What the kernel does (seen on Linux 6.1.170 and 6.12) and this allows for: an absent peer is waited for as long as the
radio pages it; right after a connection was closed the next one may be refused, reset or find the channel busy; one
pair of adapters has one connection a channel; an address that no adapter has binds without an error.
"""

from __future__ import annotations

import asyncio
import errno
import os
from typing import TYPE_CHECKING

from rsb_bridge.bluetooth import hci
from rsb_bridge.transport.streams import Stream, StreamHandler, os_error_message
from rsb_bridge.transport.tcp import ListenError

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

CONNECT_TIMEOUT = 12.0
"""s: paging alone takes up to 5.12 (Bluetooth Core, vol 4 part E, Page_Timeout), then come encryption and RFCOMM."""

_TRANSIENT = (errno.ECONNREFUSED, errno.ECONNRESET, errno.EBUSY)
_RETRY_FOR = 1.0
_RETRY_EVERY = 0.1
_BACKLOG = 8


async def connect(address: str, channel: int, handler: StreamHandler) -> Stream:
    """Connect to a channel of the adapter with that address.

    Raises:
        OSError: nobody answered within `CONNECT_TIMEOUT`, or it was refused; the words are an operator's.
    """
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT):
            sock = await _connected(address, channel)
    except TimeoutError:
        raise OSError(_connect_error_message(errno.EHOSTDOWN, channel)) from None
    _, stream = await loop.create_connection(lambda: Stream(handler), sock=sock)
    return stream


async def _connected(address: str, channel: int) -> socket.socket:
    loop = asyncio.get_running_loop()
    give_up = loop.time() + _RETRY_FOR
    while True:
        sock = hci.rfcomm_socket()
        sock.setblocking(False)
        try:
            await loop.sock_connect(sock, (address, channel))
        except OSError as error:
            sock.close()
            if error.errno not in _TRANSIENT or loop.time() > give_up:
                raise OSError(_connect_error_message(error.errno, channel)) from None
            await asyncio.sleep(_RETRY_EVERY)
        except asyncio.CancelledError:
            sock.close()
            raise
        else:
            return sock


def _connect_error_message(error: int | None, channel: int) -> str:
    if error == errno.EHOSTDOWN:
        return "no answer: is it on, near, and is the MAC right? (rsb-console bt-scan, on that machine)"
    if error == errno.ECONNREFUSED:
        return f"nobody listens on channel {channel} there: is the server running, with that server_port?"
    if error == errno.EBUSY:
        return f"channel {channel} there is in use by another program of this machine"
    if error == errno.EACCES:
        return "pairing failed: remove the other machine on both (bluetoothctl remove MAC), then pair them again"
    if error in (errno.EHOSTUNREACH, errno.ENETUNREACH):
        return "no Bluetooth adapter of this machine is on: rsb-console bt-scan"
    return os.strerror(error or 0)


async def listen(address: str, channel: int, make_handler: Callable[[], StreamHandler]) -> asyncio.Server:
    """Accept connections on one adapter's channel, or with `hci.ANY_ADAPTER` on all adapters'.

    Raises:
        ListenError: in words.
    """
    loop = asyncio.get_running_loop()
    try:
        own = {adapter.address for adapter in hci.adapters()}
        if address.upper() not in own | {hci.ANY_ADAPTER}:
            here = f"this machine's are {', '.join(sorted(own))}" if own else "it has none"
            raise ListenError(f"{address} is no Bluetooth adapter of this machine: {here}")
        sock = hci.rfcomm_socket()
    except hci.NoBluetoothError as error:
        raise ListenError(str(error)) from None
    try:
        sock.bind((address, channel))
        return await loop.create_server(lambda: Stream(make_handler()), sock=sock, backlog=_BACKLOG)
    except OSError as error:
        sock.close()
        if error.errno == errno.EADDRINUSE:
            words = f"RFCOMM channel {channel} is taken: choose one that rsb-console bt-scan shows as free"
            raise ListenError(words) from None
        raise ListenError(f"RFCOMM channel {channel} of {address}: {os_error_message(error)}") from None
