"""Streams that are lost while the link stays: routes go on on the next ones, with each message once and in order."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.channel.numbered_messages import CUT, Numbers, reopen, stream_of
from tests.channel.sides import Route, connected
from tests.support.connection_keys import connection_keys
from tests.support.constants import STREAM_DEAD_AFTER, STREAM_STALLED_AFTER
from tests.support.coroutines import until

from rsb_bridge.channel.data_stream import LARGE
from rsb_bridge.model.fates import ARM_REQUIRED, BEST_EFFORT, RELIABLE
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.framing import DataWriter
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from rsb_bridge.wire.sealing import Role


@pytest.fixture(autouse=True)
def _late_to_notice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a busy machine stand still between a message and the loss of its stream, whose routes would be closed."""
    STREAM_STALLED_AFTER.set(monkeypatch, 60.0)


@pytest.mark.parametrize("sends_again", [True, False])
@pytest.mark.parametrize("cut_by", [0, 1])
@pytest.mark.parametrize(("name", "size"), [("small", 2_000), ("large", LARGE), ("large", 1 << 20)])
async def test_route_resumes_in_order(name: str, size: int, cut_by: int, sends_again: bool) -> None:
    """Three times, amid messages, and noticed by either side first. What is not sent again is counted."""
    async with connected(Route(1, outgoing=True), Route(2, outgoing=True)) as sides:
        near, far = sides
        near.routes[1].fates = RELIABLE if sends_again else BEST_EFFORT
        numbers, others = Numbers(near, 1, size), Numbers(near, 2, 100)
        for _ in range(3):
            numbers.send(40)
            others.send(40)
            await until(lambda: numbers.arrived and others.arrived)
            await far.acknowledges_all()
            numbers.send(20)
            stream_of(sides[cut_by], name).stream.abort("cut")
            await until(lambda: all(stream_of(side, name).over for side in sides))
            numbers.send(10)
            others.send(10)
            await reopen(near, far, names=("small", "large") if name == "small" else ("large",))
            await far.ticks_until(numbers.all_known)
            await far.ticks_until(others.all_known)
            for each in (numbers, others):
                assert each.arrived == sorted(set(each.arrived))
                assert each.counted == each.sent
        assert len(others.arrived) == others.sent
        assert len(numbers.arrived) == numbers.sent or not sends_again
        assert not any(route.lost for side in sides for route in side.routes.values())
        assert near.reopened == 3
        assert far.keys.budget.held == 0
        await far.acknowledges_all()


async def test_route_survives_loss_of_its_new_stream() -> None:
    """The receiving end has noticed the loss of the large stream before the last frame on the small one."""
    async with connected(Route(1, outgoing=True), Route(2, outgoing=True)) as (near, far):
        numbers, others = Numbers(near, 1, LARGE), Numbers(near, 2, LARGE)
        others.send(1)  # a stream on which nothing got through would be given up
        await until(others.all_known)
        await far.acknowledges_all()
        far.pair.lose(stream_of(far, "large"), CUT)
        numbers.send(1)
        await until(lambda: far.routes[1].channel.uses(stream_of(far, "large")))
        assert far.routes[1].channel.is_suspended
        await reopen(near, far, names=("large",))
        numbers.send(3)
        await far.ticks_until(numbers.all_known)
        assert numbers.arrived == [0, 1, 2, 3]


@pytest.mark.parametrize("name", ["small", "large"])
async def test_stream_that_passes_nothing_ends(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Something acknowledges its bytes, and keeps them. If the control connection is silent, too, it may be a gap."""
    STREAM_DEAD_AFTER.set(monkeypatch, 0.2)
    async with connected(Route(1, outgoing=True)) as (near, far):
        numbers = Numbers(near, 1, LARGE if name == "large" else 100)
        numbers.send(2)
        await far.acknowledges_all()
        stream_of(far, name).stream.pause_reading()
        numbers.send(1)
        for _ in range(30):
            near.pair.tick(control_quiet=3.0)
            await asyncio.sleep(0.01)
        assert not stream_of(near, name).over
        async with asyncio.timeout(60):
            while not stream_of(near, name).over:
                near.pair.tick()
                await asyncio.sleep(0.01)
        await until(lambda: stream_of(far, name).over)


async def test_waiting_is_sent_begun_starts_anew() -> None:
    """Nothing that has not left is lost: here, nothing at all has."""
    async with connected(Route(1, outgoing=True)) as (near, far):
        numbers = Numbers(near, 1, 1 << 20)
        numbers.send(1)
        await far.acknowledges_all()
        stream_of(far, "large").stream.pause_reading()
        numbers.send(8)
        await until(lambda: stream_of(near, "large").congested)
        stream_of(near, "large").stream.abort("cut")
        stream_of(far, "large").stream.abort("cut")
        await until(lambda: near.reopened)
        assert near.routes[1].channel.trouble()
        await reopen(near, far, names=("large",))
        await until(lambda: len(numbers.arrived) == 9)
        assert not near.routes[1].channel.trouble()
        assert far.routes[1].channel.counts().lost == 0


async def test_routes_that_must_not_go_on_are_closed() -> None:
    armed, topic = Route(1, outgoing=True), Route(3, outgoing=True)
    async with connected(armed, topic) as sides:
        for side in sides:
            side.routes[1].fates = ARM_REQUIRED
        stream_of(sides[0], "small").stream.abort("cut")
        await until(lambda: all(side.reopened for side in sides))
        assert sides[0].routes[1].lost == ["cut"]
        for side in sides:
            assert side.routes[1].lost
            assert not side.routes[3].lost


@pytest.mark.parametrize("names", [("large",), ("small", "large")])
async def test_calls_go_on_both_ways(names: tuple[str, ...]) -> None:
    """One way has large messages, the other only small ones, which are amid a message when the large stream is lost."""
    async with connected(Route(1, outgoing=True, duplex=True)) as (near, far):
        there, back = Numbers(near, 1, 1 << 20), Numbers(far, 1, LARGE - 1)
        for _ in range(3):
            there.send(5)
            back.send(5)
            await until(lambda: there.arrived and back.arrived)
            there.send(5)
            back.send(5)
            stream_of(near, names[0]).stream.abort("cut")
            await until(lambda: all(stream_of(side, names[0]).over for side in (near, far)))
            there.send(5)
            back.send(5)
            await reopen(near, far, names=names)
            for numbers, by in ((there, far), (back, near)):
                await by.ticks_until(numbers.all_known)
                assert numbers.arrived == [*range(numbers.sent)]


async def test_what_waits_for_another_stream_is_not_acknowledged(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is gone with the stream that it came on."""
    async with connected(Route(1, outgoing=True), Route(2, outgoing=True)) as (near, far):
        others = Numbers(near, 2, LARGE)
        others.send(1)  # a stream on which nothing got through would be given up
        await far.acknowledges_all()
        before = stream_of(near, "large").acknowledged
        stream_of(far, "small").stream.pause_reading()  # on which the route says that it moves to the large one
        numbers = Numbers(near, 1, LARGE)
        numbers.send(1)
        await far.holds("large", monkeypatch)
        far.tick()
        assert stream_of(far, "large").counter.count < before + LARGE
        stream_of(far, "large").stream.abort("cut")
        await until(lambda: stream_of(near, "large").over)
        stream_of(far, "small").stream.resume_reading()
        await reopen(near, far, names=("large",))
        await far.ticks_until(numbers.all_known)
        assert numbers.arrived == [0]


async def test_nobody_asks_for_streams_that_no_route_needs() -> None:
    async with connected(Route(1, outgoing=True)) as sides:
        for side in sides:
            side.routes[1].fates = ARM_REQUIRED
        stream_of(sides[0], "small").stream.abort("cut")
        await until(lambda: all(side.pair.over for side in sides))
        assert not any(side.reopened for side in sides)


async def test_streams_lost_repeatedly_come_later() -> None:
    """Three times at once, as both sides see the ends of both streams one by one, and then after longer and longer."""
    async with connected(Route(1, outgoing=True)) as sides:
        near, far = sides
        numbers = Numbers(near, 1, 100)
        for attempts in range(1, 7):
            numbers.send(1)
            stream_of(near, "small").stream.abort("cut")
            await until(lambda: all(stream_of(side, "small").over for side in sides))
            assert near.reopened == min(attempts, 3)
            await reopen(*sides)
        await far.ticks_until(numbers.all_known)
        assert numbers.arrived == [*range(6)]
        before = near.reopened
        stream_of(near, "small").stream.abort("cut")
        await until(lambda: near.pair.lacks()[0])
        near.tick()
        assert near.reopened == before
        near.ahead += 10.0
        near.tick()
        assert near.reopened == before + 1
        assert not any(side.routes[1].lost for side in sides)


@pytest.mark.parametrize("names", [("large", "small"), ("small", "large")])
@pytest.mark.parametrize("reopens", [False, True])
async def test_both_lost_with_messages_in_transit(
    names: tuple[str, str], reopens: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing got through before, for longer than a stream stalls: it says nothing about the next ones."""
    STREAM_STALLED_AFTER.set(monkeypatch, 1.0)
    async with connected(Route(1, outgoing=True), Route(2, outgoing=True)) as (near, far):
        small, large = Numbers(near, 1, 100), Numbers(near, 2, LARGE)
        for _ in range(3):
            for each in (small, large):
                each.send(2)
                await far.ticks_until(each.all_known)
            await far.acknowledges_all()
            for name in names:
                if not stream_of(far, name).over:
                    stream_of(far, name).stream.pause_reading()
                small.send(5)
                large.send(5)
                near.ahead += 3.0
                for side in (near, far):
                    side.pair.lose(stream_of(side, name), CUT)
                if reopens:
                    await reopen(near, far, names=("small", "large") if name == "small" else ("large",))
            await reopen(near, far)
            for each in (small, large):
                await far.ticks_until(each.all_known)
                assert each.arrived == [*range(each.sent)]
        assert not any(route.lost for side in (near, far) for route in side.routes.values())


@pytest.mark.parametrize("ever", [False, True])
async def test_streams_that_deliver_nothing_are_down(ever: bool) -> None:
    """A route waits as long as the association would, but operators hear of it before."""
    async with connected(Route(1, outgoing=True)) as (near, far):
        channel = near.routes[1].channel
        if ever:
            near.routes[1].send(b"x")
            await far.acknowledges_all()
        for seconds, state in ((0.0, None), (9.0, None), (2.0, State.DOWN), (40.0, State.DOWN)):
            near.ahead += seconds
            stream_of(far, "small").stream.pause_reading()
            near.routes[1].send(b"x")
            near.pair.tick()
            verdict = channel.trouble()
            assert (verdict and verdict.state) is state
            near.pair.lose(stream_of(near, "small"), CUT)
            near.pair.tick()
            assert channel.trouble().state is (state or State.WAITING)
            await reopen(near, far)
        assert not near.routes[1].lost
        near.ahead += 10.0
        near.routes[1].send(b"x")
        near.pair.lose(stream_of(near, "small"), CUT)
        assert near.routes[1].lost == ["cut"]


async def test_lost_large_stream_spares_routes_of_small_one() -> None:
    """The client knew only of the loss of the large one when it opened it; the server knew of both."""
    async with connected(Route(1, outgoing=True), Route(3, outgoing=True)) as (near, far):
        near.routes[3].send(bytes(LARGE))
        await far.acknowledges_all()
        far.pair.lose(stream_of(far, "small"), CUT)
        await reopen(near, far, names=("large",))
        far.pair.lose(stream_of(far, "large"), CUT)
        await until(lambda: near.pair.lacks()[1])
        near.pair.lose(stream_of(near, "small"), CUT)
        await reopen(near, far)
        assert not any(route.lost for side in (near, far) for route in side.routes.values())


async def test_waiting_messages_avoid_stream_that_ends_too() -> None:
    async with connected(Route(1, outgoing=True), Route(3, outgoing=True)) as (near, far):
        near.routes[3].send(bytes(LARGE))
        await far.acknowledges_all()
        for name in ("small", "large"):
            stream_of(far, name).stream.pause_reading()
        near.routes[1].always = 100
        near.routes[3].always = 20_000
        for route in near.routes.values():
            route.flush()
        large = stream_of(near, "large")
        before = large.sent
        near.pair.lose(stream_of(near, "small"), CUT)
        assert large.sent == before


async def test_streams_that_do_not_come_are_given_up() -> None:
    async with connected(Route(1, outgoing=True)) as (near, _):
        stream_of(near, "small").stream.abort("cut")
        await until(lambda: near.reopened)
        for seconds, state in ((0.0, State.WAITING), (11.0, State.DOWN), (59.0, State.DOWN)):
            near.ahead = seconds
            near.tick()
            assert near.routes[1].channel.trouble().state is state
            assert not near.routes[1].lost
        near.ahead = 61.0
        near.tick()
        assert near.routes[1].lost == ["cut"]


@pytest.mark.parametrize("breach", ["against the route", "too many", "an earlier one"])
async def test_peer_that_resumes_wrongly_loses_stream(breach: str) -> None:
    async with connected(Route(1, outgoing=True)) as (near, far):
        role: Role = "server" if breach == "against the route" else "client"
        keys = connection_keys(CipherSuite.AESGCM, bytes(range(32)), routes=(1,))
        writer = DataWriter(keys.route_sealer(1, role), 1)
        sender, receiver = (far, near) if role == "server" else (near, far)
        out = stream_of(sender, "small").stream
        resumed = writer.write_resumed()
        if breach == "too many":
            writer.messages = 2**53 + 1
        elif breach == "an earlier one":
            out.write(resumed)
        out.write(resumed if breach == "an earlier one" else writer.write_resumed())
        await until(lambda: receiver.routes[1].lost)
