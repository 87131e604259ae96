"""Reliable topics over datagrams: each message comes once and in order, in spite of losses."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from random import Random

import pytest
from tests.channel.datagram_radio import RadioChannel, RadioSocket, datagrams_between, pass_time
from tests.channel.sides import Radio, Route, Side, connected

from rsb_bridge.channel.channel import REOPENS
from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.reliable_datagrams import ReliableSender
from rsb_bridge.channel.udp_channel import PathProbe
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys

pytestmark = pytest.mark.usefixtures("loop")
_SIZES = (0, 10, 1_000, 1_400, 5_000, 60_000)


@asynccontextmanager
async def reliable(radio: Radio, queue: int = 1_000_000) -> AsyncIterator[tuple[Side, Side, RadioChannel, Route]]:
    """Connect a route by datagrams; yield both sides, the sending channel, and the sending end of the route."""
    route = Route(1, outgoing=True)
    async with connected(route, open_streams=radio.open, elsewhere=(1,)) as (near, far):
        yield near, far, datagrams_between(near, far, radio, 1, queue=queue), route


def message(number: int, size: int) -> bytes:
    return f"{number}".encode().ljust(max(size, 6), b".")


async def in_a_minute(far: Side, expected: list[bytes], *parts: Side | RadioChannel) -> None:
    for _ in range(60):
        if len(far.routes[1].arrived) >= len(expected):
            break
        await pass_time(1.0, far, *parts)
    assert far.routes[1].payloads == expected


@pytest.mark.parametrize("seed", range(8))
async def test_each_message_comes_once_and_in_order(seed: int) -> None:
    """Losses and delays of either way change all the time, and so does what the path takes."""
    random = Random(seed)
    expected = []
    async with reliable(Radio(2.5e6, delay=0.02)) as (near, far, channel, route):
        for number in range(300):
            for air in (channel.air, channel.air.far.air):
                if not random.randrange(20):
                    air.loss, air.late = random.choice((0.0, 0.1, 0.4)), random.choice((0.0, 0.0, 0.05))
            if not random.randrange(50):
                channel.air.mtu = random.choice((1472, 1300, 600))
            expected.append(message(number, random.choice(_SIZES)))
            route.send(expected[-1])
            await asyncio.sleep(random.choice((0.0, 0.001, 0.05)))
            if not random.randrange(10):
                channel.tick()
        for air in (channel.air, channel.air.far.air):
            air.loss = 0.1
        await in_a_minute(far, expected, near, channel)
        await pass_time(5.0, near, far, channel)
        sender = route.channel
        assert isinstance(sender, ReliableSender)
        assert not sender.waits
        assert not sender.unacknowledged
        assert near.in_transit() == 0
        assert far.keys.budget.held == 0


async def test_last_message_is_sent_again() -> None:
    """No later one shows that it is missing."""
    async with reliable(Radio(2.5e6, delay=0.02)) as (near, far, channel, route):
        route.send(b"first")
        await pass_time(2.0, near, far, channel)
        channel.air.blocked = True
        route.send(b"last")
        await asyncio.sleep(0.01)
        channel.air.blocked = False
        await asyncio.sleep(0.5)
        assert far.routes[1].payloads == [b"first", b"last"]


@pytest.mark.parametrize("every", [0.001, 0.02, 0.1, 0.3])
async def test_last_message_is_sent_again_beside_a_busy_route(every: float) -> None:
    """The other route's datagrams have receipts asked for all the time, which tell nothing of a route without news."""
    radio = Radio(2.5e6, delay=0.02)
    quiet, busy = Route(1, outgoing=True), Route(2, outgoing=True)
    async with connected(quiet, busy, open_streams=radio.open, elsewhere=(1, 2)) as (near, far):
        channel = datagrams_between(near, far, radio, 1, 2, queue=1_000_000)
        loop = asyncio.get_running_loop()

        async def talk(seconds: float) -> None:
            until, ticks = loop.time() + seconds, loop.time() + 1.0
            while loop.time() < until:
                busy.send(b"busy")
                await asyncio.sleep(every)
                if loop.time() >= ticks:
                    ticks += 1.0
                    for each in (near, far, channel, channel.air.far):
                        each.tick()

        quiet.send(b"first")
        await talk(2.0)
        channel.air.blocked = True
        quiet.send(b"last")
        await asyncio.sleep(0.01)
        channel.air.blocked = False
        await talk(5.0)
        assert far.routes[1].payloads == [b"first", b"last"]


async def test_nothing_is_sent_twice_without_a_loss() -> None:
    async with reliable(Radio(2.5e6, delay=0.02)) as (near, far, channel, route):
        route.send(*[message(number, 1_000) for number in range(100)])
        for number in range(100, 200):
            route.send(message(number, 1_000))
            await asyncio.sleep(0.01)
        await pass_time(2.0, near, far, channel)
        assert len(far.routes[1].arrived) == 200
        assert channel.air.sent <= 200 + 1  # the last one, which asked for no receipt


@pytest.mark.parametrize("seconds", [1.0, 10.0, 100.0])
async def test_messages_wait_for_a_path(seconds: float) -> None:
    """They wait in the route's queue: meanwhile, the channel sends and keeps little."""
    expected: list[bytes] = []
    async with reliable(Radio(2.5e6, delay=0.02)) as (near, far, channel, route):

        async def publish(count: int) -> None:
            for _ in range(count):
                expected.append(message(len(expected), 500))
                route.send(expected[-1])
                await asyncio.sleep(0.02)

        await publish(100)
        channel.air.blocked = True
        before = channel.air.sent
        publishing = asyncio.ensure_future(publish(int(seconds * 50)))
        await pass_time(seconds, near, far, channel)
        assert channel.air.sent - before < 100 + seconds * 6
        channel.air.blocked = False
        await pass_time(3.0, near, far, channel)
        await publishing
        await in_a_minute(far, expected, near, channel)


@pytest.mark.parametrize("whole", [False, True])
async def test_route_resumes_with_other_keys(whole: bool) -> None:
    """After the link's loss, small messages and one in pieces go on over the next connection's UDP channel."""
    radio = Radio(2.5e6, delay=0.02)
    expected = [message(number, size) for number, size in enumerate((10, 10, 60_000, 10, 10))]
    async with reliable(radio) as (near, far, channel, route):
        route.send(*expected[:2])
        await pass_time(2.0, near, far, channel)
        channel.air.loss = 0.0 if whole else 0.3
        channel.air.far.air.blocked = True  # what has come stays unknown
        route.send(*expected[2:])
        await asyncio.sleep(0.2)
        ends = [(side, side.routes[1].channel) for side in (near, far)]
        channel.close()
        channel.air.far.close()
        export = bytes(31) + b"2"
        sockets = [RadioSocket(radio, way, 1_000_000) for way in (0, 1)]
        for side, _ in ends:
            keys = ConnectionKeys(CipherSuite.AESGCM, export, b"link two")
            keys.resumed((1,))
            side.keys = DataKeys(keys, side.keys.role, Budget(64 << 20))
            side.probe = PathProbe(side.keys)
        channels = [RadioChannel(air, side) for air, (side, _) in zip(sockets, ends, strict=True)]
        for here, there in (channels, channels[::-1]):
            here.air.far = there
        for (side, end), opened in reversed([*zip(ends, channels, strict=True)]):
            assert end.ready
            end.resume(opened, side.keys)
            # What is published before the new path is found waits for it.
            opened.ready = False
            assert (end.ready, end.trouble()) == (True, Verdict(State.WAITING, Cause.AWAITS_LINK, REOPENS))
            opened.ready = True
            assert end.trouble() is None
        near.scheduler.run()
        await in_a_minute(far, expected, near, channels[0])
        route.send(b"after")
        await pass_time(1.0, near, far, channels[0])
        assert far.routes[1].payloads[-1] == b"after"


async def test_what_has_no_room_is_not_acknowledged() -> None:
    """Messages that a missing one holds up fill the receiver's memory; then it opens no more of them."""
    async with reliable(Radio(2.5e6, delay=0.02)) as (near, far, channel, route):
        route.send(b"first")
        await pass_time(2.0, near, far, channel)
        far.keys.budget.limit = 20_000
        channel.air.blocked = True
        route.send(b"missing")
        await asyncio.sleep(0.001)
        channel.air.blocked = False
        later = [message(number, 4_000) for number in range(20)]
        for each in later:
            route.send(each)
            await asyncio.sleep(0.001)
            assert far.keys.budget.held <= 20_000 + 8_000
        await in_a_minute(far, [b"first", b"missing", *later], near, channel)
