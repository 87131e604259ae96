"""Sockets as the engine's transports use them, on a simulated machine.

`simulated` puts `Socket` in the place of the `socket` module's for those transports, so that their own code is what
runs: they bind, listen, accept, connect, set options and read datagrams as ever; the loop hands the rest on to here.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import errno
import socket as real
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any, TypeAlias
from unittest import mock

from tests.simulation.loop import PROGRAM
from tests.simulation.machine import ANY, Machine, Process, os_error
from tests.simulation.network import is_numeric
from tests.simulation.streams import StreamTransport

Address: TypeAlias = tuple[Any, ...]

_SYN_PAUSES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""s between the packets that ask for a connection which nobody answers."""
_LOOK_UP = (0.0005, 0.05)
"""s, between which a name server takes to answer."""
_HEADERS = 28
_IP_PKTINFO, _IP_MTU = 8, 14
_SO_RCVBUFFORCE = 33
_FIRST_DESCRIPTOR = 16
_TRANSPORTS = ("rsb_bridge.transport.", "rsb_bridge.tasks", "aiohappyeyeballs.")
"""Modules that get simulated sockets."""


class Socket:
    """A socket: for datagrams, to accept streams, or a stream's until it is handed to a transport."""

    def __init__(
        self,
        family: int = real.AF_INET,
        type: int = real.SOCK_STREAM,  # noqa: A002 — the socket module's
        proto: int = 0,
    ) -> None:
        process = current_process()
        if family == real.AF_NETLINK:  # so that it tells no news of the network: simulated time stays pure
            raise os_error(errno.EAFNOSUPPORT)
        if not process.alive:
            raise os_error(errno.ENETDOWN)
        if len(process.descriptors) + _FIRST_DESCRIPTOR >= process.most_descriptors:
            raise os_error(errno.EMFILE)
        self.family = family
        self.type = type
        self.process = process
        self.options: dict[tuple[int, int], Any] = {}
        self._machine = process.machine
        self.own: Address = (ANY, 0)
        self.remote: Address | None = None
        self.transport: StreamTransport | None = None
        self.backlog: deque[tuple[StreamTransport, Address]] | None = None
        self.most_waiting = 0
        self._queue: deque[tuple[bytes, Address]] = deque()
        self._queued_bytes = 0
        self._wake: Callable[[], object] | None = None
        self._woken = False
        self._context = contextvars.copy_context()
        process.descriptors[self] = None

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def setblocking(self, flag: bool) -> None:  # the socket module's
        """Nothing in here blocks."""

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        """Note an option.

        Raises:
            OSError: the kernel has none of UDP's offloads, and lets nobody exceed its limits.
        """
        if level == real.SOL_UDP:
            raise os_error(errno.ENOPROTOOPT)
        if (level, option) == (real.SOL_SOCKET, _SO_RCVBUFFORCE):
            raise os_error(errno.EPERM)
        if (level, option) == (real.SOL_SOCKET, real.SO_RCVBUF):
            value = 2 * min(value, self._machine.receive_buffer)
        self.options[level, option] = value

    def getsockopt(self, level: int, option: int, size: int = 0) -> int | bytes:
        """Read an option; of TCP's own figures, all are 0."""
        if level == real.SOL_UDP:
            raise os_error(errno.ENOPROTOOPT)
        if (level, option) == (real.IPPROTO_TCP, real.TCP_INFO):
            return bytes(size)
        if (level, option) == (real.IPPROTO_IP, _IP_MTU):
            peer = self._machine.network.machine_at(self.remote[0]) if self.remote else None
            if peer is None:
                raise os_error(errno.ENOTCONN)
            return self._machine.network.path(self._machine, peer).mtu
        return int(self.options.get((level, option), 0))

    def getsockname(self) -> Address:
        return self.own

    def getpeername(self) -> Address:
        assert self.remote is not None
        return self.remote

    def fileno(self) -> int:
        """Its number, as if it had been the last to get one."""
        return _FIRST_DESCRIPTOR + len(self.process.descriptors)

    def close(self) -> None:
        """Free it, with the connections that nobody has taken over yet."""
        for transport in self._free():
            transport.abort()

    def killed(self) -> None:
        for transport in self._free():
            transport.killed()

    def vanished(self) -> None:
        for transport in self._free():
            transport.vanished()

    def _free(self) -> list[StreamTransport]:
        """Give everything back; the connections that it still had."""
        self.process.descriptors.pop(self, None)
        if self._machine.bound.get((self.type, self.own[1])) is self:
            del self._machine.bound[self.type, self.own[1]]
        self._queue.clear()
        self._wake = None
        transports = [transport for transport, _ in self.backlog or ()]
        if self.transport is not None:
            transports.append(self.transport)
        self.transport = self.backlog = None
        return transports

    def bind(self, address: Address) -> None:
        """Take a port.

        Raises:
            OSError: it is taken, or the address is not this machine's.
        """
        self.process.check_own(address[0])
        port = address[1] or self._machine.free_port(self.type)
        if (self.type, port) in self._machine.bound:
            raise os_error(errno.EADDRINUSE)
        self.own = (address[0], port)
        self._machine.bound[self.type, port] = self

    # --- readiness

    def when_readable(self, wake: Callable[[], object] | None) -> None:
        """Set the function to call while datagrams or connections wait, or None."""
        self._wake = wake
        self._context = contextvars.copy_context()
        self.rouse()

    def rouse(self) -> None:
        if (self._queue or self.backlog) and self._wake is not None and not self._woken:
            self._woken = True
            self.process.loop.call_soon(self._read, context=self._context)

    def _read(self) -> None:
        self._woken = False
        if self._wake is not None:
            self._wake()
        self.rouse()

    # --- streams

    async def connect_stream(self, address: Address) -> None:
        """Connect, for as long as it takes.

        Raises:
            OSError: it was refused, or nobody ever answered.
        """
        network, loop = self._machine.network, self.process.loop
        for pause in _SYN_PAUSES:
            peer = network.machine_at(address[0])
            if peer is not None and network.passes(self._machine, peer):
                await asyncio.sleep(network.path(self._machine, peer).delay(40, loop.time(), network.random))
                connects = self._ask(peer, address)
                if connects is not None and network.passes(peer, self._machine):
                    await asyncio.sleep(network.path(peer, self._machine).delay(40, loop.time(), network.random))
                    if not connects:
                        raise os_error(errno.ECONNREFUSED)
                    return
            await asyncio.sleep(pause)
        raise os_error(errno.ETIMEDOUT)

    def _ask(self, peer: Machine, address: Address) -> bool | None:
        """Ask a peer for a connection, which stays even if the answer gets lost.

        Returns:
            Whether it listens, or None if its queue is full and it does not answer.
        """
        if self.transport is not None:
            return True
        listener = peer.bound.get((real.SOCK_STREAM, address[1]))
        if listener is None or listener.backlog is None or peer.refuses:
            return False
        if len(listener.backlog) > listener.most_waiting:
            return None
        self.own, self.remote = (self._machine.address, self._machine.free_port(self.type)), address
        self.transport, accepted = StreamTransport.pair(self, listener.process, self.own, address)
        listener.backlog.append((accepted, self.own))
        listener.rouse()
        return True

    def listen(self, backlog: int) -> None:
        self.backlog = deque()
        self.most_waiting = backlog

    def accept(self) -> tuple[Socket, Address]:
        """The connection that has waited longest.

        Raises:
            OSError: no connection waits, or no descriptor is left.
        """
        if not self.backlog:
            raise BlockingIOError
        accepted = Socket()
        accepted.transport, address = self.backlog.popleft()
        accepted.own, accepted.remote = (self._machine.address, self.own[1]), address
        return accepted, address

    def attach(self, protocol: asyncio.Protocol) -> StreamTransport:
        """Hand the connection to a protocol; its transport owns the descriptor from here on."""
        transport, self.transport = self.transport, None
        assert transport is not None, "it is not connected"
        self.process.descriptors.pop(self, None)
        self.process.descriptors[transport] = None
        transport.begin(self, protocol)
        return transport

    # --- datagrams

    def connect(self, address: Address) -> None:
        self.remote = address
        self.own = (self._machine.address, self.own[1] or self._machine.free_port(self.type))
        self._machine.bound[self.type, self.own[1]] = self

    def send(self, data: bytes) -> int:
        assert self.remote is not None
        return self._send(data, self.own[0], self.remote)

    def sendmsg(self, buffers: Sequence[bytes], ancdata: Sequence[tuple[int, int, bytes]], _: int, to: Address) -> int:
        """Send a datagram from the address that the control message says (ip(7), IP_PKTINFO)."""
        wanted = (real.inet_ntoa(content[4:8]) for level, kind, content in ancdata if (level, kind) == (0, _IP_PKTINFO))
        return self._send(b"".join(buffers), next(wanted, self._machine.address), to)

    def _send(self, data: bytes, own: str, to: Address) -> int:
        if not self.process.alive:
            return len(data)
        if own != self._machine.address:
            raise os_error(errno.ENETUNREACH)
        network, loop = self._machine.network, self.process.loop
        peer, random = network.machine_at(to[0]), network.random
        if peer is None:
            return len(data)
        path = network.path(self._machine, peer)
        if len(data) + _HEADERS > path.mtu:
            raise os_error(errno.EMSGSIZE)
        sender = (own, self.own[1])
        for _ in range(2 if path.duplicates and random.random() < path.duplicates else 1):
            if not path.loss or random.random() >= path.loss:
                due = loop.time() + path.delay(len(data), loop.time(), random)
                loop.call_at(due, _arrive, self._machine, peer, to[1], data, sender, context=_OF_NOBODY)
        return len(data)

    def arrived(self, data: bytes, sender: Address) -> None:
        if self.remote is not None and sender != self.remote:
            return  # it is connected to somebody else
        if self._queued_bytes + len(data) <= self._machine.receive_buffer:
            self._queue.append((data, sender))
            self._queued_bytes += len(data)
            self.rouse()

    def recvmsg(self, size: int, ancillary: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, Address]:
        """The oldest datagram that waits.

        Raises:
            BlockingIOError: no datagram waits.
        """
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        self._queued_bytes -= len(data)
        return data, [], 0, sender


def _arrive(source: Machine, destination: Machine, port: int, data: bytes, sender: Address) -> None:
    sock = destination.bound.get((real.SOCK_DGRAM, port))
    if sock is not None and destination.network.passes(source, destination):
        sock.arrived(data, sender)


_OF_NOBODY = contextvars.Context()
"""The network's own work is no program's."""


def current_process() -> Process:
    process = PROGRAM.get()
    assert isinstance(process, Process)
    return process


class _HangsForEver(BaseException):
    """Ends the stand-in of a thread that would wait for an answer that never comes."""


class _SocketModule:
    """The socket module, as far as it is simulated."""

    socket = Socket

    def __getattr__(self, name: str) -> Any:
        return getattr(real, name)

    @staticmethod
    def getaddrinfo(host: str, port: int, *, type: int, flags: int = 0) -> list[tuple[Any, ...]]:  # noqa: A002 — the module's
        if flags & real.AI_NUMERICHOST and not is_numeric(host):
            raise real.gaierror(real.EAI_NONAME, "Name or service not known")
        addresses = current_process().network.look_up(host)
        if addresses is None:
            raise _HangsForEver
        return [(real.AF_INET, type, 0, "", (address, port)) for address in addresses]


class _FcntlModule:
    """The fcntl module, for a kernel that stamps no packets."""

    @staticmethod
    def ioctl(sock: Socket, request: int, argument: bytes) -> bytes:
        raise os_error(errno.ENOTTY)


class _ThreadingModule:
    """The threading module, of which a name's look-up needs a thread."""

    class Thread:
        """Runs its target in one go, a moment after it was started."""

        def __init__(self, *, target: Callable[[], None], name: str, daemon: bool) -> None:
            self._target = target

        def start(self) -> None:
            process = current_process()
            process.loop.call_later(process.network.random.uniform(*_LOOK_UP), self._run)

        def _run(self) -> None:
            with contextlib.suppress(_HangsForEver):
                self._target()


@contextlib.contextmanager
def simulated() -> Iterator[None]:
    """Have the engine's transports use simulated sockets, and no threads."""
    with contextlib.ExitStack() as stack:
        stand_ins = {"socket": _SocketModule(), "threading": _ThreadingModule(), "fcntl": _FcntlModule()}
        for name, stand_in in stand_ins.items():
            for module in _transport_modules(name):
                stack.enter_context(mock.patch.dict(vars(module), {name: stand_in}))
        yield


def _transport_modules(name: str) -> list[ModuleType]:
    modules = [module for key, module in tuple(sys.modules.items()) if key.startswith(_TRANSPORTS)]
    return [module for module in modules if vars(module).get(name) is sys.modules[name]]
