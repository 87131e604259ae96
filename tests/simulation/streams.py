"""TCP, as far as a bridge can tell it from the real one."""

from __future__ import annotations

import asyncio
import contextvars
import errno
import socket
from collections import deque
from typing import TYPE_CHECKING, Any, TypeVarTuple

from tests.simulation.machine import os_error

from rsb_bridge.transport.tcp import TCP_RTO_MAX_MS

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.simulation.machine import Process
    from tests.simulation.network import Path
    from tests.simulation.sockets import Address, Socket

Ts = TypeVarTuple("Ts")

_SHORTEST_RETRANSMISSION = 0.2
_USER_TIMEOUT_MS = 924_600
"""How long what is not acknowledged is sent again, where the program does not say (tcp(7), tcp_retries2)."""
_PIECES = 0.02
"""Part of what arrives that arrives in two pieces."""
_RESET = 0.3
"""Part of the processes killed whose kernel resets their connections: bytes had come that nobody had read."""


class _Segment:
    """The bytes that were written in one moment, in flight.

    Attributes:
        pieces: as they were written, or None for the end of the stream.
    """

    __slots__ = ("pieces", "sent", "size")

    def __init__(self, pieces: list[bytes] | None, size: int, sent: float) -> None:
        self.pieces = pieces
        self.size = size
        self.sent = sent


class StreamTransport(asyncio.Transport):
    """One end of a connection: the asyncio transport and the kernel's half under it."""

    peer: StreamTransport

    def __init__(self, process: Process, local: Address, remote: Address) -> None:
        super().__init__()
        self.process = process
        self.sock: Socket
        self.local, self._remote = local, remote
        self._loop = process.loop
        self._buffer = process.machine.stream_buffer
        self._random = process.network.random
        self._protocol: asyncio.Protocol | None = None
        self._context = contextvars.copy_context()
        self.path: Path
        self._on_its_way: deque[_Segment] = deque()
        self._unacknowledged = 0
        self._arrives = 0.0
        self._stuck = False
        self._timeout: asyncio.TimerHandle | None = None
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._high = 65_536
        self._paused = False
        self._reading = True
        self._closing = False
        self.forgotten = False  # by a NAT, which drops all that arrives on it
        self.gone = False  # the program has let it go, or has lost it
        self._sent_end = False
        self._begun = False
        self._early: deque[bytes | None] = deque()

    @classmethod
    def pair(cls, near: Socket, far: Process, own: Address, remote: Address) -> tuple[StreamTransport, StreamTransport]:
        """Both ends of a new connection, a socket's and a listening process's; neither has a protocol yet."""
        one, other = cls(near.process, own, remote), cls(far, remote, own)
        one.sock = other.sock = near  # for its options, until the other end is accepted
        one.peer, other.peer = other, one
        one.path, other.path = far.network.both_ways(near.process.machine, far.machine)
        return one, other

    def begin(self, sock: Socket, protocol: asyncio.Protocol) -> None:
        self.sock = sock
        self._context = contextvars.copy_context()
        self._protocol = protocol
        self._loop.call_soon(self._begin, context=self._context)

    def _begin(self) -> None:
        assert self._protocol is not None
        self._protocol.connection_made(self)
        self._begun = True
        self._catch_up()

    def _catch_up(self) -> None:
        """Deliver bytes that arrived before a protocol was attached."""
        while self._early and self._reading and not self.gone:
            data = self._early.popleft()
            self.peer.acknowledged(len(data) if data else 0)
            self._take(data)

    # --- what asyncio's transports do

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return {"socket": self.sock, "sockname": self.local, "peername": self._remote}.get(name, default)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self._closing or self.gone or not data:
            return
        if self._waiting or self._unacknowledged >= self._buffer:
            self._waiting.append(bytes(data))
            self._waiting_bytes += len(data)
            if self._waiting_bytes > self._high and not self._paused:
                self._paused = True
                assert self._protocol is not None
                self._protocol.pause_writing()
        else:
            self._send(bytes(data))

    def get_write_buffer_size(self) -> int:
        return self._waiting_bytes

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = 65_536 if high is None else high

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        assert isinstance(protocol, asyncio.Protocol)
        self._protocol = protocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        assert self._protocol is not None
        return self._protocol

    def pause_reading(self) -> None:
        self._reading = False

    def resume_reading(self) -> None:
        if not self._reading:
            self._reading = True
            self._loop.call_soon(self._catch_up, context=self._context)

    def write_eof(self) -> None:
        if not self._closing:
            self._send_end()

    def is_closing(self) -> bool:
        return self._closing

    def close(self) -> None:
        if not self._closing:
            self._closing = True
            if not self._waiting:
                self._close_descriptor(None)

    def abort(self) -> None:
        self._waiting.clear()
        self._waiting_bytes = 0
        if not self._closing or not self.gone:
            self._closing = True
            self._close_descriptor(None)

    # --- the kernel: sending

    def _send(self, data: bytes) -> None:
        now = self._loop.time()
        size = len(data)
        self._unacknowledged += size
        last = self._on_its_way[-1] if self._on_its_way else None
        # On a narrow path each write takes its time, also several of one moment.
        if last is not None and last.sent == now and last.pieces is not None and self.path.bandwidth is None:
            last.pieces.append(data)
            last.size += size
        else:
            self._put_on_its_way(_Segment([data], size, now))

    def _put_on_its_way(self, segment: _Segment) -> None:
        self._on_its_way.append(segment)
        now, random = self._loop.time(), self._random
        delay = self.path.delay(segment.size, now, random)
        if self.path.loss and random.random() < self.path.loss:
            delay += _SHORTEST_RETRANSMISSION
        self._arrives = max(self._arrives, now + delay)
        self._loop.call_at(self._arrives, self._arrive, segment, context=_OF_NOBODY)

    def _arrive(self, segment: _Segment) -> None:
        """A segment is due at the peer, and with it those before it."""
        way = self._on_its_way
        if self._stuck or not way or segment.sent < way[0].sent:
            return
        if not self.passes():
            self._stuck = True
            self.path.on_healed(self._healed)
            timeout = self.sock.options.get((socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT), _USER_TIMEOUT_MS) / 1000
            self._timeout = self._loop.call_at(way[0].sent + timeout, self._time_out, context=_OF_NOBODY)
            return
        while way and way[0].sent <= segment.sent:
            self._deliver(way.popleft())

    def passes(self) -> bool:
        ends = (self, self.peer)
        return self.path.cut_at is None and all(
            not end.forgotten and end.process.machine.up and end.process.machine.address == end.local[0] for end in ends
        )

    def _healed(self) -> None:
        """The path takes packets again: the next retransmission gets through."""
        if self._stuck and self._on_its_way:
            waited = max(_SHORTEST_RETRANSMISSION, self._loop.time() - self._on_its_way[0].sent)
            longest = self.sock.options.get((socket.IPPROTO_TCP, TCP_RTO_MAX_MS), 120_000) / 1000
            self._loop.call_later(self._random.uniform(0.0, min(waited, longest)), self._retransmit, context=_OF_NOBODY)

    def _retransmit(self) -> None:
        if self._stuck and self._on_its_way:
            self._unstick()
            self._arrive(self._on_its_way[-1])

    def _unstick(self) -> None:
        self._stuck = False
        self.path.forget(self._healed)
        if self._timeout is not None:
            self._timeout.cancel()
            self._timeout = None

    def _time_out(self) -> None:
        if self._stuck:
            self._lose(os_error(errno.ETIMEDOUT))

    def _deliver(self, segment: _Segment) -> None:
        peer = self.peer
        if peer.gone:
            if segment.pieces is not None:
                self.refused()
        elif segment.pieces is None:
            peer.hand(None)
        else:
            data = segment.pieces[0] if len(segment.pieces) == 1 else b"".join(segment.pieces)
            if len(data) > 1 and self._random.random() < _PIECES:
                cut = self._random.randrange(1, len(data))
                peer.hand(data[:cut])
                data = data[cut:]
            peer.hand(data)

    def acknowledged(self, size: int) -> None:
        """The other program has taken bytes: there is room again for as many."""
        self._unacknowledged -= size
        while self._waiting and self._unacknowledged < self._buffer:
            data = self._waiting.popleft()
            self._waiting_bytes -= len(data)
            self._send(data)
        if self._waiting or self.gone:
            return
        if self._closing:
            self._close_descriptor(None)
        elif self._paused:
            self._paused = False
            assert self._protocol is not None
            self._run(self._protocol.resume_writing)

    def refused(self) -> None:
        """The other kernel resets the connection, which it does not know."""
        back = self._loop.time() + self.peer.path.delay(40, self._loop.time(), self._random)

        def reset() -> None:
            if self.peer.passes():
                self._lose(os_error(errno.ECONNRESET))

        self._loop.call_at(back, reset, context=_OF_NOBODY)

    # --- the kernel: receiving

    def hand(self, data: bytes | None) -> None:
        """Give the program bytes that arrived, or None for the end."""
        if self.gone or self._closing:
            if data is not None and self.gone:
                self.peer.refused()
        elif not self._begun or not self._reading or self._early:
            self._early.append(data)
        else:
            self.peer.acknowledged(len(data) if data else 0)
            self._run(self._take, data)

    def _run(self, work: Callable[[*Ts], object], *args: *Ts) -> None:
        """Have the program do something, now, or once it runs again."""
        if self._loop.is_frozen(self.process):
            self._loop.call_soon(work, *args, context=self._context)
        else:
            self._context.run(work, *args)

    def _take(self, data: bytes | None) -> None:
        if self._closing or self._protocol is None:
            return
        if data is not None:
            self._protocol.data_received(data)
        elif not self._protocol.eof_received():
            self.close()

    # --- how it ends

    def reset(self) -> None:
        """Reset both ends, as a firewall between them does; bytes in transit are lost."""
        self.refused()
        self.peer.refused()

    def forget(self, *, told: bool) -> None:
        """Let nothing through any more, as a NAT that has forgotten the connection; `told`: this end gets a reset."""
        self.forgotten = self.peer.forgotten = True
        if told:
            self._lose(os_error(errno.ECONNRESET))

    def _close_descriptor(self, error: OSError | None) -> None:
        """The program lets go of it: what is in the kernel's buffer still goes out, and then the end.

        If the program has not read all that came, the kernel resets the connection instead, and nothing goes out.
        """
        if self.gone:
            return
        self.gone = True
        self._free()
        if any(self._early):
            self._on_its_way.clear()
            self._unstick()
            self._sent_end = True
            self.peer.refused()
        self._send_end()
        if self._protocol is not None:
            self._loop.call_soon(self._protocol.connection_lost, error, context=self._context)

    def _send_end(self) -> None:
        if not self._sent_end:
            self._sent_end = True
            self._put_on_its_way(_Segment(None, 0, self._loop.time()))

    def _lose(self, error: OSError) -> None:
        """End the connection without regard to the program."""
        self._on_its_way.clear()
        self._unstick()
        self._waiting.clear()
        self._waiting_bytes = 0
        self._sent_end = True
        if not self.gone:
            self._closing = True
            self._close_descriptor(error)

    def killed(self) -> None:
        if self.gone:
            return
        self.gone = self._closing = True
        self._free()
        last = self._on_its_way[-1] if self._on_its_way else None
        if last is not None and last.pieces is not None:
            data = b"".join(last.pieces)
            last.pieces = [data[: self._random.randrange(len(data) + 1)]]
        if self._random.random() < _RESET:
            self.peer.refused()
        else:
            self._sent_end = True
            self._put_on_its_way(_Segment(None, 0, self._loop.time()))

    def vanished(self) -> None:
        """The machine lost its power: the connection is gone, silently."""
        self.gone = self._closing = True
        self._free()
        self._on_its_way.clear()
        self._unstick()

    def _free(self) -> None:
        self.process.descriptors.pop(self, None)


_OF_NOBODY = contextvars.Context()
"""The network's own work is no program's."""
