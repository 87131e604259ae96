"""A connected stream socket on the I/O loop, be it TCP or RFCOMM."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
from typing import Any, cast

from rsb_bridge.model.session import is_mac

BATCH_BYTES = 256 * 1024
"""As much as is worth one call, where the link is not slow."""

_LINGER = 2.0
_NOT_SENT_LOW_WATER = 32 * 1024
_TCP_NOTSENT_LOWAT = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
_IDLE, _KEEPALIVE_EVERY = 20, 5
"""s; the stingiest NATs forget an idle connection within a minute."""
_GIVEN_UP_AFTER_MS = 6_000
_TCP_RTO_MAX_MS = 44
_RETRIED_EVERY_MS = 1000
"""The kernel alone would wait ever longer between retransmissions, and so long after the network is back."""
# RFCOMM carries some 50 kB/s: what waits behind the scheduler (`shared`) should be well below a second of that.
_RFCOMM_HIGH_WATER = 2048
_RFCOMM_BUFFER = 4096


class StreamHandler:
    """What a stream's bytes go to; by itself it lets everything pass. Every method is called on the I/O loop."""

    def connected(self, stream: Stream) -> None:
        """The stream is there; called once, on its first handler."""

    def received(self, data: bytes) -> None:
        """Bytes came."""

    def writable(self) -> None:
        """The stream was congested and takes more again."""

    def closed(self, reason: str) -> None:
        """The stream is over, by whatever cause; called once."""


class Stream(asyncio.Protocol):
    """A thin shell over asyncio's transport: it adds byte counts, an address in words, and a handler that may change.

    Attributes:
        handler: gets what happens from now on.
        congested: bytes (RFCOMM: 2 KiB) wait for the kernel to take them: better not to write now.
        received_bytes: so far.
        sent_bytes: so far, those still waiting included.
        address: of the other end, as the socket module has it.
        own_address: of this end: its host or adapter.
        batch_bytes: how much to write at once, for good.
    """

    def __init__(self, handler: StreamHandler) -> None:
        self.handler = handler
        self.congested = False
        self.received_bytes = 0
        self.sent_bytes = 0
        self.address: tuple[Any, ...] = ("?", 0)
        self.own_address = ""
        self.batch_bytes = BATCH_BYTES
        self._transport: asyncio.Transport | None = None
        self._reason = ""

    def write(self, data: bytes) -> None:
        """Send, or keep until the socket takes it. Nothing happens on a stream that is over."""
        if self._transport is not None and not self._transport.is_closing():
            self.sent_bytes += len(data)
            self._transport.write(data)

    def close(self, reason: str = "closed here") -> None:
        """Send what waits, then close; a peer that takes nothing is not waited for longer than 2 s."""
        if self._transport is not None:
            self._reason = self._reason or reason
            self._transport.close()
            # Not the transport's own abort: on one that has ended, it would end it a second time.
            asyncio.get_running_loop().call_later(_LINGER, self.abort, reason)

    def abort(self, reason: str) -> None:
        """Close now; what waits is lost."""
        if self._transport is not None:
            self._reason = self._reason or reason
            self._transport.abort()

    @property
    def waiting_bytes(self) -> int:
        """What was written and the kernel has not taken yet."""
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    @property
    def over(self) -> bool:
        """Whether it is closed or closing."""
        return self._transport is None or self._transport.is_closing()

    @property
    def gone(self) -> bool:
        """Whether it is closed, and all that was written has left or is lost."""
        return self._transport is None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        sock: socket.socket = transport.get_extra_info("socket")
        # What waits should wait with us, where old messages can be dropped, not in the kernel.
        if sock.family in (socket.AF_INET, socket.AF_INET6):
            self._transport.set_write_buffer_limits(high=0)
            _set_tcp_options(sock)
        else:
            self.batch_bytes = _RFCOMM_HIGH_WATER
            self._transport.set_write_buffer_limits(high=_RFCOMM_HIGH_WATER)
            for buffer in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                sock.setsockopt(socket.SOL_SOCKET, buffer, _RFCOMM_BUFFER)
        self.address = transport.get_extra_info("peername") or self.address
        self.own_address = str((sock.getsockname() or [""])[0])  # a socketpair has no name
        self.handler.connected(self)

    @property
    def peer(self) -> str:
        """The other end's address in words."""
        return format_address(self.address)

    @property
    def host(self) -> str:
        """The other end's host or adapter, without port or channel."""
        return str(self.address[0])

    def data_received(self, data: bytes) -> None:
        self.received_bytes += len(data)
        self.handler.received(data)

    def pause_writing(self) -> None:
        self.congested = True

    def resume_writing(self) -> None:
        self.congested = False
        self.handler.writable()

    def eof_received(self) -> None:
        self._reason = self._reason or "closed by the other side"

    def connection_lost(self, error: Exception | None) -> None:
        self._transport = None
        self.handler.closed(self._reason or (os_error_message(error) if error else "closed"))


def _set_tcp_options(sock: socket.socket) -> None:
    """Have idle connections remembered by NATs, and those that carry nothing retried often, and given up in the end."""
    sock.setsockopt(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, _NOT_SENT_LOW_WATER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _IDLE)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _KEEPALIVE_EVERY)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _GIVEN_UP_AFTER_MS)
    with contextlib.suppress(OSError):  # Linux 6.15
        sock.setsockopt(socket.IPPROTO_TCP, _TCP_RTO_MAX_MS, _RETRIED_EVERY_MS)


def format_address(address: tuple[Any, ...]) -> str:
    """A socket address as ``host:port``, ``[host]:port`` for IPv6, ``MAC channel n`` for RFCOMM."""
    host, port = address[0], address[1]
    if is_mac(str(host)):
        return f"{host} channel {port}"
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"


def os_error_message(error: BaseException) -> str:
    """An OS error as a person reads it: the kernel's own words, without numbers."""
    if isinstance(error, TimeoutError) and not error.args:
        return "timed out"
    if isinstance(error, OSError) and error.errno and not isinstance(error, socket.gaierror):
        words = os.strerror(error.errno)  # asyncio puts its own into strerror
        return f"{words}: is the server running there?" if error.errno == errno.ECONNREFUSED else words
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
