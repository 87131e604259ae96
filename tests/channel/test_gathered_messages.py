"""Messages of several routes that come in one moment: they leave by one write, and nothing else changes."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import cycle
from typing import TYPE_CHECKING

import pytest
from tests.channel.numbered_messages import CUT, Numbers, reopen, stream_of
from tests.channel.sides import Route, connected
from tests.support.coroutines import until

from rsb_bridge.channel.data_stream import LARGE
from rsb_bridge.transport.streams import JoinedWrites

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.channel.sides import Side


@contextmanager
def one_moment(side: Side) -> Iterator[JoinedWrites]:
    """Have what routes send meanwhile leave together, as `RosToLoopQueue` does."""
    joined = JoinedWrites()
    joined.is_open = True
    for each in side.pair.streams():
        each.stream.joined = joined
    yield joined
    joined.send_all()


def routes() -> list[Route]:
    return [Route(number, outgoing=True) for number in (1, 2, 3)]


async def test_messages_of_a_moment_leave_by_one_write(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[int] = []
    async with connected(*routes()) as (near, far):
        stream = stream_of(near, "small")
        write = stream.stream.write

        def noted(data: bytes) -> None:
            written.append(len(data))
            write(data)

        monkeypatch.setattr(stream.stream, "write", noted)
        with one_moment(near):
            for route in near.routes.values():
                route.send(b"first")
            near.routes[1].send(b"second")
            assert not written
            assert near.scheduler.gathered == 3 * len(b"first") + len(b"second")
        assert written == [near.scheduler.sent]
        assert near.scheduler.gathered == 0
        await until(lambda: all(route.arrived for route in far.routes.values()))
        await far.acknowledges_all()
        assert far.routes[1].payloads == [b"first", b"second"]


@pytest.mark.parametrize("size", [10_000, LARGE, 1 << 20])
async def test_turn_of_a_route_stays_behind_its_gathered_message(size: int) -> None:
    payloads = [b"before", bytes(size), b"behind"]
    async with connected(*routes()) as (near, far):
        with one_moment(near):
            for route in near.routes.values():
                route.send(*payloads)
        await far.ticks_until(lambda: all(len(route.arrived) == 3 for route in far.routes.values()))
        assert all(route.payloads == payloads for route in far.routes.values())


async def test_gathered_messages_outlive_their_stream() -> None:
    async with connected(*routes()) as (near, far):
        numbers = [Numbers(near, route, 100) for route in near.routes]
        for each in numbers:
            each.send(2)
        await until(lambda: all(each.all_known() for each in numbers))
        await far.acknowledges_all()
        with one_moment(near):
            for each in numbers:
                each.send(1)
            near.pair.lose(stream_of(near, "small"), CUT)
            for each in numbers:
                each.send(1)
        await reopen(near, far)
        for each in numbers:
            await far.ticks_until(each.all_known)
            assert each.arrived == [0, 1, 2, 3]
        await far.acknowledges_all()
        assert near.scheduler.gathered == 0


async def test_gathered_messages_fill_the_window() -> None:
    async with connected(*routes()) as (near, _):
        channel, limit = near.routes[1].channel, near.scheduler.window.limit
        with one_moment(near):
            while not channel.congested:
                near.routes[1].send(bytes(1000))
            assert limit <= near.scheduler.gathered < limit + 1000


async def test_streams_share_the_bytes_to_spare() -> None:
    async with connected(*routes()) as (near, far):
        near.routes[2].send(bytes(LARGE))  # moves it to the other stream
        await far.ticks_until(lambda: bool(far.routes[2].arrived))
        await far.acknowledges_all()
        channels = [near.routes[number].channel for number in (1, 2)]
        assert channels[0].via is not channels[1].via
        limit = near.scheduler.window.limit - near.scheduler.sent
        with one_moment(near):
            numbers = cycle((1, 2))
            while not any(each.congested for each in channels):
                near.routes[next(numbers)].send(bytes(1000))
            assert limit <= near.scheduler.gathered < limit + 1000
        assert not any(each.via.spare for each in channels)
        await far.acknowledges_all()
