"""Bluetooth RFCOMM. Hosts are adapters' MACs, ports are channels.

The kernel's behaviour that this module allows for (seen on Linux 6.1.170 and 6.12): connecting to an absent peer takes
as long as the radio pages it; right after a connection was closed the next one may be refused, reset or find the
channel busy; two adapters have one connection on a channel; an address that no adapter has binds without an error.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from typing import TYPE_CHECKING

from rsb_bridge.bluetooth import hci
from rsb_bridge.model.transport_traits import RfcommTraits
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.listening import StreamListener
from rsb_bridge.transport.streams import Address, Stream, StreamHandler, os_error_message
from rsb_bridge.transport.transport import Acceptor, Listener, ListenError, StreamTransport
from rsb_bridge.wire.framing import MESSAGE_LIMIT

if TYPE_CHECKING:
    from rsb_bridge.model.session import Session

CONNECT_TIMEOUT = 12.0
"""s: paging alone takes up to 5.12 (Bluetooth Core, vol 4 part E, Page_Timeout), then come encryption and RFCOMM."""

_TRANSIENT = (errno.ECONNREFUSED, errno.ECONNRESET, errno.EBUSY)
_RETRY_FOR = 1.0
_RETRY_EVERY = 0.1
"""s; round figures."""
_BACKLOG = 8
"""Connections that the kernel holds until they are accepted; a robot's adapter has one on a channel."""
_BUFFER = 4096
"""Bytes that wait in the kernel each way: 80 ms of 50 kB/s. More would wait before a joystick's next message."""


class RfcommProblem(Wording):
    """The reasons why an RFCOMM channel can't be listened on or connected to, each with its remedy."""

    ANOTHER_ADAPTER = "{host} is no Bluetooth adapter of this machine: this machine's are {adapters}"
    NO_ADAPTER = "{host} is no Bluetooth adapter of this machine: it has none"
    CHANNEL_TAKEN = "RFCOMM channel {channel} is taken: choose one that rsb-console bt-scan shows as free"
    NO_ANSWER = "no answer: is it on, near, and is the MAC right? (rsb-console bt-scan, on that machine)"
    NOBODY_LISTENS = "nothing listens on channel {channel} there: is the server running, with that server_port?"
    CHANNEL_IN_USE = "channel {channel} there is in use by another program of this machine"


class RfcommStream(Stream):
    """An RFCOMM connection. It carries some 50 kB/s: what waits on it should be well below a second of that."""

    high_water = 2048
    """40 ms of 50 kB/s."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        sock: socket.socket = transport.get_extra_info("socket")
        for buffer in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, buffer, _BUFFER)
        super().connection_made(transport)

    @property
    def peer(self) -> str:
        return _format_address(self.address)


class Rfcomm(RfcommTraits, StreamTransport):
    """Bluetooth RFCOMM. Two adapters have one connection on a channel, so the routes of a channel share it."""

    largest_message = MESSAGE_LIMIT

    def host(self, session: Session) -> str:
        return session.adapter or session.host

    def format_address(self, address: Address) -> str:
        return _format_address(address)

    async def connect(self, host: str, port: int, handler: StreamHandler, rank: int | None = None) -> Stream:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT):
                sock = await _connected(host, port)
        except TimeoutError:
            raise OSError(_connect_error_message(errno.EHOSTDOWN, port)) from None
        _, stream = await loop.create_connection(lambda: RfcommStream(handler), sock=sock)
        return stream

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        """Accept connections on one adapter's channel, or with `hci.ANY_ADAPTER` on all adapters'."""
        try:
            own = {adapter.address for adapter in hci.adapters()}
            # The kernel would bind an address that no adapter has, and no client would ever find it.
            if host.upper() not in own | {hci.ANY_ADAPTER}:
                problem = RfcommProblem.ANOTHER_ADAPTER if own else RfcommProblem.NO_ADAPTER
                raise ListenError(problem(host=host, adapters=", ".join(sorted(own))))
            sock = hci.rfcomm_socket()
        except hci.NoBluetoothError as error:
            raise ListenError(str(error)) from None
        try:
            sock.bind((host, port))
            return StreamListener([sock], _BACKLOG, acceptor, RfcommStream)
        except OSError as error:
            sock.close()
            if error.errno == errno.EADDRINUSE:
                raise ListenError(RfcommProblem.CHANNEL_TAKEN(channel=port)) from None
            raise ListenError(f"RFCOMM channel {port} of {host}: {os_error_message(error)}") from None


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
        return RfcommProblem.NO_ANSWER()
    if error == errno.ECONNREFUSED:
        return RfcommProblem.NOBODY_LISTENS(channel=channel)
    if error == errno.EBUSY:
        return RfcommProblem.CHANNEL_IN_USE(channel=channel)
    if error == errno.EACCES:
        return "pairing failed: remove the other machine on both (bluetoothctl remove MAC), then pair them again"
    if error in (errno.EHOSTUNREACH, errno.ENETUNREACH):
        return "no Bluetooth adapter of this machine is on: rsb-console bt-scan"
    return os.strerror(error or 0)


def _format_address(address: Address) -> str:
    return f"{address[0]} channel {address[1]}"
