"""A connected stream of any transport, on the I/O loop."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from rsb_bridge.model.reason import NO_REASON, EndCode, Reason
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.descriptors import MORE_DESCRIPTORS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.transport.multipath import Subflow

Address: TypeAlias = tuple[Any, ...]
"""As the socket module has it: host and port (TCP and UDP over IPv6: with flow and scope behind them)."""

CLOSED_BY_PEER = Reason("closed by the other side", EndCode.LEFT)
"""The reason where a stream ended in order, which also happens when the other process is killed."""

_STRANGER_READS = 4096  # bytes that are read at a time from a stranger, so that few wait here during a handshake
# Bytes that are read at a time from a peer that has proven its key: as much as asyncio does. Smaller reads gained
# nothing (bench/README.md, *Where the time goes*).
_READS = 256 * 1024
_HELD = 64 * 1024  # bytes that are held at the most: the kernel hands no more to a network card at a time (GSO)
_LINGER = 2.0  # s, of the protocol (PROTOCOL.md, 1)
_IN_VAIN = 4  # times, which take 2.4 s at least: by then a path that loses every third packet counts as lossy


class PacketCounts(NamedTuple):
    """Packets of a stream with data, as the kernel counts them.

    Attributes:
        sent: packets sent, repetitions included.
        lost: packets that were sent again and had not arrived before.
        acknowledged: bytes that the other end has acknowledged.
        waiting: bytes that were sent and are not acknowledged.
        tries: how often in a row the oldest bytes were sent again.
    """

    sent: int
    lost: int
    acknowledged: int
    waiting: int
    tries: int


class StreamProblem(Wording):
    """The reasons why a stream ended or was not opened, in addition to the kernel's texts."""

    CLOSED_HERE = "closed here"
    TIMED_OUT = "timed out"
    REFUSED = "{error}: is the server running there?"
    RESET = "{error}: the program at the other end died, or the network between ended the connection"
    UNREACHABLE = "{error}: check this machine's network (ip addr, ip route) and the address"
    NO_DESCRIPTORS = "{error}: this process needs more file descriptors: {remedy}"


_CLOSED_HERE = StreamProblem.CLOSED_HERE()


class StreamHandler:
    """Receives what happens on a stream, on the I/O loop. The base class ignores everything."""

    def connected(self, stream: Stream) -> None:
        """Take the stream, which is connected; called once, on its first handler."""

    def received(self, data: bytes) -> None:
        """Take received bytes."""

    def writable(self) -> None:
        """Continue to write: the stream takes more again."""

    def closed(self, reason: Reason) -> None:
        """Take the end of the stream, for any reason; called once."""


class OpenNetworkTransport(asyncio.Transport):
    """An asyncio transport over a network in which any member may send in the name of another.

    Both ends find out by their handshake who is there, and mark from then on what they send. The methods are those of
    `Stream`. During a trial, the protocol is given each answer as if no other had come.

    Attributes:
        network: the network's name, for operators.
        when_doubted: called as soon as it is doubted that the other end is there.
    """

    network: ClassVar[str]
    when_doubted: Callable[[], None]

    def trust(self) -> None:
        raise NotImplementedError

    def begin_trial(self) -> None:
        raise NotImplementedError

    def adopt(self) -> None:
        raise NotImplementedError

    def authenticate(self, secret: bytes, *, opener: bool) -> None:
        raise NotImplementedError


class JoinedWrites:
    """Holds writes of one moment, so that each stream sends them by one call. The other side is woken once, too.

    Attributes:
        is_open: whether streams hand over what they are to write, until `send_all`. Only during a call of the I/O loop.
    """

    def __init__(self) -> None:
        self.is_open = False
        self._held: dict[Stream, bytearray] = {}
        self._gathering: list[Callable[[], None]] = []

    def gather(self, write: Callable[[], None]) -> None:
        """Have somebody who gathers what a stream is to send `write` it, before anything else is written."""
        self._gathering.append(write)

    def hold(self, stream: Stream, data: bytes | memoryview) -> None:
        """Hold what is written to a stream."""
        if self._gathering:
            self._write_gathered()
        held = self._held.get(stream)
        if held is None:
            held = self._held[stream] = bytearray()
        held += data
        if len(held) >= _HELD:
            self.send(stream)

    def send(self, stream: Stream) -> None:
        """Send what is held of a stream."""
        self._write_gathered()
        held = self._held.pop(stream, None)
        if held is not None:
            stream.send_held(held)

    def send_all(self) -> None:
        """Send all that is held, and behind it what is gathered; what is written from then on leaves at once."""
        while self._held:  # while it is open: what is written meanwhile goes behind what is held
            stream, held = self._held.popitem()
            stream.send_held(held)
        self.is_open = False
        self._write_gathered()

    def _write_gathered(self) -> None:
        gathering, self._gathering = self._gathering, []
        for write in gathering:
            write()


class Stream(asyncio.Protocol):
    """An asyncio protocol that counts bytes, knows both addresses, and has a handler that may be replaced.

    Connect it as any asyncio protocol: to an `asyncio.Transport` that offers ``peername`` and ``sockname`` as extra
    information, keeps to `set_write_buffer_limits`, and calls `pause_writing` and `resume_writing`.

    Attributes:
        high_water: bytes that may wait for the kernel before the stream counts as congested.
        congested: whether more than `high_water` bytes wait for the kernel, so that writers should pause.
        received_at: time (s, on the loop's clock) of the last bytes, or of the connection.
        sent_bytes: so far, including bytes that still wait.
        when_gone: called when its descriptor is free again, which may be a while after `close`, or None.
        joined: holds what is written while several topics' messages are on their way to it, or None.
        address: of the other end.
        own_address: host or adapter of this end, or empty if unknown.
    """

    high_water: ClassVar[int] = 0
    """Not a byte waits here by choice: in the routes' queues, newer messages replace older ones."""

    def __init__(self, handler: StreamHandler) -> None:
        self.handler = handler
        self.congested = False
        self.received_at = 0.0
        self.received_bytes = self.sent_bytes = 0
        self.address: Address = ("?", 0)
        self.own_address = ""
        self.when_gone: Callable[[], None] | None = None
        self.joined: JoinedWrites | None = None
        self._transport: asyncio.Transport | None = None
        self._now: Callable[[], float] = float  # until it is connected
        self._reason = NO_REASON
        self._closing = False
        self._resuming: asyncio.Handle | None = None
        self._lingering: asyncio.TimerHandle | None = None

    # --- what its user asks of it

    def write(self, data: bytes | memoryview) -> None:
        """Send, or keep until the socket takes it. Nothing happens on a stream that is over.

        `data` may be used again once this has returned, unless the stream is congested then.
        """
        if self._transport is not None and not self._closing and not self._transport.is_closing():
            self.sent_bytes += len(data)
            if self.joined is not None and self.joined.is_open:
                self.joined.hold(self, data)
            else:
                self._transport.write(data)

    def send_held(self, data: bytearray) -> None:
        """Send what `joined` has held."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def close(self, reason: str = _CLOSED_HERE) -> None:
        """Send what waits, then close; a peer that takes nothing is not waited for longer than 2 s."""
        if self._transport is None or self._closing:
            return
        if self.joined is not None:
            self.joined.send(self)
        # While reading is paused, the peer's end would not show. Not later: a stream that closes is not resumed.
        self.resume_reading()
        self._closing = True
        self._reason = self._reason or Reason(reason)
        # A peer that takes nothing would hold the descriptor. Not the transport's own abort: on one that has ended, it
        # would end it a second time.
        self._lingering = asyncio.get_running_loop().call_later(_LINGER, self.abort, reason)
        self._end(self._transport)

    def _end(self, transport: asyncio.Transport) -> None:
        """Close the transport, which sends what waits; called by `close`, once."""
        transport.close()

    def abort(self, reason: str) -> None:
        """Close now; what waits is lost."""
        if self._transport is not None:
            self._reason = self._reason or Reason(reason)
            self._transport.abort()

    @property
    def over(self) -> bool:
        """Whether it is closed or closing."""
        return self._transport is None or self._closing or self._transport.is_closing()

    @property
    def gone(self) -> bool:
        """Whether it is closed, and all that was written has left or is lost."""
        return self._transport is None

    def pause_reading(self) -> None:
        """Leave what the peer sends in the kernel, until `resume_reading`."""
        if self._transport is not None and not self.over:
            self._transport.pause_reading()

    def resume_reading(self) -> None:
        """Take in again what the peer sends."""
        if self._transport is not None and not self.over:
            self._transport.resume_reading()

    @property
    def peer(self) -> str:
        """The other end's address, as an operator reads it."""
        return format_address(self.address)

    @property
    def host(self) -> str:
        """The other end's host or adapter in numbers, without port or channel; a link-local one has its interface."""
        host = str(self.address[0])
        scope = self.address[3] if len(self.address) == 4 else 0
        return f"{host}%{scope}" if scope and "%" not in host else host

    # --- what only some transports do

    def trust(self) -> None:
        """Read as much as comes: the other end has proven that it has the key. Until then, little is read at a time."""
        _read_at_a_time(self._transport, _READS)

    def begin_trial(self) -> None:
        """Take several answers to this side's first bytes, until `adopt`, where others than the peer may answer."""

    def adopt(self) -> None:
        """Accept the answer that the handler has just been given, and end the trial."""

    def authenticate(self, secret: bytes | None, *, opener: bool) -> None:
        """Take only what the peer proves to have sent, where others could send, too.

        Args:
            secret: of both sides (`rsb_bridge.wire.sealing`), or None if the peer proves nothing.
            opener: this side opened the stream.
        """

    def give_up_after(self, seconds: float) -> None:
        """Have the kernel give it up once nothing is acknowledged for so long; only TCP does. May be called again."""

    def round_trip_is(self, seconds: float) -> None:
        """Have the kernel wait for acknowledgements longer than so long; only TCP does. May be called again."""

    def packets(self) -> PacketCounts | None:
        """Return the kernel's counts of packets, or None if it has none; only TCP's are known."""
        return None

    def subflows(self) -> Sequence[Subflow]:
        """Return its subflows, if there can be several; only Multipath TCP's are known."""
        return ()

    @property
    def stuck(self) -> bool:
        """Whether the kernel has sent the same bytes again and again, and no answer came; only TCP can tell."""
        counts = self.packets()
        return counts is not None and counts.tries >= _IN_VAIN

    # --- what its transport calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._now = asyncio.get_running_loop().time
        self.received_at = self._now()
        transport.set_write_buffer_limits(high=self.high_water)
        self.address = transport.get_extra_info("peername") or self.address
        self.own_address = str((transport.get_extra_info("sockname") or [""])[0])  # a socketpair has no name
        _read_at_a_time(transport, _STRANGER_READS)
        self.handler.connected(self)

    def data_received(self, data: bytes) -> None:
        self.received_at = self._now()
        self.received_bytes += len(data)
        self.handler.received(data)

    def pause_writing(self) -> None:
        self.congested = True
        if self._resuming is not None:
            self._resuming.cancel()

    def resume_writing(self) -> None:
        # Not within asyncio's own write: a stream that ends there, or to which a write fails, would be ended twice.
        self._resuming = asyncio.get_running_loop().call_soon(self._go_on)

    def _go_on(self) -> None:
        if self._transport is not None:
            self.congested = False
            self.handler.writable()

    def eof_received(self) -> None:
        self._reason = self._reason or CLOSED_BY_PEER

    def connection_lost(self, error: Exception | None) -> None:
        if self._lingering is not None:
            self._lingering.cancel()
        if self._transport is not None:
            break_cycles(self._transport)
        self._transport = None
        if self.when_gone is not None:
            self.when_gone()
        # Nothing comes after this event, and nothing leads back to the link, which would be freed late.
        handler, self.handler = self.handler, StreamHandler()
        handler.closed(self._reason or (broken(error) if error else Reason("closed", EndCode.BROKE)))


def break_cycles(transport: asyncio.BaseTransport) -> None:
    """Have a transport of asyncio whose connection is lost be freed with its last reference."""
    # Methods of its own, bound, and so cycles that only the collector would free. Python 3.12 has the second one, and
    # breaks both if it closes the transport, but not if it aborts it or the other end resets it.
    for name in ("_read_ready_cb", "_write_ready"):
        if name in vars(transport):
            setattr(transport, name, None)


def _read_at_a_time(transport: asyncio.BaseTransport | None, size: int) -> None:
    """Limit what asyncio reads from a socket in one call. Transports of other kinds have limits of their own."""
    if transport is not None and hasattr(transport, "max_size"):
        transport.max_size = size


def format_address(address: Address) -> str:
    """Return a socket address as ``host:port``, ``[host]:port`` for IPv6."""
    host, port = address[0], address[1]
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"


def broken(error: BaseException) -> Reason:
    """Return the reason of a connection that an OS error has ended."""
    gave_up = isinstance(error, OSError) and error.errno == errno.ETIMEDOUT
    return Reason(os_error_message(error), EndCode.TIMED_OUT if gave_up else EndCode.BROKE)


def os_error_message(error: BaseException) -> str:
    """Return the kernel's message for an OS error, without its number, and with a remedy where there is one."""
    if isinstance(error, TimeoutError) and not error.args:
        return StreamProblem.TIMED_OUT()
    # The number of a `gaierror` is the resolver's.
    if isinstance(error, OSError) and error.errno and not isinstance(error, socket.gaierror):
        message = os.strerror(error.errno)  # asyncio puts its own text into strerror
        if error.errno == errno.ECONNREFUSED:
            return StreamProblem.REFUSED(error=message)
        if error.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH):
            return StreamProblem.UNREACHABLE(error=message)
        if error.errno == errno.EMFILE:
            return StreamProblem.NO_DESCRIPTORS(error=message, remedy=MORE_DESCRIPTORS)
        if error.errno in (errno.EPIPE, errno.ECONNRESET, errno.ECONNABORTED):
            return StreamProblem.RESET(error=message)
        return message
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
