"""Messages that take too long, and a link that carries less than is asked of it: what both sides say of it."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import linked, link, route
from tests.support.domain import text
from tests.support.slow_relay import SlowRelay
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, LinkCause

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Publisher

    from rsb_bridge.engine import Engine


class HoldingRelay:
    """Passes on what it gets after a while, TCP and UDP, each way. A context manager.

    Args:
        target: the port where it all goes.

    Attributes:
        port: to connect to.
        held: s; may be set at any time, but order stays.
    """

    def __init__(self, target: int) -> None:
        self.held = 0.0
        self.port = 0
        self._target = target
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._udp: dict[tuple[str, int], asyncio.DatagramTransport] = {}

    def __enter__(self) -> HoldingRelay:
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._open(), self._loop).result(5)
        return self

    def __exit__(self, *error: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)

    async def _open(self) -> None:
        server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        relay = self

        class Near(asyncio.DatagramProtocol):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                self.transport = transport

            def datagram_received(self, data: bytes, address: tuple[str, int]) -> None:
                relay._loop.create_task(relay._pass(data, address, self.transport))  # type: ignore[arg-type]

        await self._loop.create_datagram_endpoint(Near, local_addr=("127.0.0.1", self.port))

    async def _pass(self, data: bytes, address: tuple[str, int], near: asyncio.DatagramTransport) -> None:
        relay = self

        class Far(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, _: object) -> None:
                relay._loop.call_later(relay.held, near.sendto, data, address)

        if address not in self._udp:
            self._udp[address], _ = await self._loop.create_datagram_endpoint(
                Far, remote_addr=("127.0.0.1", self._target)
            )
        self._loop.call_later(self.held, self._udp[address].sendto, data)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
        await asyncio.gather(self._pump(reader, far_writer), self._pump(far_reader, writer))

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def write() -> None:
            while (item := await queue.get())[1]:
                await asyncio.sleep(max(0.0, item[0] - self._loop.time()))
                writer.write(item[1])
            writer.close()

        writing = self._loop.create_task(write())
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(65_536):
                queue.put_nowait((self._loop.time() + self.held, data))
        queue.put_nowait((0.0, b""))
        await writing


class Talking:
    """Publishes at a rate until it is left; `size` bytes each."""

    def __init__(self, publisher: Publisher, rate: float, size: int) -> None:
        self._publisher, self._pause, self._text = publisher, 1 / rate, " " * size
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Talking:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._pause):
            self._publisher.publish(text(self._text))


def both_say(engines: tuple[Engine, Engine], topic: str, state: State, cause: str, within: float) -> float:
    """Wait until both sides say so; s that it took."""
    began = time.monotonic()

    def said() -> bool:
        return all((route(each, topic).state, route(each, topic).cause) == (state, cause) for each in engines)

    try:
        eventually(said, within)
    except AssertionError:
        found = [(route(each, topic).state, route(each, topic).reason, link(each).warning) for each in engines]
        raise AssertionError(f"{topic} is not {state} on both sides within {within:g} s: {found}") from None
    return time.monotonic() - began


@pytest.fixture
def holding(bridge: Bridge) -> Iterator[HoldingRelay]:
    with HoldingRelay(bridge.port) as relay:
        yield relay


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_messages_that_are_held_on_the_way_are_late_on_both_sides(
    protocol: str, bridge: Bridge, holding: HoldingRelay, robot: Domain, pc: Domain
) -> None:
    out, _ = robot.publisher("/scan"), pc.listener("/scan")
    server = bridge.server()
    client = bridge.client(Topic("/scan", "transmit", protocol=protocol), server_ip="127.0.0.1", server_port=holding.port)
    eventually(lambda: linked(client) and linked(server), what="linked")
    with Talking(out, 20, 100):
        both_say((client, server), "/scan", State.OK, Cause.NONE, 15)
        holding.held = 3.0
        assert both_say((client, server), "/scan", State.LATE, Cause.LATE, 12) <= 8.0 + 1
        eventually(lambda: all(event_of(each, EventCode.ROUTE_FAULT, Cause.LATE) for each in (client, server)), 15)
        holding.held = 0.0
        both_say((client, server), "/scan", State.OK, Cause.NONE, 15)
        eventually(lambda: all(event_of(each, EventCode.ROUTE_RECOVERED, Cause.LATE) for each in (client, server)), 15)
    assert client.snapshot().links[0].warning == "", "nothing says that the link is full"


def event_of(engine: Engine, code: EventCode, cause: str = "") -> bool:
    return any((event.code, event.cause) == (code, cause) for event in engine.events())


def test_a_tunnel_that_carries_too_little_is_full_on_both_sides(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It takes everything at first: only what arrives shows how little it carries."""
    out, _ = robot.publisher("/camera"), pc.listener("/camera")
    server = bridge.server()
    with SlowRelay(bridge.port, 1_000_000) as relay:
        client = bridge.client(Topic("/camera", "transmit"), server_ip="127.0.0.1", server_port=relay.port)
        eventually(lambda: linked(client) and linked(server), what="linked")
        with Talking(out, 20, 700):
            both_say((client, server), "/camera", State.OK, Cause.NONE, 15)
            relay.bytes_per_second = 5_000
            began = time.monotonic()
            eventually(lambda: all(link(each).cause == LinkCause.FULL for each in (client, server)), 12)
            print("full after", time.monotonic() - began)
            both_say((client, server), "/camera", State.LATE, Cause.LATE, 12)
            print("late after", time.monotonic() - began)
            out_there, in_here = link(client).full_out, link(server).full_in
            assert out_there is not None and in_here is not None
            print(link(client), route(client, "/camera").reason, link(server).warning, route(server, "/camera").reason)
            for each in (out_there, in_here):
                assert 2_500 < each.carried < 7_500
                assert 11_000 < each.asked < 20_000
                assert each.topics == ("/camera",)
            assert event_of(client, EventCode.LINK_FULL, LinkCause.FULL)
            assert event_of(server, EventCode.LINK_FULL, LinkCause.FULL)
            relay.bytes_per_second = 1_000_000
            eventually(lambda: all(not link(each).warning for each in (client, server)), 20)
            both_say((client, server), "/camera", State.OK, Cause.NONE, 15)
        assert event_of(client, EventCode.LINK_ROOM)
        assert event_of(server, EventCode.LINK_ROOM)
