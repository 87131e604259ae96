"""Datagrams that share a link with streams: who sends, what arrives whole, and what gets lost."""

from __future__ import annotations

import asyncio

import pytest
from tests.channel.datagram_radio import RadioChannel, datagrams_between, pass_time
from tests.channel.sides import Radio, Route, Side, connected, simulate

_TUNNEL = 5_000
"""Bytes/s."""
_QUEUE = 10_000
"""Bytes that wait in the tunnel: 2 s."""
_BROAD = 2.5e6


class Live(Route):
    """A route whose queue keeps the two newest messages.

    Args:
        size: bytes of a message.
    """

    def __init__(self, number: int, size: int, rate: float, rank: int = 0) -> None:
        super().__init__(number, rank, outgoing=True)
        self.size, self.rate = size, rate
        self.sent = 0

    async def publish(self) -> None:
        while True:
            self.sent += 1
            self.waiting.append(str(asyncio.get_running_loop().time()).encode().ljust(self.size))
            while len(self.waiting) > 2:
                self.waiting.popleft()
            self.flush()
            await asyncio.sleep(1 / self.rate)


class Scene:
    """Routes that publish: the first ones by datagrams, the others on streams.

    Attributes:
        channel: the sending end of the datagrams.
    """

    channel: RadioChannel

    def __init__(self, radio: Radio, queue: int, datagrams: tuple[Live, ...], streams: tuple[Live, ...] = ()) -> None:
        self._radio, self._queue = radio, queue
        self._datagrams = {route.id for route in datagrams}
        self._routes = (*datagrams, *streams)
        self.near: Side
        self.far: Side

    async def __call__(self) -> None:
        async with connected(*self._routes, open_streams=self._radio.open, elsewhere=self._datagrams) as (near, far):
            self.near, self.far = near, far
            self.channel = datagrams_between(near, far, self._radio, *self._datagrams, queue=self._queue)
            publishing = [asyncio.ensure_future(route.publish()) for route in self._routes]
            await self.watched()
            for each in publishing:
                each.cancel()

    async def watched(self) -> None:
        """Pass time, and check."""
        raise NotImplementedError

    async def passes(self, seconds: float) -> None:
        await pass_time(seconds, self.near, self.far, self.channel)

    def shares(self, seconds: float) -> list[float]:
        """Bytes/s of each route so far."""
        return [route.bytes_since(0) / seconds for route in self.far.routes.values()]

    def ages(self, route: Live, since: float = 0.0) -> list[float]:
        """The ages (s) of a route's messages on arrival, sorted."""
        return sorted(when - float(payload) for payload, when in self.far.routes[route.id].arrived if when > since)

    def part(self, route: Live) -> float:
        """The part of a route's messages that has arrived."""
        return len(self.far.routes[route.id].arrived) / route.sent


@pytest.mark.parametrize(("rank", "least", "most"), [(0, 0.8, 1.25), (1, 3.0, 5.0), (-1, 0.2, 0.34)])
def test_datagrams_share_a_thin_link_by_priority(rank: int, least: float, most: float) -> None:
    """They do not fill the tunnel's queue, so nothing is old or lost, and a joystick goes before both."""
    scan, odom, joystick = Live(1, 1_000, 15, rank), Live(2, 700, 20), Live(3, 50, 5, 1)

    class Thin(Scene):
        async def watched(self) -> None:
            await self.passes(60)
            by_scan, by_odom, _ = self.shares(60)
            assert least < by_scan / by_odom < most
            assert by_scan + by_odom > 0.8 * _TUNNEL
            assert self.part(joystick) > 0.9
            for route in (scan, odom):
                assert self.ages(route)[-1] < 4.0
            assert self.ages(joystick)[-1] < 2.0
            assert not self.channel.air.dropped

    simulate(Thin(Radio(_TUNNEL, tunnel=_QUEUE, delay=0.005), _QUEUE, (scan,), (odom, joystick)))


def test_large_messages_arrive_whole_or_are_not_begun() -> None:
    """20 kB a second into a quarter of it."""
    cloud = Live(1, 20_000, 1)

    class Thin(Scene):
        async def watched(self) -> None:
            await self.passes(80)
            assert self.part(cloud) > 0.22
            assert self.ages(cloud)[-1] < 2.0 + 2 * cloud.size / _TUNNEL
            assert not self.channel.air.dropped

    simulate(Thin(Radio(_TUNNEL, tunnel=_QUEUE, delay=0.005), _QUEUE, (cloud,)))


def test_loss_by_chance_slows_nothing_down() -> None:
    scan, rare, odom = Live(1, 1_000, 50), Live(2, 200, 2), Live(3, 100, 10)

    class Poor(Scene):
        async def watched(self) -> None:
            for air in (self.channel.air, self.channel.air.far.air):
                air.loss = 0.3
            await self.passes(60)
            assert 0.65 < self.part(scan) < 0.75
            assert 0.5 < self.part(rare) < 0.9
            assert self.part(odom) > 0.95
            assert self.ages(scan)[-1] < 0.5

    simulate(Poor(Radio(_BROAD, tunnel=400_000, delay=0.02), 400_000, (scan, rare), (odom,)))


def test_a_camera_fills_no_queue_of_a_radio() -> None:
    """20 Mbit/s with a queue of 0.16 s, asked for twice what it carries: small messages are young, and whole."""
    joints, scan, camera = Live(1, 470, 100), Live(2, 4_000, 10), Live(3, 60_000, 70, -1)

    class Asked(Scene):
        async def watched(self) -> None:
            await self.passes(5)
            for route in (joints, scan):
                ages = self.ages(route, since=2.0)
                assert ages[len(ages) // 2] < 0.08
                assert self.part(route) > 0.9  # until the rate is found, the queue fills once
            assert sum(self.shares(5)) > 0.75 * _BROAD
            assert self.channel.air.dropped < 0.03 * self.channel.air.sent

    simulate(Asked(Radio(_BROAD, tunnel=400_000, delay=0.02), 400_000, (joints, scan, camera)))


def test_a_path_on_which_no_datagram_arrives_holds_up_no_stream() -> None:
    """Only what was in transit does, until it is written off; once datagrams arrive again, they go on within 1 s."""
    scan, odom = Live(1, 1_000, 50), Live(2, 100, 10)

    class Cut(Scene):
        async def watched(self) -> None:
            loop = asyncio.get_running_loop()
            await self.passes(5)
            self.channel.air.blocked = True
            await self.passes(4)
            sent, cut_at = self.channel.air.sent, loop.time()
            await self.passes(6)
            assert self.channel.air.sent - sent < 6 * 2_048
            assert len(self.ages(odom, since=cut_at)) >= 59
            assert self.ages(odom, since=cut_at)[-1] < 0.2
            self.channel.air.blocked = False
            before = len(self.far.routes[1].arrived)
            await self.passes(3)
            assert len(self.far.routes[1].arrived) - before > 2 * scan.rate

    simulate(Cut(Radio(_BROAD, tunnel=400_000, delay=0.02), 400_000, (scan,), (odom,)))


def test_a_link_with_room_delays_no_datagram() -> None:
    small, large = Live(1, 2_500, 1_000), Live(2, 1_000_000, 20)

    class Fast(Scene):
        async def watched(self) -> None:
            await self.passes(10)
            assert self.part(small) > 0.999
            assert self.part(large) > 0.98
            half = self.ages(small, since=1.0)
            assert half[len(half) // 2] < 0.001

    simulate(Fast(Radio(1e9, tunnel=8_000_000, delay=0.0002), 8_000_000, (small, large)))
