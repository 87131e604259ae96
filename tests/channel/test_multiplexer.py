"""Routes that share one slow stream, on a loop whose time the test owns: a minute of radio takes milliseconds."""

from __future__ import annotations

import asyncio
from collections import deque
from random import Random
from typing import TYPE_CHECKING

from tests.simulation.loop import SimulatedLoop

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.multiplexer import CHUNK, MultiplexedReceiver, MultiplexedSender, Multiplexer
from rsb_bridge.transport.rfcomm import RfcommStream
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import HEADER, LENGTH, Budget, DataWriter, FrameReader
from rsb_bridge.wire.sealing import Sealer, SessionKeys, Suite

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable

    from rsb_bridge.wire.framing import Message

_PACE = 50_000  # bytes/s: the thesis's
_STEP = 0.01  # s
_KERNEL = 4096  # bytes that the kernel buffers
_KEY = bytes(range(32))


class SlowStream(Stream):
    """A stream as tolerant of waiting bytes as RFCOMM's, without a socket."""

    batch_bytes = RfcommStream.batch_bytes
    high_water = RfcommStream.high_water


class Radio(asyncio.Transport):
    """Carries `_PACE` bytes a second, and opens the frames that it has carried."""

    def __init__(self, protocol: asyncio.Protocol, receivers: dict[int, MultiplexedReceiver]) -> None:
        super().__init__()
        self._loop = asyncio.get_running_loop()
        self._protocol = protocol
        self._receivers = receivers
        self._frames = FrameReader(1 << 20)
        self._buffer = bytearray()
        self._high = 0
        self._paused = self._carrying = False
        protocol.connection_made(self)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = high or 0

    def is_closing(self) -> bool:
        return False

    def write(self, data: bytes | bytearray | memoryview[int]) -> None:
        self._buffer += data
        if not self._paused and len(self._buffer) - _KERNEL > self._high:
            self._paused = True
            self._protocol.pause_writing()
        if not self._carrying:
            self._carrying = True
            self._loop.call_later(_STEP, self._carry)

    def _carry(self) -> None:
        size = int(_PACE * _STEP)
        carried = bytes(self._buffer[:size])
        del self._buffer[:size]
        for frame in self._frames.feed(carried):
            self._receivers[HEADER.unpack(frame[: HEADER.size])[2]].received(frame)
        if self._paused and len(self._buffer) - _KERNEL <= self._high // 4:
            self._paused = False
            self._protocol.resume_writing()
        self._carrying = bool(self._buffer)
        if self._carrying:
            self._loop.call_later(_STEP, self._carry)


class Topic:
    """A channel's view of a route (`RouteSink`), with a queue that never runs dry, or single messages.

    Attributes:
        id: route id.
        rank: of its priority.
        arrived: size of the payload and time (s) of the messages that were carried.
        channel: its sending end.
    """

    def __init__(self, number: int, always: int = 0, rank: int = 0) -> None:
        self.id = number
        self.rank = rank
        self.outgoing, self.duplex = True, False
        self.arrived: deque[tuple[int, float]] = deque()
        self._always = always
        self.channel: MultiplexedSender

    def send(self, size: int) -> None:
        self.channel.send([(bytes(size), 0, 0)])

    def flush(self) -> None:
        if self._always and not self.channel.congested:
            self.send(self._always)

    def channel_lost(self, reason: str) -> None:
        raise AssertionError(reason)

    def deliver(self, messages: Iterable[Message]) -> None:
        now = asyncio.get_running_loop().time()
        self.arrived += [(len(payload), now) for payload, _, _ in messages]

    def bytes_since(self, start: float) -> int:
        return sum(size for size, when in self.arrived if when > start)


class _Pumping(StreamHandler):
    """Does what the control connection does."""

    multiplexer: Multiplexer

    def connected(self, stream: Stream) -> None:
        self.multiplexer = Multiplexer(stream)

    def writable(self) -> None:
        self.multiplexer.pump()


def _budget() -> Budget:
    return Budget(1 << 20)


def share(*topics: Topic) -> None:
    """Put all topics on one stream; what arrives is delivered to them again."""
    handler = _Pumping()
    receivers: dict[int, MultiplexedReceiver] = {}
    Radio(SlowStream(handler), receivers)
    for topic in topics:
        keys = SessionKeys(Suite.CHACHAPOLY, _KEY, bytes(8))
        topic.channel = MultiplexedSender(handler.multiplexer, topic, DataKeys(keys, "client", _budget()))
        receivers[topic.id] = MultiplexedReceiver(handler.multiplexer, topic, DataKeys(keys, "server", _budget()))


def play(scene: Callable[[], Coroutine[None, None, None]]) -> None:
    loop = SimulatedLoop(Random(0))  # type: ignore[abstract]  # what is not simulated raises
    loop.run_until_complete(scene())


def now() -> float:
    return asyncio.get_running_loop().time()


def test_a_joystick_goes_before_maps() -> None:
    joystick, maps = Topic(1), [Topic(2, always=100_000), Topic(3, always=100_000)]

    async def scene() -> None:
        share(joystick, *maps)
        for each in maps:
            each.flush()
        await asyncio.sleep(0.3)
        late = []
        for _ in range(50):
            sent = now()
            joystick.send(80)
            await asyncio.sleep(0.25)
            late += [when - sent for _, when in joystick.arrived]
            joystick.arrived.clear()
        assert len(late) == 50  # a map alone would hold it up for 2 s
        assert max(late) < (_KERNEL + RfcommStream.high_water + 3 * CHUNK) / _PACE

    play(scene)


def test_those_that_want_more_than_their_share_get_the_same() -> None:
    topics = [Topic(1, always=100_000), Topic(2, always=5_000), Topic(3, always=1_000)]

    async def scene() -> None:
        share(*topics)
        for topic in topics:
            topic.flush()
        await asyncio.sleep(60)
        shares = [topic.bytes_since(0) for topic in topics]
        assert min(shares) > 0.9 * max(shares), shares
        assert sum(shares) > 0.9 * 60 * _PACE

    play(scene)


def test_a_late_comer_does_not_make_up_for_its_silence() -> None:
    early, late = Topic(1, always=5_000), Topic(2, always=5_000)

    async def scene() -> None:
        share(early, late)
        early.flush()
        await asyncio.sleep(60)
        joined = now()
        late.flush()
        await asyncio.sleep(10)
        assert early.bytes_since(joined) > 0.9 * late.bytes_since(joined) > 0

    play(scene)


def test_a_channel_may_send_while_its_last_message_waits() -> None:
    bulk, late = Topic(1, always=100_000), Topic(2)

    async def scene() -> None:
        share(bulk, late)
        bulk.flush()
        await asyncio.sleep(0.3)
        late.send(80)
        late.send(90)
        await asyncio.sleep(1)
        assert [size for size, _ in late.arrived] == [80, 90]

    play(scene)


def test_a_closed_channel_sends_no_more() -> None:
    gone, stays = Topic(1, always=100_000), Topic(2)

    async def scene() -> None:
        share(gone, stays)
        gone.flush()
        stays.send(10_000)
        gone.channel.close("removed")
        await asyncio.sleep(0.5)
        assert [size for size, _ in stays.arrived] == [10_000]
        await asyncio.sleep(60)
        assert not gone.arrived

    play(scene)


def test_a_chunk_costs_little() -> None:
    sealed = DataWriter(Sealer(Suite.AESGCM, _KEY), 1).write_chunks(bytes(100_000), 0, 0, CHUNK)
    assert sum(map(len, sealed)) / 100_000 < 1.02
    assert max(map(len, sealed)) == CHUNK + LENGTH.size + HEADER.size + 16


def test_shares_follow_priorities_and_nobody_starves() -> None:
    topics = [Topic(1, always=5_000, rank=1), Topic(2, always=5_000), Topic(3, always=5_000, rank=-1)]

    async def scene() -> None:
        share(*topics)
        for topic in topics:
            topic.flush()
        await asyncio.sleep(60)
        high, normal, low = (topic.bytes_since(0) for topic in topics)
        assert 3.5 < high / normal < 4.5
        assert 3.5 < normal / low < 4.5

    play(scene)
