"""Channels of routes on a pair of streams: order, turns, ends, and what a peer may not send."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.channel.sides import Route, connected
from tests.support.connection_keys import connection_keys
from tests.support.coroutines import until
from tests.support.frames import write_chunks, write_frame

from rsb_bridge.channel.data_stream import LARGE
from rsb_bridge.model.verdict import Cause
from rsb_bridge.transport.streams import PacketCounts
from rsb_bridge.wire.framing import DATA, HEADER, MOVED, DataWriter, pack_frame
from rsb_bridge.wire.messages import Receipts
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Role

STREAMS = pytest.mark.parametrize("two", [False, True])


def _writer(role: Role, route: int = 1) -> DataWriter:
    return DataWriter(
        connection_keys(CipherSuite.AESGCM, bytes(range(32)), routes=(1, 9)).route_sealer(route, role), route
    )


@STREAMS
async def test_both_sides_send_at_once_and_in_order(two: bool) -> None:
    """More than the streams take, and with the move to the stream of large messages in the middle."""
    sizes = (0, 1, 2048, LARGE - 1, 80, LARGE, 5 << 20, 80, 3 << 20, 17)
    payloads = [bytes([number]) * size for number, size in enumerate(sizes)]
    routes = [Route(number, outgoing=True, duplex=True) for number in (1, 3)]
    async with connected(*routes, two=two) as sides:
        for side in sides:
            for route in side.routes.values():
                route.send(*payloads)
        everything = [route for side in sides for route in side.routes.values()]
        await until(lambda: all(len(route.arrived) == len(payloads) for route in everything))
        for route in everything:
            assert route.payloads == payloads
            assert not route.lost
        for side in sides:
            assert side.keys.budget.held == 0
            side.tick()
        await until(lambda: all(side.in_transit() == 0 for side in sides))
        assert all(len(side.receipts) < 400 for side in sides)


async def test_receipt_due_by_shorter_interval_goes_at_once() -> None:
    """The sender's window may be full, so that no further bytes come before that receipt."""
    async with connected(Route(1, outgoing=True)) as (near, far):
        far.take_receipts(Receipts(every=((1, 5000),)))
        near.routes[1].send(bytes(1000))
        await until(lambda: far.routes[1].arrived)
        far.take_receipts(Receipts(every=((1, 2000),)))
        assert far.receipts == []
        far.take_receipts(Receipts(every=((1, 700),)))
        assert [each.received for each in far.receipts] == [((1, near.in_transit()),)]
        far.take_receipts(Receipts(every=((1, 700),)))
        assert len(far.receipts) == 1, "no byte has come since"


async def test_message_asked_for_goes_ahead_of_large_one() -> None:
    large, small = Route(1, outgoing=True, duplex=True), Route(2, outgoing=True, duplex=True)
    async with connected(large, small) as sides:
        for side in sides:
            side.routes[1].send(bytes(8 << 20))
            side.routes[2].send(b"asked")
        await until(lambda: all(side.routes[2].arrived for side in sides))
        assert not any(side.routes[1].arrived for side in sides)
        await until(lambda: all(side.routes[1].arrived for side in sides))


class Idle(Route):
    """A route that asks for turns, and has nothing to send."""

    def flush(self) -> None:
        self.channel.ask()


async def test_route_that_asks_in_vain_loses_turns() -> None:
    idle, other = Idle(1, outgoing=True), Route(2, outgoing=True)
    async with connected(idle, other) as (_, far):
        idle.channel.ask()
        other.send(b"after")
        await until(lambda: far.routes[2].arrived)
        assert not idle.channel.queued


@STREAMS
async def test_closed_end_sends_no_more_of_what_waits(two: bool) -> None:
    route, other = Route(1, outgoing=True), Route(2, outgoing=True)
    async with connected(route, other, two=two) as (_, far):
        route.send(bytes(8 << 20))
        route.channel.close("removed")
        del far.routes[1]
        far.closed.add(1)
        other.send(b"after")
        await until(lambda: far.routes[2].arrived)
        assert not route.channel.queued


async def test_incomplete_messages_count_until_the_channel_closes() -> None:
    async with connected(Route(1, outgoing=True), two=False) as (near, far):
        begun, *_ = write_chunks(_writer("client"), bytes(5000), 0, 0, 1000)
        near.pair.streams()[0].stream.write(begun)
        await until(lambda: far.keys.budget.held)
        far.routes[1].channel.close("removed")
        assert far.keys.budget.held == 0


@pytest.mark.parametrize("sealed_by", ["server", "nobody"])
async def test_broken_frame_ends_streams_with_all_routes(sealed_by: str) -> None:
    """A frame that the receiver could have sealed itself is no better: each direction has its own key."""
    frame = write_frame(_writer("server" if sealed_by == "server" else "client"), b"hello", 0)
    if sealed_by == "nobody":
        frame = frame[:-1] + bytes([frame[-1] ^ 1])
    async with connected(Route(1, outgoing=True, duplex=True), Route(2, outgoing=True)) as sides:
        near, far = sides
        near.pair.streams()[0].stream.write(frame)
        await until(lambda: far.pair.over and any(near.pair.lacks()))
        assert all(route.lost for route in far.routes.values())
        assert all(route.channel.trouble() for route in near.routes.values())  # they wait until they hear of that
        assert not far.routes[1].arrived
        assert [side.in_transit() for side in sides] == [0, 0]


@pytest.mark.parametrize(
    "frame",
    [
        write_frame(_writer("server"), b"the other way", 0),
        write_frame(_writer("server", 9), b"no such route", 0),
        pack_frame(HEADER.pack(7, 0, 1, 0)),
        pack_frame(HEADER.pack(MOVED, 0, 9, 0)),
        pack_frame(bytes([DATA])),
    ],
    ids=["against the route", "unknown route", "unknown kind", "moved unknown", "too short"],
)
async def test_peer_that_breaks_format_loses_streams(frame: bytes) -> None:
    async with connected(Route(1, outgoing=True)) as (near, far):
        far.pair.streams()[0].stream.write(frame)
        await until(lambda: near.routes[1].lost)


async def test_stuck_stream_is_trouble_of_its_routes_only(monkeypatch: pytest.MonkeyPatch) -> None:
    async with connected(Route(1, outgoing=True), Route(2, outgoing=True)) as (near, far):
        near.routes[1].send(bytes(LARGE))  # which moves it to the stream of large messages
        await until(lambda: len(far.routes[1].arrived) == 1)
        _, big = near.pair.streams()
        monkeypatch.setattr(big.stream, "packets", lambda: PacketCounts(4, 4, 0, LARGE, 4))
        near.pair.tick()
        trouble = near.routes[1].channel.trouble()
        assert (trouble and trouble.cause, near.routes[2].channel.trouble()) == (Cause.NO_PATH, None)
        monkeypatch.undo()
        near.pair.tick()
        assert near.routes[1].channel.trouble() is None


@pytest.mark.parametrize("large", [False, True])
async def test_route_moves_once_from_small_stream_only(large: bool) -> None:
    async with connected(Route(1, outgoing=True)) as (near, far):
        small, big = near.pair.streams()
        writer = _writer("client")
        small.stream.write(writer.write_moved())
        if large:
            big.stream.write(writer.write_moved())
        else:
            small.stream.write(writer.write_moved() + write_frame(writer, b"late", 0))
            big.stream.write(write_frame(_writer("client"), b"x", 0))  # sealed as the first frame, which it is not
        await until(lambda: far.routes[1].lost)


async def test_frames_wait_for_their_route_and_for_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control message that opens a channel comes by another stream, and so do frames before a move."""
    route, other = Route(1, outgoing=True), Route(2, outgoing=True)
    async with connected(route, other) as (near, far):
        far.routes[5] = Route(5, outgoing=False)
        near.routes[5] = Route(5, outgoing=True)
        near.carry(5)
        near.routes[5].send(b"early")
        other.send(b"behind")
        await far.holds("small", monkeypatch)
        assert not far.routes[2].arrived
        far.carry(5)
        await until(lambda: far.routes[2].arrived)
        assert far.routes[5].payloads == [b"early"]
        writer = _writer("client", 1)
        first, moved, second = write_frame(writer, b"1", 0), writer.write_moved(), write_frame(writer, b"2", 0)
        small, big = near.pair.streams()
        big.stream.write(second)
        await asyncio.sleep(0.02)
        assert not far.routes[1].arrived
        small.stream.write(first + moved)
        await until(lambda: len(far.routes[1].arrived) == 2)
        assert far.routes[1].payloads == [b"1", b"2"]


async def test_a_move_waits_for_its_route(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else comes first if the first message is a large one."""
    route = Route(1, outgoing=True)
    async with connected(route) as (near, far):
        near.routes[5], far.routes[5] = Route(5, outgoing=True), Route(5, outgoing=False)
        near.carry(5)
        near.routes[5].send(bytes(LARGE))
        await far.holds("small", monkeypatch)
        assert not far.pair.over
        far.carry(5)
        await until(lambda: far.routes[5].payloads == [bytes(LARGE)])


async def test_held_frames_of_closed_route_block_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    async with connected(Route(2, outgoing=True)) as (near, far):
        far.routes[5] = Route(5, outgoing=False)
        near.routes[5] = Route(5, outgoing=True)
        near.carry(5)
        near.routes[5].send(b"early")
        near.routes[2].send(b"behind")
        await far.holds("small", monkeypatch)
        del far.routes[5]
        far.closed.add(5)
        far.tick()
        await until(lambda: far.routes[2].arrived)


async def test_route_that_ends_while_taking_is_left_alone() -> None:
    async with connected(Route(1, outgoing=True)) as (near, far):
        route = far.routes[1]

        def deliver(messages: Iterable[Message]) -> None:
            route.channel.close("a message broke the format")
            del far.routes[1]
            far.closed.add(1)
            route.arrived += [(payload, 0.0) for payload, _, _ in messages]

        route.deliver = deliver  # type: ignore[method-assign]
        near.routes[1].send(bytes(2_000))
        await until(lambda: route.arrived)
        near.routes[1].send(bytes(2_000))
        await far.acknowledges_all()
        assert len(route.arrived) == 1
        assert not near.routes[1].lost
