"""Channels of routes that send both ways, on streams of their own and on shared ones."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import pytest

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.multiplexer import CHUNK, SharedStream
from rsb_bridge.channel.stream import stream_channel
from rsb_bridge.transport.rfcomm import RfcommStream
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import Budget, DataWriter
from rsb_bridge.wire.sealing import SessionKeys, Suite

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Coroutine, Iterable

    from rsb_bridge.channel.channel import DuplexChannel
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Role

_EXPORT = bytes(range(32))
_BUDGET = 64 << 20


@dataclass(eq=False)
class Route:
    """A channel's view of a route (`RouteSink`), with messages that wait for the channel.

    Attributes:
        arrived: payloads.
        waiting: payloads to be sent.
        lost: why the channel was lost.
        congested: how often the channel took no more for a while.
        rank: of its priority.
    """

    id: int
    outgoing: bool
    duplex: bool
    arrived: list[bytes] = field(default_factory=list)
    waiting: deque[bytes] = field(default_factory=deque)
    lost: list[str] = field(default_factory=list)
    congested: int = 0
    rank: int = 0
    channel: DuplexChannel = field(init=False)

    def send(self, *payloads: bytes) -> None:
        self.waiting += payloads
        self.flush()

    def flush(self) -> None:
        while self.waiting and not self.channel.congested:
            self.channel.send([(self.waiting.popleft(), 0, 0)])
        self.congested += bool(self.waiting)

    def deliver(self, messages: Iterable[Message]) -> None:
        self.arrived += [payload for payload, _, _ in messages]

    def channel_lost(self, reason: str) -> None:
        self.lost.append(reason)
        self.channel.close(reason)


@dataclass
class End:
    """One side.

    Attributes:
        keys: that its channels seal and open with.
        stream: that its routes are on.
        routes: by id.
    """

    keys: DataKeys
    stream: Stream
    routes: dict[int, Route] = field(default_factory=dict)

    def join_stream(self, shared: SharedStream, frame: bytes) -> None:
        raise AssertionError(frame)

    def is_closed_id(self, route_id: int) -> bool:
        return False


def _keys() -> SessionKeys:
    return SessionKeys(Suite.AESGCM, _EXPORT, bytes(8))


Place: TypeAlias = "Callable[[End, Iterable[Route]], None]"


def on_its_own(end: End, routes: Iterable[Route]) -> None:
    for route in routes:
        route.channel = stream_channel(end.stream, route, end.keys)  # type: ignore[assignment]  # tests use only these attributes


def _on_a_shared_one(end: End, routes: Iterable[Route]) -> None:
    shared = SharedStream(end.stream, end, 3, end.keys.budget)
    for route in routes:
        route.channel = shared.carry(route, end.keys)  # type: ignore[assignment]  # the same


CARRIERS = pytest.mark.parametrize("place", [on_its_own, _on_a_shared_one])


@asynccontextmanager
async def connected(place: Place, *specs: tuple[int, bool]) -> AsyncIterator[tuple[End, End]]:
    """Both ends of one stream, and routes on it.

    Each route is given by its id, and whether it sends both ways; if not, the first end sends.
    """
    loop = asyncio.get_running_loop()
    ends: list[End] = []
    roles: tuple[Role, Role] = ("client", "server")
    kind = Stream if place is on_its_own else _SlowStream
    for sock, role in zip(socket.socketpair(), roles, strict=True):
        sock.setblocking(False)
        _, stream = await loop.create_connection(lambda: kind(StreamHandler()), sock=sock)
        end = End(DataKeys(_keys(), role, Budget(_BUDGET)), stream)
        end.routes = {number: Route(number, outgoing=not ends, duplex=duplex) for number, duplex in specs}
        place(end, end.routes.values())
        ends.append(end)
    try:
        yield ends[0], ends[1]
    finally:
        for end in ends:
            end.stream.abort("the test is over")
        await until(lambda: all(end.stream.gone for end in ends))


class _SlowStream(Stream):
    """A stream that allows as many waiting bytes as RFCOMM's."""

    batch_bytes = RfcommStream.batch_bytes
    high_water = RfcommStream.high_water


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110 — plain state, looked at for a moment
            await asyncio.sleep(0.005)


def play(scene: Callable[[], Coroutine[None, None, None]]) -> None:
    asyncio.run(scene())


@CARRIERS
def test_both_ends_send_at_once_more_than_the_stream_takes(place: Place) -> None:
    """Neither waits for the other's answer before it reads; each way keeps its order."""
    sent = [bytes([number]) * size for number, size in enumerate((0, 1, CHUNK, 5 << 20, 80, 3 << 20, CHUNK + 1))]

    async def scene() -> None:
        async with connected(place, (1, True)) as ends:
            routes = [end.routes[1] for end in ends]
            for route in routes:
                route.send(*sent)
            await until(lambda: all(len(route.arrived) == len(sent) for route in routes))
            for route in routes:
                assert route.arrived == sent
                assert route.congested
                assert not route.channel.congested
                assert not route.lost
            assert [end.keys.budget.held for end in ends] == [0, 0]

    play(scene)


@CARRIERS
def test_what_is_not_whole_counts_until_the_channel_closes(place: Place) -> None:
    async def scene() -> None:
        async with connected(place, (1, True)) as (here, there):
            there.stream.write(_sealed("server")[:-1])
            await until(lambda: here.keys.budget.held)
            here.routes[1].channel.close("removed")
            assert here.keys.budget.held == 0
            await until(lambda: there.routes[1].lost)
            assert not here.routes[1].lost
            assert not here.routes[1].arrived

    play(scene)


def test_chunks_count_until_the_channel_closes() -> None:
    async def scene() -> None:
        async with connected(_on_a_shared_one, (1, True), (2, True)) as (here, there):
            route = here.routes[1]
            chunks = DataWriter(_keys().route_sealer(1, "server"), 1).write_chunks(bytes(2 * CHUNK), 0, 0, CHUNK)
            there.stream.write(chunks[0])
            await until(lambda: here.keys.budget.held)
            route.channel.close("removed")
            assert here.keys.budget.held == 0

    play(scene)


@CARRIERS
def test_a_closed_end_sends_no_more_of_what_waits(place: Place) -> None:
    async def scene() -> None:
        async with connected(place, (1, True)) as (here, there):
            here.routes[1].send(bytes(8 << 20))
            here.routes[1].channel.close("removed")
            await until(lambda: there.routes[1].lost)
            assert not there.routes[1].arrived
            assert there.keys.budget.held == 0

    play(scene)


@CARRIERS
@pytest.mark.parametrize("sealed_by", ["client", "nobody"])
def test_a_broken_frame_ends_the_channel_on_both_sides(place: Place, sealed_by: Literal["client", "nobody"]) -> None:
    """One that an end itself has sealed is no better: each direction has its own key."""
    frame = _sealed(sealed_by) if sealed_by == "client" else _sealed("server")[:-1] + b"?"

    async def scene() -> None:
        async with connected(place, (1, True)) as (here, there):
            there.stream.write(frame)
            routes = here.routes[1], there.routes[1]
            await until(lambda: all(route.lost for route in routes))
            assert [len(route.lost) for route in routes] == [1, 1]
            assert not here.routes[1].arrived

    play(scene)


@CARRIERS
def test_an_end_that_sends_one_way_refuses_what_comes_the_other_way(place: Place) -> None:
    async def scene() -> None:
        async with connected(place, (1, False)) as (sending, receiving):
            receiving.stream.write(_sealed("server"))
            await until(lambda: sending.routes[1].lost and receiving.routes[1].lost)
            assert "the other way" in sending.routes[1].lost[0]
            assert not sending.routes[1].arrived

    play(scene)


def test_on_a_shared_stream_either_way_takes_its_turn() -> None:
    """A call overtakes a map that is being sent, and its answer another one."""

    async def scene() -> None:
        async with connected(_on_a_shared_one, (1, True), (2, True)) as (here, there):
            for end in (here, there):
                end.routes[1].send(bytes(8 << 20))
                end.routes[2].send(b"asked")
            await until(lambda: here.routes[2].arrived and there.routes[2].arrived)
            assert not here.routes[1].arrived
            assert not there.routes[1].arrived
            await until(lambda: here.routes[1].arrived and there.routes[1].arrived)

    play(scene)


def _sealed(role: Role) -> bytes:
    """The first frame that this side sends on route 1."""
    return DataWriter(_keys().route_sealer(1, role), 1).write(b"hello", 0)
