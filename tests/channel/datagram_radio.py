"""Datagrams over a simulated radio that also carries the data streams of `tests.channel.sides`."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING

from rsb_bridge.channel.reliable_datagrams import datagram_channel
from rsb_bridge.channel.udp_channel import UdpChannel
from rsb_bridge.transport.transport import RECEIVE_BUFFER, SendPath
from rsb_bridge.wire.datagram import Probe, by_addressee

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.channel.sides import Radio, Side

    from rsb_bridge.transport.streams import Address

_ADDRESS: Address = ("10.0.0.1", 49152)
_MTU = 1472


class RadioSocket:
    """One end of a socket pair (`DatagramSocket`), whose datagrams share the radio with its streams.

    Args:
        queue: bytes that wait for the radio at most; beyond them datagrams are dropped.

    Attributes:
        loss: part of the datagrams that are lost by chance.
        late: s by which some are late, and others overtake them.
        mtu: bytes of the longest datagram that arrives.
        blocked: whether all are lost.
        dropped: of these, by a full queue.
    """

    congested = False
    port = 49152
    receive_buffer = RECEIVE_BUFFER

    def __init__(self, radio: Radio, way: int, queue: int) -> None:
        self.when_writable: set[Callable[[], None]] = set()
        self.far: RadioChannel
        self.loss = self.late = 0.0
        self.mtu = _MTU
        self.blocked = False
        self.sent = self.dropped = 0
        self.taken_at = 0.0
        self._radio, self._way, self._queue = radio, radio.ways[way], queue
        self._random = Random(way)

    def send(self, datagrams: Sequence[bytes], path: SendPath | None) -> None:
        loop = asyncio.get_running_loop()
        for each in datagrams:
            self.sent += 1
            backlog = max(0.0, self._way.free_at - loop.time()) * self._radio.rate
            if self.blocked or self._random.random() < self.loss or len(each) > self.mtu:
                continue
            if backlog + len(each) > self._queue:
                self.dropped += 1
                continue
            self._way.free_at = max(self._way.free_at, loop.time()) + len(each) / self._radio.rate
            late = self._random.uniform(0.0, self.late) if self.late else 0.0
            loop.call_later(self._way.free_at + self._radio.delay + late - loop.time(), self._arrive, each)

    def _arrive(self, datagram: bytes) -> None:
        self.far.air.taken_at = asyncio.get_running_loop().time()
        for (route, _, address), its in by_addressee([(datagram, _ADDRESS)]).items():
            self.far.received(route, its, address)

    def arrived_at(self) -> float:
        return self.taken_at

    def path(self, source: str, address: Address) -> SendPath:
        return SendPath(address, [])

    def datagram_size(self, address: Address) -> int:
        return self.mtu

    def close(self) -> None:
        """Nothing is left."""


class RadioChannel(UdpChannel):
    """A UDP channel that knows its peer's address."""

    def __init__(self, socket: RadioSocket, side: Side) -> None:
        super().__init__(side, socket)
        self._peer = _ADDRESS
        self.ready = True
        self.air = socket

    def _probed(self, probe: Probe, address: Address) -> bool:
        return True

    def _silence(self) -> str:
        return ""


def datagrams_between(near: Side, far: Side, radio: Radio, *numbers: int, queue: int = 10_000) -> RadioChannel:
    """Give routes a UDP channel, and return its sending end. Its far end ticks with it."""
    ends = [RadioChannel(RadioSocket(radio, way, queue), side) for way, side in enumerate((near, far))]
    for here, there in (ends, ends[::-1]):
        here.air.far = there
    for number in numbers:
        for side, channel in ((far, ends[1]), (near, ends[0])):
            route = side.routes[number]
            route.channel = datagram_channel(channel, route, side.keys)
    return ends[0]


async def pass_time(seconds: float, *parts: Side | RadioChannel) -> None:
    """Let simulated time pass, with the regular work of sides and channels once a second."""
    loop = asyncio.get_running_loop()
    until = loop.time() + seconds
    while loop.time() < until:
        await asyncio.sleep(1.0)
        for each in parts:
            each.tick()
            if isinstance(each, RadioChannel):
                each.air.far.tick()
