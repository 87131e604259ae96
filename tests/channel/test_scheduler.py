"""Routes that share a link: who sends next, how much is in transit, and how late messages are."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING

import pytest
from tests.channel.sides import Radio, Route, connected, pass_seconds
from tests.support.constants import STREAM_DEAD_AFTER

from rsb_bridge.transport.streams import StreamHandler

if TYPE_CHECKING:
    from tests.channel.sides import Side

    from rsb_bridge.channel.data_stream import DataStream

pytestmark = pytest.mark.usefixtures("loop")
_PACE = 50_000
"""Bytes/s of the radio."""


def now() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize(("pace", "within"), [(_PACE, 0.3), (14 * _PACE, 0.05)])
async def test_a_joystick_goes_before_maps(pace: int, within: float, two: bool) -> None:
    """However fast the radio is: a map takes 2 and 0.14 s."""
    joystick, maps = Route(1, outgoing=True), [Route(each, always=100_000, outgoing=True) for each in (2, 3)]
    async with connected(joystick, *maps, two=two, open_streams=Radio(pace).open) as (near, far):
        for each in maps:
            each.flush()
        await pass_seconds(10, near, far)
        late: list[float] = []
        for _ in range(50):
            sent = now()
            joystick.send(bytes(80))
            await asyncio.sleep(0.3)
            late += [when - sent for _, when in far.routes[1].arrived]
            far.routes[1].arrived.clear()
        assert len(late) == 50
        assert max(late) < within, max(late)


@pytest.mark.parametrize(("two", "tunnel"), [(False, 0), (True, 200_000)])
async def test_greedy_routes_get_equal_shares(two: bool, tunnel: int) -> None:
    """With two streams on a path that takes more than it carries; elsewhere the kernel shares between them."""
    routes = [
        Route(1, always=100_000, outgoing=True),
        Route(2, always=5_000, outgoing=True),
        Route(3, always=1_000, outgoing=True),
    ]
    async with connected(*routes, two=two, open_streams=Radio(_PACE, tunnel=tunnel).open) as (near, far):
        for each in routes:
            each.flush()
        await pass_seconds(60, near, far)
        shares = [each.bytes_since(0) for each in far.routes.values()]
        assert min(shares) > 0.85 * max(shares), shares
        assert sum(shares) > 0.9 * 60 * _PACE


async def test_late_comer_gets_nothing_for_its_silence() -> None:
    early, late = Route(1, always=5_000, outgoing=True), Route(2, outgoing=True)
    async with connected(early, late, open_streams=Radio(_PACE).open) as (near, far):
        early.flush()
        await pass_seconds(60, near, far)
        joined = now()
        late.always = 5_000
        late.flush()
        await pass_seconds(10, near, far)
        assert far.routes[1].bytes_since(joined) > 0.8 * far.routes[2].bytes_since(joined) > 0


@pytest.mark.parametrize("two", [False, True])
async def test_sending_while_nothing_waited_costs_nothing_later(two: bool) -> None:
    """A topic that has flowed for minutes goes on while a new one floods the link."""
    early, late = Route(1, outgoing=True), Route(2, outgoing=True)

    async def talk(near: Side, far: Side, seconds: int) -> None:
        for step in range(20 * seconds):
            early.send(bytes(1_000))
            await asyncio.sleep(0.05)
            if step % 20 == 0:
                near.tick()
                far.tick()

    async with connected(early, late, two=two, open_streams=Radio(_PACE).open) as (near, far):
        await talk(near, far, 120)
        late.always = 5_000
        late.flush()
        before = len(far.routes[1].arrived)
        await talk(near, far, 10)
        assert len(far.routes[1].arrived) - before > 180


@pytest.mark.parametrize("tunnel", [0, 200_000])
async def test_shares_follow_priorities_and_nobody_starves(tunnel: int) -> None:
    """Through a tunnel, too, that takes more than it carries."""
    routes = [Route(1, 1, 5_000, outgoing=True), Route(2, 0, 5_000, outgoing=True), Route(3, -1, 5_000, outgoing=True)]
    async with connected(*routes, open_streams=Radio(_PACE, tunnel=tunnel).open) as (near, far):
        for each in routes:
            each.flush()
        await pass_seconds(120, near, far)
        high, normal, low = (each.bytes_since(30) for each in far.routes.values())
        assert 3.0 < high / normal < 5.0
        assert 3.0 < normal / low < 5.0


@pytest.mark.parametrize("rate", [5_000, 50_000, 2_500_000])
async def test_what_fits_is_fresh_beside_what_does_not(rate: int) -> None:
    """Through a tunnel that holds bytes for many seconds, with images that would take several times the link."""
    small, images = Route(1, outgoing=True), Route(2, always=40_000, outgoing=True)
    radio = Radio(rate, tunnel=4_000_000, delay=0.02)
    async with connected(small, images, open_streams=radio.open) as (near, far):
        images.flush()
        await pass_seconds(15, near, far)
        sent: list[float] = []
        for step in range(100):
            sent.append(now())
            small.send(bytes(100))
            await asyncio.sleep(0.1)
            if step % 10 == 9:
                near.tick()
                far.tick()
        await pass_seconds(2, near, far)
        late = sorted(when - at for (_, when), at in zip(far.routes[1].arrived, sent, strict=True))
        assert late[len(late) // 2] < 1.0  # half of the window times of 0.2 to 0.8 s, and one chunk
        assert late[-1] < 2.0


async def test_full_stream_costs_other_one_no_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside images that always wait for their stream, nearly all small messages leave at once, and in order."""
    small, images = Route(1, outgoing=True), Route(2, always=40_000, outgoing=True)
    async with connected(small, images, open_streams=Radio(2_500_000, tunnel=100_000, delay=0.02).open) as (near, far):
        images.flush()
        await pass_seconds(5, near, far)
        asked: list[float] = []
        ask = small.channel.ask

        def noted() -> None:
            asked.append(now())
            ask()

        monkeypatch.setattr(small.channel, "ask", noted)
        for number in range(100):
            assert near.scheduler.waits_since < math.inf
            small.send(bytes([number]))
            await asyncio.sleep(0.013)
        await pass_seconds(1, near, far)
        assert len(asked) < 20
        assert far.routes[1].payloads == [bytes([number]) for number in range(100)]


@pytest.mark.parametrize(("every", "full"), [(0.5, False), (0.1, True)])
async def test_never_empty_queue_is_told_apart(every: float, full: bool) -> None:
    """A route alone, with messages that take 0.2 s each; by turns, it is in the queue and is not."""
    route = Route(1, outgoing=True)
    async with connected(route, open_streams=Radio(_PACE).open) as (near, far):
        waits: list[float] = []
        for _ in range(200):
            route.send(bytes(10_000))
            await asyncio.sleep(every)
            near.tick()
            far.tick()
            waits.append(near.scheduler.waits_for(now()))
        assert route.channel.behind(now()) is full
        assert (min(waits[100:]) > 1.0) is full
        assert full or max(waits) < every


async def test_sizes_follow_when_nothing_waits_any_more() -> None:
    """A busy link sends in small pieces, and the receipt with which nothing waits any more finds it busy."""
    maps = Route(1, always=100_000, outgoing=True)
    async with connected(maps, open_streams=Radio(14 * _PACE).open) as (near, far):
        maps.flush()
        await pass_seconds(20, near, far)
        scheduler, busy = near.scheduler, near.scheduler.chunk
        maps.always = 0
        while scheduler.waits_since < math.inf:  # noqa: ASYNC110 (of virtual time; nothing tells that moment)
            await asyncio.sleep(0.001)
        idle = scheduler.chunk
        scheduler.choose_sizes()
        assert idle == scheduler.chunk > busy


class Holding(StreamHandler):
    """Keeps the frames of a data stream until `release`."""

    def __init__(self, stream: DataStream) -> None:
        self._stream = stream
        self._kept: list[bytes] = []
        stream.stream.handler = self

    def received(self, data: bytes) -> None:
        self._kept.append(data)

    def release(self) -> None:
        self._stream.stream.handler = self._stream
        for each in self._kept:
            self._stream.received(each)


async def test_stalled_stream_does_not_hold_other_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It fills the window of both. It takes nothing more meanwhile, and no byte is counted twice once it goes on."""
    STREAM_DEAD_AFTER.set(monkeypatch, 60.0)  # it is not given up yet
    small, images = Route(1, outgoing=True), Route(2, always=40_000, outgoing=True)

    async def talk(near: Side, far: Side) -> list[float]:
        """The latencies of 100 messages, sorted."""
        before = len(far.routes[1].arrived)
        sent: list[float] = []
        for _ in range(100):
            sent.append(now())
            small.send(bytes(100))
            await asyncio.sleep(0.1)
            if len(sent) % 10 == 0:
                near.tick()
                far.tick()
        came = far.routes[1].arrived[before:]
        return sorted(when - at for (_, when), at in zip(came, sent, strict=True))

    async with connected(small, images, open_streams=Radio(_PACE).open) as (near, far):
        images.flush()
        await pass_seconds(20, near, far)
        near_large, far_large = near.pair.large, far.pair.large
        assert near_large is not None
        assert far_large is not None
        holding = Holding(far_large)
        await pass_seconds(5, near, far)
        stuck = near_large.sent
        late = await talk(near, far)
        assert late[-1] < 1.5  # the first ones wait for the next look, once a second
        assert late[85] < 0.1
        assert (near_large.sent, near_large.in_transit) == (stuck, 0)
        holding.release()
        came = len(far.routes[2].arrived)
        await pass_seconds(10, near, far)
        assert len(far.routes[2].arrived) > came + 5
        images.always = 0
        await pass_seconds(10, near, far)
        assert near.in_transit() == near_large.in_transit == 0
        assert near_large.acknowledged == near_large.sent


async def test_without_receipts_little_is_in_transit() -> None:
    route = Route(1, always=1_000, outgoing=True)
    async with connected(route, open_streams=Radio(1e6).open) as (near, far):
        near.deaf = True
        route.flush()
        await pass_seconds(10, near, far)
        assert 0 < near.in_transit() <= 8 * 1024
        assert not near.routes[1].channel.via.moves


async def test_rare_receipts_are_no_full_link() -> None:
    """The receipts of a topic that becomes rarer come once a second, with another stream's."""
    small, large = Route(1, outgoing=True), Route(2, outgoing=True)
    async with connected(small, large, open_streams=Radio(1e9, kernel=1 << 20, delay=0.001).open) as (near, far):
        windows = []
        for step in range(1500):  # 20 ms each
            small.send(bytes(100))
            if step % (6 if step < 500 else 17) == 0:
                large.send(bytes(600_000))
            if step % 50 == 0:
                near.tick()
            if step % 50 == 25:
                far.tick()
            await asyncio.sleep(0.02)
            windows.append(near.scheduler.grows)
        assert all(windows)
