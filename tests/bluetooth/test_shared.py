"""Routes that share one slow stream. The stream is a real one, over a local socket that is read at the radio's pace."""

from __future__ import annotations

import asyncio
import socket
import time
from collections import deque
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from rsb_bridge.channel.multiplexer import CHUNK, MultiplexedReceiver, MultiplexedSender, Multiplexer
from rsb_bridge.transport.rfcomm import RfcommStream
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import HEADER, LENGTH, DataReader, DataWriter, FrameReader
from rsb_bridge.wire.sealing import Sealer, StreamOpener, Suite

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterable

    from rsb_bridge.wire.framing import Message

_PACE = 50_000  # bytes/s: the thesis's
_STEP = 0.01
_KEY = bytes(range(32))


class Topic:
    """What a channel needs of a route (`RouteSink`): here a queue that never runs dry, or single messages.

    Attributes:
        id: the route's.
        arrived: what came out on the other side: payload's size and time (s, monotonic).
        something: did.
    """

    def __init__(self, number: int, always: int = 0) -> None:
        self.id = number
        self.outgoing = True
        self.arrived: deque[tuple[int, float]] = deque()
        self.path: MultiplexedSender | None = None
        self.something = asyncio.Event()
        self._always = always

    def flush(self) -> None:
        if self._always and self.path is not None and not self.path.congested:
            self.path.send([(bytes(self._always), time.time_ns(), 0)])

    def channel_lost(self, reason: str) -> None:
        raise AssertionError(reason)

    def deliver(self, messages: Iterable[Message]) -> None:
        self.arrived += [(len(payload), time.monotonic()) for payload, _, _ in messages]
        self.something.set()

    def bytes_since(self, start: float) -> int:
        return sum(size for size, when in self.arrived if when > start)


class _Pumping(StreamHandler):
    """Does what the control connection does."""

    def __init__(self) -> None:
        self.shared: Multiplexer | None = None

    def connected(self, stream: Stream) -> None:
        self.shared = Multiplexer(stream)

    def writable(self) -> None:
        assert self.shared is not None
        self.shared.pump()


@asynccontextmanager
async def slow_link(*topics: Topic) -> AsyncIterator[None]:
    """All topics on one stream; what arrives is opened and delivered at `_PACE`."""
    loop = asyncio.get_running_loop()
    near, far = socket.socketpair()
    handler = _Pumping()
    _, stream = await loop.create_connection(lambda: RfcommStream(handler), sock=near)
    assert handler.shared is not None
    ends = {}
    for topic in topics:
        writer = DataWriter(Sealer(Suite.CHACHAPOLY, _KEY), topic.id)
        topic.path = MultiplexedSender(handler.shared, topic, writer)
        reader = DataReader(StreamOpener(Suite.CHACHAPOLY, _KEY), topic.id)
        ends[topic.id] = MultiplexedReceiver(handler.shared, topic, reader)
    reading = asyncio.create_task(_read_slowly(far, ends))
    try:
        yield
    finally:
        reading.cancel()
        stream.abort("over")
        await asyncio.gather(reading, return_exceptions=True)
        far.close()


async def _read_slowly(far: socket.socket, ends: dict[int, MultiplexedReceiver]) -> None:
    loop = asyncio.get_running_loop()
    far.setblocking(False)
    far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    frames = FrameReader(1 << 20)
    due = loop.time()
    while True:
        data = await loop.sock_recv(far, int(_PACE * _STEP))
        due = max(due, loop.time()) + len(data) / _PACE
        await asyncio.sleep(due - loop.time())
        for frame in frames.feed(data):
            ends[HEADER.unpack(frame[: HEADER.size])[2]].received(frame)


def test_a_joystick_goes_before_maps() -> None:
    joystick, maps = Topic(1), [Topic(2, always=100_000), Topic(3, always=100_000)]

    async def main() -> list[float]:
        late = []
        async with slow_link(joystick, *maps):
            for each in maps:
                each.flush()
            await asyncio.sleep(0.3)
            for _ in range(15):
                sent = time.monotonic()
                assert joystick.path is not None
                joystick.path.send([(bytes(80), 0, 0)])
                await asyncio.sleep(0.1)
                late += [when - sent for _, when in joystick.arrived]
                joystick.arrived.clear()
        return late

    late = sorted(asyncio.run(main()))
    assert len(late) >= 12  # a map alone would hold it up for 2 s
    assert late[len(late) // 2] < 3 * CHUNK / _PACE


def test_those_that_want_more_than_their_share_get_the_same() -> None:
    topics = [Topic(1, always=100_000), Topic(2, always=5_000), Topic(3, always=1_000)]

    async def main() -> None:
        async with slow_link(*topics):
            started = time.monotonic()
            for topic in topics:
                topic.flush()
            await asyncio.sleep(6.5)
            shares = [topic.bytes_since(started) for topic in topics]
            assert min(shares) > 0.6 * max(shares), shares
            assert sum(shares) > 0.8 * 6.5 * _PACE

    asyncio.run(main())


def test_a_late_comer_does_not_make_up_for_its_silence() -> None:
    early, late = Topic(1, always=5_000), Topic(2, always=5_000)

    async def main() -> None:
        async with slow_link(early, late):
            early.flush()
            await asyncio.sleep(1.0)
            joined = time.monotonic()
            late.flush()
            await asyncio.sleep(2.0)
            assert early.bytes_since(joined) > 0.7 * late.bytes_since(joined) > 0

    asyncio.run(main())


def test_a_closed_path_sends_no_more() -> None:
    gone, stays = Topic(1, always=100_000), Topic(2)

    async def main() -> None:
        async with slow_link(gone, stays):
            gone.flush()
            assert gone.path is not None
            assert stays.path is not None
            stays.path.send([(bytes(10_000), 0, 0)])
            gone.path.close("removed")
            started = time.monotonic()
            async with asyncio.timeout(5):
                await stays.something.wait()
            assert stays.arrived[0][1] - started < 0.7
            assert not gone.arrived

    asyncio.run(main())


def test_a_chunk_costs_little() -> None:
    sealed = DataWriter(Sealer(Suite.AESGCM, _KEY), 1).write_chunks(bytes(100_000), 0, 0, CHUNK)
    assert sum(map(len, sealed)) / 100_000 < 1.02
    assert max(map(len, sealed)) == CHUNK + LENGTH.size + HEADER.size + 16
