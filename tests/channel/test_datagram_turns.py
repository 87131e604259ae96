"""Datagrams that share a link with streams: who sends, what arrives whole, and what gets lost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from unittest.mock import Mock

import pytest
from tests.channel.datagram_radio import RadioChannel, datagrams_between, pass_time
from tests.channel.sides import Radio, Route, Side, connected

from rsb_bridge.channel.datagram_carrier import DatagramCarrier
from rsb_bridge.model.fates import BEST_EFFORT, RELIABLE
from rsb_bridge.wire.datagram import Receipt

pytestmark = pytest.mark.usefixtures("loop")
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

    def __init__(self, number: int, size: int, rate: float, rank: int = 0, *, reliable: bool = True) -> None:
        super().__init__(number, rank, outgoing=True)
        self.fates = RELIABLE if reliable else BEST_EFFORT
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

    def __init__(self, near: Side, far: Side, channel: RadioChannel) -> None:
        self.near, self.far, self.channel = near, far, channel

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


@asynccontextmanager
async def publishing(
    radio: Radio, queue: int, datagrams: tuple[Live, ...], streams: tuple[Live, ...] = ()
) -> AsyncIterator[Scene]:
    numbers = {route.id for route in datagrams}
    routes = (*datagrams, *streams)
    async with connected(*routes, open_streams=radio.open, elsewhere=numbers) as (near, far):
        tasks = [asyncio.ensure_future(route.publish()) for route in routes]
        yield Scene(near, far, datagrams_between(near, far, radio, *numbers, queue=queue))
        for each in tasks:
            each.cancel()


def tunnel() -> Radio:
    return Radio(_TUNNEL, tunnel=_QUEUE, delay=0.005)


def radio() -> Radio:
    return Radio(_BROAD, tunnel=400_000, delay=0.02)


@pytest.mark.parametrize(("rank", "least", "most"), [(0, 0.8, 1.25), (1, 3.0, 5.0), (-1, 0.2, 0.34)])
async def test_datagrams_share_a_thin_link_by_priority(rank: int, least: float, most: float) -> None:
    """They do not fill the tunnel's queue, so nothing is old or lost, and a joystick goes before both."""
    scan, odom, joystick = Live(1, 1_000, 15, rank), Live(2, 700, 20), Live(3, 50, 5, 1)
    async with publishing(tunnel(), _QUEUE, (scan,), (odom, joystick)) as scene:
        await scene.passes(60)
        by_scan, by_odom, _ = scene.shares(60)
        assert least < by_scan / by_odom < most
        assert by_scan + by_odom > 0.8 * _TUNNEL
        assert scene.part(joystick) > 0.9
        for route in (scan, odom):
            assert scene.ages(route)[-1] < 4.0
        assert scene.ages(joystick)[-1] < 2.0
        assert not scene.channel.air.dropped


async def test_large_messages_arrive_whole_or_are_not_begun() -> None:
    """20 kB a second into a quarter of it."""
    cloud = Live(1, 20_000, 1)
    async with publishing(tunnel(), _QUEUE, (cloud,)) as scene:
        await scene.passes(80)
        assert scene.part(cloud) > 0.22
        assert scene.ages(cloud)[-1] < 2.0 + 2 * cloud.size / _TUNNEL
        assert not scene.channel.air.dropped


@pytest.mark.parametrize("reliable", [False, True])
async def test_loss_by_chance_slows_nothing_down(reliable: bool) -> None:
    """Lost messages of reliable topics are sent again."""
    scan, rare = Live(1, 1_000, 50, reliable=reliable), Live(2, 200, 2, reliable=reliable)
    odom = Live(3, 100, 10)
    async with publishing(radio(), 400_000, (scan, rare), (odom,)) as scene:
        for air in (scene.channel.air, scene.channel.air.far.air):
            air.loss = 0.3
        await scene.passes(60)
        least, most = (0.99, 1.0) if reliable else (0.65, 0.75)
        assert least <= scene.part(scan) <= most
        assert (0.97 if reliable else 0.5) < scene.part(rare) <= (1.0 if reliable else 0.9)
        assert scene.part(odom) > 0.95
        ages = scene.ages(scan)
        assert ages[len(ages) // 2] < (0.15 if reliable else 0.03)  # a lost one holds up the next ones
        assert ages[-1] < (2.0 if reliable else 0.5)


@pytest.mark.parametrize("reliable", [False, True])
async def test_a_camera_fills_no_queue_of_a_radio(reliable: bool) -> None:
    """20 Mbit/s with a queue of 0.16 s, asked for twice what it carries: small messages are young, and whole."""
    joints, scan = Live(1, 470, 100, reliable=reliable), Live(2, 4_000, 10, reliable=reliable)
    camera = Live(3, 60_000, 70, -1, reliable=reliable)
    async with publishing(radio(), 400_000, (joints, scan, camera)) as scene:
        await scene.passes(5)
        for route in (joints, scan):
            ages = scene.ages(route, since=2.0)
            assert ages[len(ages) // 2] < 0.08
            assert scene.part(route) > 0.9  # until the rate is found, the queue fills once
        assert sum(scene.shares(5)) > 0.75 * _BROAD
        assert scene.channel.air.dropped < (0.05 if reliable else 0.03) * scene.channel.air.sent


async def test_path_without_arrivals_holds_up_no_stream() -> None:
    """Datagrams in transit do so until they are written off. Sending resumes within 1 s of the first arrival."""
    scan, odom = Live(1, 1_000, 50), Live(2, 100, 10)
    async with publishing(radio(), 400_000, (scan,), (odom,)) as scene:
        air, loop = scene.channel.air, asyncio.get_running_loop()
        await scene.passes(5)
        air.blocked = True
        await scene.passes(4)
        sent, cut_at = air.sent, loop.time()
        await scene.passes(6)
        assert air.sent - sent < 6 * 2_048
        assert scene.near.scheduler.waits_for(loop.time()) == 0.0, "the link is not full"
        assert len(scene.ages(odom, since=cut_at)) >= 59
        assert scene.ages(odom, since=cut_at)[-1] < 0.2
        air.blocked = False
        before = len(scene.far.routes[1].arrived)
        await scene.passes(3)
        assert len(scene.far.routes[1].arrived) - before > 2 * scan.rate


async def test_a_link_with_room_delays_no_datagram() -> None:
    small, large = Live(1, 2_500, 1_000), Live(2, 1_000_000, 20)
    async with publishing(Radio(1e9, tunnel=8_000_000, delay=0.0002), 8_000_000, (small, large)) as scene:
        await scene.passes(3)
        assert scene.part(small) > 0.999
        assert scene.part(large) > 0.96
        half = scene.ages(small, since=1.0)
        assert half[len(half) // 2] < 0.001


async def test_late_receipt_may_lower_missing_count_only() -> None:
    async with connected(Route(1, outgoing=True), open_streams=tunnel().open) as (near, _):
        carrier = DatagramCarrier(Mock(), near.scheduler)
        for datagrams, missing in ((10, 5), (0, -1)):
            carrier.count(datagrams, missing)
            carrier.receipt(Receipt(1_000_000, 0, ()))
        assert near.scheduler.arrived == 0
