"""Two sides of a link with data streams between them, over sockets or over a simulated radio."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from tests.support.connection_keys import connection_keys

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.data_stream import StreamPair, stream_channel, take_receipts
from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.udp_channel import PathProbe
from rsb_bridge.channel.window import ReceiptBook, Window
from rsb_bridge.model.fates import RELIABLE
from rsb_bridge.model.session import weight_of
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Container, Coroutine, Iterable

    import pytest

    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.messages import Receipts
    from rsb_bridge.wire.sealing import Role

_EXPORT = bytes(range(32))


class Route:
    """A route as its channel sees it (`RouteSink`), with a queue of payloads.

    Attributes:
        waiting: payloads to be sent.
        arrived: payloads that came, each with the time in seconds.
        lost: the reasons why its channel was lost.
        always: bytes of a message that it sends again and again, or 0.
        fates: the effect of each loss on it.
    """

    def __init__(self, number: int, rank: int = 0, always: int = 0, *, outgoing: bool, duplex: bool = False) -> None:
        self.id, self.rank, self.weight, self.always = number, rank, weight_of(rank), always
        self.outgoing, self.duplex = outgoing, duplex
        self.fates = RELIABLE
        self.waiting: deque[bytes] = deque()
        self.arrived: list[tuple[bytes, float]] = []
        self.lost: list[str] = []
        self.channel: Any = None

    def send(self, *payloads: bytes) -> None:
        self.waiting += payloads
        self.flush()

    def flush(self) -> None:
        while (self.waiting or self.always) and not self.channel.congested:
            payload = self.waiting.popleft() if self.waiting else bytes(self.always)
            self.channel.send([(payload, 0, 0)])
        if self.waiting or self.always:
            self.channel.ask()

    def deliver(self, messages: Iterable[Message]) -> None:
        now = asyncio.get_running_loop().time()
        self.arrived += [(payload, now) for payload, _, _ in messages]

    def channel_lost(self, reason: Reason) -> None:
        assert reason.broke
        self.lost.append(reason.text)
        self.channel.close(reason.text)

    @property
    def payloads(self) -> list[bytes]:
        return [payload for payload, _ in self.arrived]

    def bytes_since(self, start: float) -> int:
        return sum(len(payload) for payload, when in self.arrived if when > start)


class Side:
    """One end of a link.

    Attributes:
        receipts: messages with receipts that this side has sent.
        outlive: s for which lost streams may be opened again.
        ahead: s by which the clock of its streams is ahead of the loop's.
        deaf: whether it loses the other side's receipts.
        closed: ids of routes that were open.
        reopened: how often this side's routes have asked for new streams.
    """

    def __init__(self, role: Role) -> None:
        self.other: Side
        self.receipts: list[Receipts] = []
        self.deaf = False
        self.closed: set[int] = set()
        self.routes: dict[int, Route] = {}
        self.keys = DataKeys(connection_keys(CipherSuite.AESGCM, _EXPORT), role, Budget(64 << 20))
        self.probe = PathProbe(self.keys)
        self.now = asyncio.get_running_loop().time
        self.ahead = 0.0
        self.book = ReceiptBook(asyncio.get_running_loop(), self)
        self.book.now = lambda: asyncio.get_running_loop().time() + self.ahead
        self.scheduler = Scheduler(self.book, Window())
        self.reopened = 0
        self.outlive = 60.0
        self.ids = self
        self.pair = StreamPair(self, Tcp(), 0)

    def open_streams(self, transport: StreamTransport, port: int) -> None:
        self.reopened += 1

    def ping(self) -> float:
        return 0.0

    def way_back(self) -> float:
        return 0.0

    def udp_ready(self) -> None:
        """No route waits for that."""

    def take_urgent(self, content: bytes) -> None:
        """Nothing is urgent here."""

    def awaits_channel(self, route_id: int) -> bool:
        return route_id in self.routes and self.routes[route_id].channel is None

    def is_closed_id(self, route_id: int) -> bool:
        return route_id in self.closed

    def carry(self, *numbers: int) -> None:
        for number in numbers:
            self.routes[number].channel = stream_channel(self.pair, self.routes[number])
        self.pair.take_held()

    def in_transit(self) -> int:
        return self.scheduler.sent - self.scheduler.acknowledged

    def send_receipts(self, message: Receipts) -> None:
        self.receipts.append(message)
        if not self.other.deaf:
            asyncio.get_running_loop().call_soon(self.other.take_receipts, message)

    def take_receipts(self, message: Receipts) -> None:
        take_receipts(message, self.pair.streams(), self.scheduler)

    async def acknowledges_all(self) -> None:
        """Wait until all that the other side has sent is here, and it knows that."""
        await self.ticks_until(lambda: not self.other.in_transit())

    async def ticks_until(self, condition: Callable[[], object]) -> None:
        """Wait as on a link, where a side ticks: it acknowledges what is less than a window."""
        async with asyncio.timeout(60):
            while not condition():
                self.tick()
                await asyncio.sleep(0.005)

    async def holds(self, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
        """Wait until its stream of that name holds frames, which wait for something: then it is not read."""
        held, stream = asyncio.Event(), getattr(self.pair, name).stream
        pause = stream.pause_reading
        with monkeypatch.context() as patched:
            patched.setattr(stream, "pause_reading", lambda: held.set() or pause())  # type: ignore[func-returns-value]
            await self.ticks_until(held.is_set)

    def tick(self) -> None:
        self.scheduler.tick()
        self.book.report()
        self.pair.tick()


def routes_of(outgoing: Route) -> Route:
    route = Route(outgoing.id, outgoing.rank, outgoing=False, duplex=outgoing.duplex)
    route.fates = outgoing.fates
    return route


@asynccontextmanager
async def connected(
    *routes: Route,
    two: bool = True,
    open_streams: Callable[..., Coroutine[Any, Any, tuple[Stream, Stream]]] | None = None,
    elsewhere: Container[int] = (),
) -> AsyncIterator[tuple[Side, Side]]:
    """Connect two sides by two streams, or by one for small and large messages; the routes send from the first side.

    Args:
        elsewhere: ids of routes that get no stream.
    """
    near, far = Side("client"), Side("server")
    near.other, far.other = far, near
    opening = open_streams or by_sockets
    for number in (1, 2) if two else (1,):
        ends = await opening()
        for side, stream in zip((near, far), ends, strict=True):
            stream.handler = side.pair.add(stream, number, small=number == 1, large=number == 2 or not two)
    near.routes = {route.id: route for route in routes}
    far.routes = {route.id: routes_of(route) for route in routes}
    for side in (far, near):
        side.carry(*(number for number in side.routes if number not in elsewhere))
    try:
        yield near, far
    finally:
        for side in (near, far):
            if not side.pair.over:
                side.pair.end("the test is over")
            side.book.close()
            side.scheduler.close()


async def by_sockets() -> tuple[Stream, Stream]:
    loop = asyncio.get_running_loop()
    ends = []
    for sock in socket.socketpair():
        sock.setblocking(False)
        _, stream = await loop.create_connection(partial(Stream, StreamHandler()), sock=sock)
        ends.append(stream)
    return ends[0], ends[1]


class Radio:
    """A simulated link of so many bytes/s each way, which all its streams share in the order of their bytes.

    Args:
        rate: bytes/s.
        kernel: bytes of each stream that wait in the kernel, unsent.
        tunnel: bytes that wait on the way, already sent.
        delay: s each way.
    """

    def __init__(self, rate: float, kernel: int = 4096, tunnel: int = 0, delay: float = 0.0) -> None:
        self.rate, self.kernel, self.tunnel, self.delay = rate, kernel, tunnel, delay
        self.ways = {number: _Way(self) for number in (0, 1)}

    async def open(self) -> tuple[Stream, Stream]:
        streams = Stream(StreamHandler()), Stream(StreamHandler())
        for number, stream in enumerate(streams):
            _RadioTransport(stream, streams[1 - number], self.ways[number])
        return streams


class _Way:
    def __init__(self, radio: Radio) -> None:
        self.radio = radio
        self.free_at = 0.0
        self.queue: deque[_RadioTransport] = deque()

    def carry(self, transport: _RadioTransport) -> None:
        """Carry the next bytes of a stream, as soon as those before it are carried."""
        loop, radio = asyncio.get_running_loop(), self.radio
        backlog = max(0.0, self.free_at - loop.time()) * radio.rate
        size = min(1400, transport.waiting)
        if backlog > radio.tunnel + 1400:
            loop.call_later((backlog - radio.tunnel) / radio.rate, self.carry, transport)
            return
        data = transport.take(size)
        self.free_at = max(self.free_at, loop.time()) + size / radio.rate
        loop.call_later(self.free_at + radio.delay - loop.time(), transport.arrive, data)
        if transport.waiting:
            loop.call_later(size / radio.rate if not radio.tunnel else 0.0, self.carry, transport)
        else:
            transport.carrying = False


class _RadioTransport(asyncio.Transport):
    def __init__(self, protocol: Stream, peer: Stream, way: _Way) -> None:
        super().__init__()
        self._protocol, self._peer, self._way = protocol, peer, way
        self._buffer = bytearray()
        self._paused = self._closing = self.carrying = False
        protocol.connection_made(self)

    @property
    def waiting(self) -> int:
        return len(self._buffer)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def is_closing(self) -> bool:
        return self._closing

    def abort(self) -> None:
        if not self._closing:
            self._closing = True
            loop = asyncio.get_running_loop()
            loop.call_soon(self._protocol.connection_lost, None)
            loop.call_soon(self._peer.abort, "closed by the other side")

    def pause_reading(self) -> None:
        raise AssertionError("no test on a radio holds frames")

    def write(self, data: bytes | bytearray | memoryview[int]) -> None:
        self._buffer += data
        if not self._paused and len(self._buffer) > self._way.radio.kernel:
            self._paused = True
            self._protocol.pause_writing()
        if not self.carrying:
            self.carrying = True
            self._way.carry(self)

    def take(self, size: int) -> bytes:
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        if self._paused and len(self._buffer) <= self._way.radio.kernel // 2:
            self._paused = False
            asyncio.get_running_loop().call_soon(self._protocol.resume_writing)
        return data

    def arrive(self, data: bytes) -> None:
        if not self._closing:
            self._peer.data_received(data)


async def pass_seconds(seconds: int, *sides: Side) -> None:
    """Let simulated time pass, with the sides' regular work once a second."""
    for _ in range(seconds):
        await asyncio.sleep(1.0)
        for side in sides:
            side.tick()
