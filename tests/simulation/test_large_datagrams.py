"""Large messages by UDP between two machines whose kernels keep little."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.simulation.loop import SimulatedLoop
from tests.simulation.machine import Machine, Process
from tests.simulation.network import Network
from tests.simulation.sockets import simulated
from tests.support.schedulers import lone_scheduler
from tests.support.session_keys import session_keys

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram_channel import DatagramReceiver, DatagramSender, datagram_channel
from rsb_bridge.channel.udp_channel import ClientUdpChannel, PathProbe, ServerUdpChannel, UdpDemultiplexer
from rsb_bridge.link.data_channels import UdpChannels
from rsb_bridge.model.codes import EventCode
from rsb_bridge.transport.streams import StreamHandler
from rsb_bridge.transport.transport import Acceptor
from rsb_bridge.transport.udp import Udp
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.snapshot import Level
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Role

_LINK = b"the link"
_PORT = 49152
_DEBIAN = 212_992
"""Bytes: net.core.rmem_max of most distributions."""


@dataclass
class Route:
    """A route's end (`RouteSink`), with what waits to be sent and what has come."""

    outgoing: bool
    id: int = 1
    duplex: bool = False
    rank: int = 0
    arrived: list[int] = field(default_factory=list)
    waiting: list[bytes] = field(default_factory=list)
    sender: DatagramSender | None = None

    def deliver(self, messages: Iterable[Message]) -> None:
        self.arrived += [len(payload) for payload, _, _ in messages]

    def flush(self) -> None:
        while self.waiting and self.sender is not None and not self.sender.congested:
            self.sender.send([(self.waiting.pop(0), 0, 0)])
        if self.waiting and self.sender is not None:
            self.sender.ask()

    def channel_lost(self, reason: str) -> None:
        raise AssertionError(reason)


class Side:
    """One machine, its UDP channels, and the events of its link."""

    def __init__(self, network: Network, name: str, address: str, role: Role, receive_buffer: int) -> None:
        self.machine = Machine(name, network, address)
        self.machine.receive_buffer = receive_buffer
        self.process = Process(self.machine)
        self.events: list[tuple[EventCode, str]] = []
        self.keys = DataKeys(session_keys(CipherSuite.AESGCM, bytes(32), _LINK), role, Budget(1 << 28))
        self.probe = PathProbe(self.keys)
        self.channels = UdpChannels(network.loop, self._log, lambda: None, lambda _: None)
        self.route = Route(outgoing=role == "client")

    def _log(self, level: Level, code: EventCode, text: str) -> None:
        self.events.append((code, text))


class Link:
    """A client that sends to a server."""

    def __init__(self, receive_buffer: int) -> None:
        self.loop = SimulatedLoop(Random(1))  # type: ignore[abstract]  # what is not simulated raises
        self.network = Network(self.loop, Random(2))
        self.client = Side(self.network, "robot", "10.0.0.2", "client", 8 << 20)
        self.server = Side(self.network, "pc", "10.0.0.1", "server", receive_buffer)
        for path in self.network.both_ways(self.client.machine, self.server.machine):
            path.latency, path.mtu = (0.0002, 0.0002), 9000

    async def open(self) -> None:
        demultiplexer = UdpDemultiplexer(self._new_channel)
        acceptor = Acceptor(StreamHandler, demultiplexer.received, lambda message: None)
        await self._of(self.server, Udp().listen("10.0.0.1", _PORT, acceptor))
        await self._of(self.client, self._connect())

    async def _of(self, side: Side, work: object) -> None:
        assert asyncio.iscoroutine(work)
        await self.loop.create_task(work, context=side.process.context)

    def _new_channel(self, link_id: bytes, socket: DatagramSocket, _: Address) -> ServerUdpChannel:
        side = self.server
        channel = ServerUdpChannel(socket, "10.0.0.1", side.probe, self.loop.time, lambda: None)
        side.channels.add(_PORT, channel)
        receiver = datagram_channel(channel, side.route, side.keys, lone_scheduler())
        assert isinstance(receiver, DatagramReceiver)
        return channel

    async def _connect(self) -> None:
        side, ready = self.client, asyncio.Event()
        channel = ClientUdpChannel(Udp(), ("10.0.0.1", _PORT), side.probe, self.loop.time, ready.set)
        side.channels.open(_PORT, channel)
        await ready.wait()
        sender = datagram_channel(channel, side.route, side.keys, lone_scheduler())
        assert isinstance(sender, DatagramSender)
        side.route.sender = sender

    async def send(self, count: int, size: int) -> None:
        """Send messages, and wait until nothing waits any more."""
        self.client.route.waiting += [bytes(size)] * count
        await self._of(self.client, _flushed(self.client.route))
        while self.client.route.waiting or (self.client.route.sender and self.client.route.sender.congested):
            await asyncio.sleep(0.01)
            self.tick()
        await asyncio.sleep(0.1)
        self.tick()

    def tick(self) -> None:
        for side in (self.client, self.server):
            side.process.context.run(side.channels.tick)


async def _flushed(route: Route) -> None:
    route.flush()


def told(side: Side) -> list[str]:
    return [text for code, text in side.events if code is EventCode.LINK_UDP_BUFFER]


@pytest.mark.parametrize("receive_buffer", [_DEBIAN, 8 << 20])
def test_large_messages_arrive_whatever_the_kernel_keeps(receive_buffer: int) -> None:
    """Both sides say once where a kernel's limit is too small, with what to run there."""

    async def main() -> None:
        await link.open()
        await link.send(20, 1_000_000)
        assert link.server.route.arrived == [1_000_000] * 20
        for side, where in ((link.server, "here"), (link.client, "there")):
            if receive_buffer == _DEBIAN:
                (text,) = told(side)
                assert f"Run {where}: sudo sysctl -w net.core.rmem_max=8388608" in text
            else:
                assert not told(side)

    with simulated():
        link = Link(receive_buffer)
        link.loop.run_until_complete(main())


def test_a_limit_that_is_raised_counts_at_once() -> None:
    async def main() -> None:
        await link.open()
        await link.send(2, 1_000_000)
        link.server.machine.receive_buffer = 8 << 20
        link.tick()
        await link.send(20, 1_000_000)
        assert link.server.route.arrived == [1_000_000] * 22
        assert link.client.route.sender is not None
        assert link.client.route.sender.via.window > _DEBIAN

    with simulated():
        link = Link(_DEBIAN)
        link.loop.run_until_complete(main())


def test_small_messages_need_no_large_buffer() -> None:
    async def main() -> None:
        await link.open()
        await link.send(1000, 2_500)
        assert len(link.server.route.arrived) == 1000
        assert not told(link.server)
        assert not told(link.client)

    with simulated():
        link = Link(_DEBIAN)
        link.loop.run_until_complete(main())
