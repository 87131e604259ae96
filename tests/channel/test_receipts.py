"""The times at which the receiver of datagrams sends receipts, and what is in them."""

from __future__ import annotations

import asyncio

import pytest
from tests.channel.datagram_radio import datagrams_between, pass_time
from tests.channel.sides import Radio, Route, connected

from rsb_bridge.transport.transport import RECEIVE_BUFFER

pytestmark = pytest.mark.usefixtures("loop")
_SMALL = 200_000


async def test_a_link_with_room_has_few_receipts() -> None:
    """One asked for every 0.25 s, and one a second for all later messages, however many routes there are."""
    routes = [Route(number, outgoing=True) for number in range(1, 8)]
    radio = Radio(1e8, delay=0.001)
    numbers = range(1, 8)
    async with connected(*routes, open_streams=radio.open, elsewhere=numbers) as (near, far):
        channel = datagrams_between(near, far, radio, *numbers, queue=1_000_000)
        for _ in range(10):
            for route in routes:
                route.send(bytes(100))
            await pass_time(1.0, near, far, channel)
        before = channel.air.far.air.sent
        for _ in range(10):
            for route in routes:
                route.send(bytes(100))
            await pass_time(1.0, near, far, channel)
        assert channel.air.far.air.sent - before <= 10 * 4
        assert [len(route.arrived) for route in far.routes.values()] == [20] * 7
        await pass_time(1.0, near, far, channel)
        assert near.in_transit() == 0


async def test_sender_soon_hears_of_larger_buffer() -> None:
    route = Route(1, outgoing=True)
    radio = Radio(1e8, delay=0.001)
    async with connected(route, open_streams=radio.open, elsewhere=(1,)) as (near, far):
        channel = datagrams_between(near, far, radio, 1, queue=1_000_000)
        there = channel.air.far
        there.air.receive_buffer = there.receive_buffer = _SMALL
        route.send(bytes(1000))
        await pass_time(1.0, near, far, channel)
        assert channel.sending().pacer.window == _SMALL // 2
        there.air.receive_buffer = RECEIVE_BUFFER
        await pass_time(1.0, near, far, channel)
        route.send(bytes(1000))
        await pass_time(1.0, near, far, channel)
        assert channel.sending().pacer.window == RECEIVE_BUFFER // 2


async def test_small_messages_of_a_young_topic_wait_for_no_tick() -> None:
    """Their headers are most of what fills the first window, after a quarter of which a receipt is asked for."""
    route = Route(1, outgoing=True)
    radio = Radio(1e8, delay=0.001)
    async with connected(route, open_streams=radio.open, elsewhere=(1,)) as (near, far):
        datagrams_between(near, far, radio, 1, queue=1_000_000)
        for _ in range(400):
            route.send(bytes(12))
            await asyncio.sleep(0.0025)
        assert len(far.routes[1].arrived) > 390
        assert not near.routes[1].waiting
