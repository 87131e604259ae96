"""Addresses of host names, sockets that are bound to them, and the streams that these accept."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.wording import Wording
from rsb_bridge.tasks import in_thread
from rsb_bridge.transport.descriptors import SHORTAGES, first_open_port
from rsb_bridge.transport.streams import os_error_message
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.transport.streams import Address, Stream, StreamHandler
    from rsb_bridge.transport.transport import Acceptor

EVERY_ADDRESS = "::"
_LOOKED_UP_WITHIN = 3.0
"""s for the address of a name; a round figure."""
_AT_ONCE = 16
"""Connections accepted before the I/O loop turns to other work. Two such batches later the first one has been read: few
enough that a client which has spoken is read before those behind it are too many (`link.pending_connections`)."""
_SHORT_FOR = 0.25
"""s until accepting is tried again where descriptors or memory are lacking: a round figure."""

FoundAddresses = Sequence[tuple[int | socket.AddressFamily, int | socket.SocketKind, int, str, tuple[Any, ...]]]


class LookUpProblem(Wording):
    """The reasons why a host's name has no address."""

    NO_NAME_SERVER = "the name can't be looked up: no name server answers within {seconds:g} s"
    NO_ADDRESS = "{host}: the name has no address"


class ListenProblem(Wording):
    """The reasons why an address cannot be bound, each with its remedy."""

    TAKEN = "{kind} {address} is taken by another process: stop it, or choose another port (ss -lntup shows whose)"
    NOT_OF_THIS_MACHINE = (
        "{address} is not an address of this machine: use one that `ip addr` shows, or 0.0.0.0 for all; if the server "
        "is another machine, write role: client"
    )
    PRIVILEGED = "{kind} {address}: ports below {limit} need root or CAP_NET_BIND_SERVICE: use a higher one"
    NAME_UNKNOWN = (
        "{address}: the name is not known ({error}): set server_ip in this side's session file to an address that "
        "`ip addr` shows, or 0.0.0.0 for all"
    )


async def look_up(
    host: str, port: int, within: float, kind: socket.SocketKind = socket.SOCK_STREAM, flags: int = 0
) -> FoundAddresses:
    """Return the addresses of a host, as `socket.getaddrinfo` gives them.

    Args:
        host: a name or an address.
        within: s until the lookup is given up.
        flags: as in `socket.getaddrinfo`.

    Raises:
        OSError: the name is not known, or no name server answers.
    """
    # An address needs no thread: each stream of a link would start one.
    with contextlib.suppress(socket.gaierror):
        return socket.getaddrinfo(host, port, type=kind, flags=flags | socket.AI_NUMERICHOST)
    try:
        return await in_thread("look-up", lambda: socket.getaddrinfo(host, port, type=kind, flags=flags), within)
    except TimeoutError:
        raise OSError(LookUpProblem.NO_NAME_SERVER(seconds=within)) from None


async def bind(
    host: str, port: int, kind: socket.SocketKind, make: Callable[[int, int, int], socket.socket] | None = None
) -> list[socket.socket]:
    """Bind a socket on each of the host's addresses; ``::`` is every address, of IPv4 too.

    Args:
        make: makes one of a family, kind and protocol, in place of the kernel's usual ones.

    Raises:
        ListenError: one of them can't be bound.
    """
    sockets: list[socket.socket] = []
    try:
        found = [*await look_up(host, port, _LOOKED_UP_WITHIN, kind, socket.AI_PASSIVE)]
        if host == EVERY_ADDRESS:
            found += await look_up("0.0.0.0", port, _LOOKED_UP_WITHIN, kind, socket.AI_PASSIVE)  # noqa: S104
        for family, type_, proto, _, address in dict.fromkeys(found):  # one listed twice could not be bound again
            sock = (make or socket.socket)(family, type_, proto)
            sockets.append(sock)
            sock.setblocking(False)
            # Connections that have just ended would keep the port. With UDP it would let two processes have one port.
            if kind is socket.SOCK_STREAM:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # Else it takes the port of IPv4, too, which has a socket of its own.
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            sock.bind(address)
    except OSError as error:
        for sock in sockets:
            sock.close()
        name = "TCP" if kind is socket.SOCK_STREAM else "UDP"
        raise ListenError(listen_error_message(error, f"{host}:{port}", name)) from None
    return sockets


class StreamListener:
    """Accepts connections on bound sockets, as `asyncio.Server` does.

    While the process lacks descriptors, it reports that and tries again four times a second; `asyncio.Server` would
    report each attempt as an internal error, as often as its backlog is long.
    """

    def __init__(
        self,
        sockets: list[socket.socket],
        backlog: int,
        acceptor: Acceptor,
        make_stream: Callable[[StreamHandler], Stream],
    ) -> None:
        """Begin to listen.

        Args:
            sockets: bound; they are closed with this.
            backlog: connections that the kernel may hold until they are accepted.

        Raises:
            OSError: another program has bound the port, too, and listens already; the sockets are closed.
        """
        self._loop = asyncio.get_running_loop()
        self._sockets = sockets
        self._acceptor = acceptor
        self._make_stream = make_stream
        self._accepting: set[asyncio.Task[None]] = set()
        self._again: dict[socket.socket, asyncio.TimerHandle] = {}
        try:
            for sock in sockets:
                sock.setblocking(False)
                sock.listen(backlog)
        except OSError:
            for sock in sockets:
                sock.close()
            raise
        for sock in sockets:
            self._loop.add_reader(sock, self._accept, sock)

    def close(self) -> None:
        """Free the port, and close connections whose stream is not made yet."""
        for task in self._accepting:
            task.cancel()
        for timer in self._again.values():
            timer.cancel()
        for sock in self._sockets:
            self._loop.remove_reader(sock)
            sock.close()
        self._sockets.clear()

    def _accept(self, sock: socket.socket) -> None:
        for _ in range(_AT_ONCE):
            try:
                accepted, address = sock.accept()
            except OSError as error:
                if error.errno in SHORTAGES:
                    self._rest(sock, error)
                return  # else nothing waits, or the connection has ended already
            accepted.setblocking(False)
            task = self._loop.create_task(self._serve(accepted, address))
            self._accepting.add(task)  # a loop holds its tasks only weakly
            task.add_done_callback(partial(self._served, accepted))

    def _rest(self, sock: socket.socket, error: OSError) -> None:
        self._loop.remove_reader(sock)
        self._again[sock] = self._loop.call_later(_SHORT_FOR, self._loop.add_reader, sock, self._accept, sock)
        self._acceptor.shortage(os_error_message(error))

    async def _serve(self, accepted: socket.socket, address: Address) -> None:
        def make_stream() -> Stream:
            stream = self._make_stream(self._acceptor.make_handler())
            stream.address = address  # the kernel forgets it when the other end resets the connection
            return stream

        try:
            await self._loop.connect_accepted_socket(make_stream, accepted)
        except OSError:  # it has ended already
            accepted.close()

    def _served(self, accepted: socket.socket, task: asyncio.Task[None]) -> None:
        self._accepting.discard(task)
        if task.cancelled():  # the listener or the loop ends, perhaps before the task has begun
            accepted.close()


def listen_error_message(error: OSError, address: str, kind: str) -> str:
    """Return the reason why an address can't be bound, and the remedy."""
    if error.errno == errno.EADDRINUSE:
        return ListenProblem.TAKEN(kind=kind, address=address)
    if error.errno == errno.EADDRNOTAVAIL:
        return ListenProblem.NOT_OF_THIS_MACHINE(address=address)
    if error.errno == errno.EACCES:
        return ListenProblem.PRIVILEGED(kind=kind, address=address, limit=first_open_port())
    if isinstance(error, socket.gaierror):
        return ListenProblem.NAME_UNKNOWN(address=address, error=error.strerror)
    return f"{kind} {address}: {os_error_message(error)}"
