"""Services over a bridge, in worlds where nothing happens but what is made to happen."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING, Any, cast
from unittest.mock import patch

import pytest
from tests.simulation.beds import until
from tests.simulation.call_harness import SETTLED, TYPE, CallHarness, ScriptedClient, ScriptedServer
from tests.simulation.mutations import nothing
from tests.simulation.ros import hash_of
from tests.support import constants, replaced
from tests.support.inside import pending_calls
from tests.support.long import long

from rsb_bridge.channel.data_stream import StreamDuplex
from rsb_bridge.link.link import Link
from rsb_bridge.model.commands import ArmTopic, DisarmTopic, PauseTopics
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.peer_budget import CallLimits

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.route.calls.caller import Caller
    from rsb_bridge.route.calls.pending_calls import PendingCall
    from rsb_bridge.route.calls.provider import Provider

_WITHDRAWN_WITHIN = 1.0


def under_way(half: Caller | Provider) -> list[PendingCall]:
    return [call for _, call in pending_calls(half).items()]


async def asked(harness: CallHarness) -> tuple[ScriptedServer, ScriptedClient]:
    """Start a server that waits, and a client that has called it."""
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    client.ask()
    await until(lambda: server.asked, 1.0)
    return server, client


def say(harness: CallHarness) -> tuple[tuple[State, str], tuple[State, str]]:
    """State and cause, on the callers' side and on the other."""
    near, far = harness.shown()
    return (near.state, near.cause), (far.state, far.cause)


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.parametrize("seed", [1, *long(2, 3)])
async def test_many_calls_are_answered_in_any_order(seed: int, provider: str, harness: CallHarness) -> None:
    server, clients = harness.server(waits=True), [harness.client(f"/client{n}") for n in range(5)]
    for client in clients:
        await harness.ready(client)
    for _ in range(200):
        for client in clients:
            client.ask()
    await until(lambda: len(server.asked) == 1000, 5.0)
    near, far = harness.counted()
    assert near.in_flight == far.in_flight == 1000
    server.answer(Random(seed).shuffle)
    await until(lambda: sum(client.right for client in clients) == 1000, 5.0)
    near, far = harness.counted()
    assert near.answered == far.answered == 1000
    await asyncio.sleep(SETTLED)
    near, far = harness.counted()
    assert near.node_p50 == pytest.approx(far.node_p50, abs=1e-6)
    assert near.way_p50 is not None
    assert say(harness) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))
    assert all(stage.done for shown in harness.shown() for stage in shown.stages)


async def test_a_service_is_offered_only_while_somebody_answers(harness: CallHarness) -> None:
    client = harness.client()
    await asyncio.sleep(SETTLED)
    assert not harness.offered
    assert say(harness) == ((State.WAITING, Cause.NO_SERVER), (State.WAITING, Cause.NO_SERVER))
    for _ in range(3):
        server = harness.server()
        await harness.ready(client)
        client.ask()
        await until(lambda: len(client.answers) == len(client.requests), 1.0)
        await asyncio.sleep(SETTLED)
        assert say(harness)[0] == (State.OK, Cause.NONE)
        server.endpoint.close()
        await until(lambda: not harness.offered and not client.endpoint.ready, _WITHDRAWN_WITHIN)
        await asyncio.sleep(SETTLED)
        assert say(harness) == ((State.DOWN, Cause.SERVER_GONE), (State.DOWN, Cause.SERVER_GONE))
    assert client.right == 3


async def test_calls_are_lost_with_server_that_had_them(harness: CallHarness) -> None:
    server, client = await asked(harness)
    server.endpoint.close()
    await asyncio.sleep(SETTLED)
    near, far = harness.counted()
    assert (near.lost, far.lost, near.in_flight, far.in_flight) == (1, 1, 0, 0)
    assert near.last_failure
    # one that is killed and started again answers at once, though the dead one is still seen
    server = harness.server(waits=True)
    await harness.ready(client)
    server.die()
    harness.server()
    await asyncio.sleep(0.5)
    number = client.ask()
    await until(lambda: number in client.answers, 1.0)


@pytest.mark.bed(timeout=100.0)
async def test_killed_server_loses_calls_once_unseen(harness: CallHarness) -> None:
    server, _ = await asked(harness)
    server.die()
    await asyncio.sleep(5.0)
    assert harness.offered
    assert harness.counted()[0].in_flight == 1
    await until(lambda: not harness.offered, 42.0)
    await asyncio.sleep(1.0)
    assert [calls.lost for calls in harness.counted()] == [1, 1]


@pytest.mark.bed(timeout=2.0)
async def test_unanswered_call_is_given_up_with_answer(harness: CallHarness) -> None:
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    for _ in range(3):
        client.ask()
    await asyncio.sleep(1.5)
    assert harness.counted()[0].in_flight == 3
    await asyncio.sleep(SETTLED)
    assert [calls.expired for calls in harness.counted()] == [3, 3]
    assert say(harness) == ((State.SLOW, Cause.UNANSWERED), (State.SLOW, Cause.UNANSWERED))
    server.answer()
    await asyncio.sleep(SETTLED)
    assert not client.answers
    assert harness.counted()[1].late == 3
    await asyncio.sleep(60.0)
    assert say(harness) == ((State.SLOW, Cause.UNANSWERED), (State.SLOW, Cause.UNANSWERED))
    client.ask()
    await until(lambda: len(server.asked) == 4, 1.0)
    server.answer()
    await asyncio.sleep(SETTLED + 1.0)
    assert say(harness) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.bed(timeout=30.0)
async def test_a_link_that_is_cut(provider: str, harness: CallHarness) -> None:
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    for _ in range(10):
        client.ask()
    await until(lambda: len(server.asked) == 10, 1.0)
    with harness.world.trouble("cut", harness.robot):
        harness.world.network.cut(harness.near.machine, harness.far.machine)
        await until(lambda: not harness.offered, 8.0)
        assert harness.counted()[0].lost == 10
        assert say(harness)[0] == (State.DOWN, Cause.LINK_DOWN)
        await until(lambda: harness.counted()[1].lost == 10, 8.0)
        server.answer()
        await asyncio.sleep(10.0)
        harness.world.network.heal(harness.near.machine, harness.far.machine)
    await harness.ready(client)
    client.ask()
    await until(lambda: len(server.asked) == 11, 1.0)
    server.answer()
    await until(lambda: client.right == 1, 1.0)
    await asyncio.sleep(SETTLED)
    near, far = harness.counted()
    assert (near.asked, near.answered, near.lost) == (11, 1, 10)
    assert (far.asked, far.answered, far.lost) == (11, 1, 10)


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.bed(timeout=12.0, outlive=60.0)
async def test_answer_waits_for_a_link_that_is_away(provider: str, harness: CallHarness) -> None:
    """Neither side gives the call up meanwhile, and afterwards it has the time that was left."""
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    for _ in range(3):
        client.ask()
    await until(lambda: len(server.asked) == 3, 1.0)
    with harness.world.trouble("cut", harness.robot):
        harness.world.network.cut(harness.near.machine, harness.far.machine)
        await asyncio.sleep(20.0)
        server.answer_one()
        await asyncio.sleep(20.0)
        harness.world.network.heal(harness.near.machine, harness.far.machine)
    await until(lambda: client.right == 1, 8.0)
    server.answer_one()
    await until(lambda: client.right == 2, 1.0)
    await asyncio.sleep(12.0)
    assert [(each.answered, each.expired, each.lost) for each in harness.counted()] == [(2, 1, 0), (2, 1, 0)]


async def test_a_pause_gives_up_what_is_under_way(harness: CallHarness) -> None:
    server, client = await asked(harness)
    assert harness.far.run is not None
    bridge, key = harness.far.run.bridge, harness.halves()[1].route.key
    await harness.far.run.command(bridge.do(PauseTopics(key, paused=True)))
    await until(lambda: not harness.offered, _WITHDRAWN_WITHIN)
    await asyncio.sleep(SETTLED)
    assert [calls.lost for calls in harness.counted()] == [1, 1]
    assert say(harness) == ((State.PAUSED, Cause.PAUSED), (State.PAUSED, Cause.PAUSED))
    await harness.far.run.command(bridge.do(PauseTopics(key, paused=False)))
    await harness.ready(client)
    client.ask()
    await until(lambda: len(server.asked) == 2, 1.0)
    server.answer()
    await until(lambda: client.right == 1, 1.0)


@pytest.mark.bed(arm=True, deadman=0.0)
async def test_arming(harness: CallHarness) -> None:
    harness.server()
    client = harness.client()
    await asyncio.sleep(SETTLED)
    assert not harness.offered
    assert say(harness)[0] == (State.DISARMED, Cause.DISARMED)
    assert harness.near.run is not None
    bridge, key = harness.near.run.bridge, harness.halves()[0].route.key
    await harness.near.run.command(bridge.do(ArmTopic(key)))
    await harness.ready(client)
    client.ask()
    await until(lambda: client.right == 1, 1.0)
    await harness.near.run.command(bridge.do(DisarmTopic(key)))
    await until(lambda: not harness.offered, _WITHDRAWN_WITHIN)
    await asyncio.sleep(SETTLED)
    assert say(harness)[1] == (State.DISARMED, Cause.DISARMED)


async def _called_at_once(harness: CallHarness) -> None:
    """An operator of the callers' side arms it; a call that is made at once may overtake what keeps the lease."""
    harness.server()
    harness.world.network.path(harness.near.machine, harness.far.machine).latency = (0.0, 0.6)
    await asyncio.sleep(SETTLED)
    assert harness.near.run is not None
    run, bridge = harness.near.run, harness.near.run.bridge
    for number in range(12):
        client, key = harness.client(f"/client{number}"), harness.halves()[0].route.key
        arms = harness.world.loop.create_task(run.command(bridge.do(ArmTopic(key))))
        while not client.endpoint.ready:  # the providing side has reasons to look at its graph meanwhile
            harness.server("/passer_by", suffix="_else").endpoint.close()
            await asyncio.sleep(0.02)
        client.ask()
        await arms
        await asyncio.sleep(2.0)
        assert [calls.refused for calls in harness.counted()] == [{}, {}]
        assert client.right == 1
        client.endpoint.close()
        await run.command(bridge.do(DisarmTopic(key)))
        await asyncio.sleep(SETTLED)


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.bed(arm=True, deadman=0.0, max_age=0.0)
async def test_a_call_right_after_arming_is_answered(provider: str, harness: CallHarness) -> None:
    await _called_at_once(harness)


@pytest.mark.bed(arm=True, deadman=0.0, max_age=0.0)
async def test_offer_waits_for_lease(harness: CallHarness) -> None:
    begun = property(lambda _: True)
    with replaced.LEASE_BEGUN.during(begun), pytest.raises(AssertionError, match="'link silent': 1"):
        await _called_at_once(harness)


async def _offered_soon(harness: CallHarness) -> None:
    """An operator arms it on a slow link, where nothing else happens."""
    harness.server()
    for path in harness.world.network.both_ways(harness.near.machine, harness.far.machine):
        path.latency = (0.3, 0.3)
    await asyncio.sleep(SETTLED)
    assert harness.near.run is not None
    arming = harness.near.run.bridge.do(ArmTopic(harness.halves()[0].route.key))
    arms = harness.world.loop.create_task(harness.near.run.command(arming))
    await until(lambda: harness.offered, 1.5)
    await arms


@pytest.mark.bed(arm=True, deadman=0.0)
async def test_offer_waits_until_sides_hear_each_other(harness: CallHarness) -> None:
    await _offered_soon(harness)


@pytest.mark.bed(arm=True, deadman=0.0)
def test_it_has_to_be_opened_when_lease_begins(harness: CallHarness) -> None:
    with replaced.LEASE_LIVES.during(nothing), pytest.raises(TimeoutError):
        harness.world.play(life=harness.live(_offered_soon(harness)))


def _different_version_there(harness: CallHarness) -> None:
    harness.near.domain.installed[TYPE] = hash_of(TYPE, 1)
    harness.server()
    harness.client()


def _different_version_of_a_caller(harness: CallHarness) -> None:
    harness.server()
    harness.client(type_hash=hash_of(TYPE, 1))


def _another_type_than_the_session_says(harness: CallHarness) -> None:
    harness.server("/one", type_name="std_srvs/srv/Trigger")
    harness.client()


@pytest.mark.parametrize(
    "differ",
    [
        _different_version_there,
        _different_version_of_a_caller,
        pytest.param(_another_type_than_the_session_says, marks=pytest.mark.bed(type=TYPE)),
    ],
)
async def test_types_that_differ_are_refused_on_both_sides(
    differ: Callable[[CallHarness], None], harness: CallHarness
) -> None:
    differ(harness)
    await asyncio.sleep(SETTLED)
    assert not harness.offered
    assert say(harness) == ((State.DOWN, Cause.TYPE_CONFLICT), (State.DOWN, Cause.TYPE_CONFLICT))
    assert TYPE.rpartition("/")[2] in harness.shown()[0].reason


async def test_versions_are_asked_about_one_by_one(harness: CallHarness) -> None:
    asked: list[tuple[str, Callable[[str], None]]] = []
    near = harness.halves()[0]
    peer = cast("Any", near.route.peer)
    peer.compare_types = lambda _, types, tell: asked.append((types[0].type_hash, tell))
    harness.near.domain.installed[TYPE] = hash_of(TYPE, 9)
    for version in range(4):
        server = harness.server(type_hash=hash_of(TYPE, version))
        await asyncio.sleep(SETTLED)
        assert hash_of(TYPE, version) in harness.shown()[0].reason
        if version < 3:
            server.endpoint.close()
            await asyncio.sleep(SETTLED)
    assert [each for each, _ in asked] == [hash_of(TYPE, 0)]
    asked[0][1]("the old difference")
    assert "the old difference" not in harness.shown()[0].reason
    assert [each for each, _ in asked] == [hash_of(TYPE, 0), hash_of(TYPE, 3)]
    asked[1][1]("the new difference")
    await asyncio.sleep(SETTLED)
    assert all("the new difference" in shown.reason for shown in harness.shown())


async def test_caller_of_wrong_type_takes_nothing(harness: CallHarness) -> None:
    server, client = await asked(harness)
    wrong = harness.client("/wrong", type_name="std_srvs/srv/Trigger")
    await asyncio.sleep(SETTLED)
    assert say(harness) == ((State.UNHEARD, Cause.TYPE_CONFLICT), (State.UNHEARD, Cause.TYPE_CONFLICT))
    assert all("/wrong" in shown.reason for shown in harness.shown())
    server.answer()
    await until(lambda: client.right == 1, 1.0)
    wrong.endpoint.close()
    await asyncio.sleep(SETTLED)
    assert say(harness) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))


async def test_two_servers_are_named_and_first_answer_counts(harness: CallHarness) -> None:
    servers = [harness.server("/one"), harness.server("/two")]
    client = harness.client()
    await harness.ready(client)
    client.ask()
    await asyncio.sleep(SETTLED)
    assert client.right == 1
    assert harness.counted()[1].late == 1
    assert say(harness) == ((State.UNHEARD, Cause.SEVERAL_SERVERS), (State.UNHEARD, Cause.SEVERAL_SERVERS))
    assert "/one and /two" in harness.shown()[0].reason
    servers[0].endpoint.close()
    await asyncio.sleep(SETTLED)
    assert say(harness)[0] == (State.OK, Cause.NONE)


async def test_server_on_callers_side_is_named(harness: CallHarness) -> None:
    harness.server()
    client = harness.client()
    await harness.ready(client)
    local = harness.server("/local", far=False)
    await until(lambda: not harness.offered, _WITHDRAWN_WITHIN)
    await asyncio.sleep(SETTLED)
    assert say(harness) == ((State.DOWN, Cause.SERVED_HERE), (State.DOWN, Cause.SERVED_HERE))
    assert "/local" in harness.shown()[1].reason
    local.endpoint.close()
    await until(lambda: harness.offered, 2.0)


@pytest.mark.parametrize(
    ("limits", "cause", "passing"),
    [
        (CallLimits(under_way=10), "calls under way", 10),
        (CallLimits(bytes_under_way=10_000), "bytes under way", 9),
        (CallLimits(a_second=20.0), "calls a second", 20),
    ],
)
@pytest.mark.bed(timeout=2.0)
def test_beyond_its_bounds_call_is_refused_and_counted(
    limits: CallLimits, cause: str, passing: int, harness: CallHarness
) -> None:
    async def live() -> None:
        server, client = harness.server(waits=True), harness.client()
        await harness.ready(client)
        for _ in range(50):
            client.ask(bytes(1000))
        await asyncio.sleep(1.2)
        near, far = harness.counted()
        assert len(server.asked) == passing
        assert (near.in_flight, far.in_flight) == (passing, passing)
        assert near.refused == {cause: 50 - passing}
        await asyncio.sleep(1.0 + SETTLED)
        assert say(harness)[0][0] is State.SLOW
        near, _ = harness.counted()
        assert near.expired == passing
        client.ask(bytes(1000))  # the held bytes are free again
        await until(lambda: len(server.asked) == passing + 1, 2.0)

    with constants.CALL_LIMITS.during(limits):
        harness.world.play(life=harness.live(live()))


@pytest.mark.bed(timeout=5.0)
def test_the_providing_side_enforces_its_bounds(harness: CallHarness) -> None:
    """A peer that keeps to none of them is refused call by call, and counts that."""

    async def live() -> None:
        server, client = harness.server(waits=True), harness.client()
        await harness.ready(client)
        near, _ = harness.halves()
        with patch.object(near.route.peer.budget.asked, "take", lambda *_: None):
            for _ in range(50):
                client.ask()
            await until(lambda: harness.counted()[0].refused, 2.0)
        await asyncio.sleep(1.0)
        calls, peers = harness.counted()
        assert len(server.asked) == peers.in_flight == 12  # 10, and a quarter more
        assert calls.refused == peers.refused == {"calls under way": 38}
        near.route.peer.budget.asked._calls.held = calls.in_flight  # as if it had kept to them
        near.route.peer.budget.asked._bytes.held = sum(call.size for call in under_way(near))

    with constants.CALL_LIMITS.during(CallLimits(under_way=10)):
        harness.world.play(life=harness.live(live()))


@pytest.mark.bed(max_rate=5.0)
async def test_max_rate_is_of_calls(harness: CallHarness) -> None:
    server, client = harness.server(), harness.client()
    await harness.ready(client)
    for _ in range(100):
        client.ask()
        await asyncio.sleep(0.05)
    await asyncio.sleep(SETTLED)
    near, _ = harness.counted()
    assert 25 <= len(server.asked) <= 32
    assert near.refused == {"calls a second": 100 - len(server.asked)}


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.bed(compression="none")
def test_over_one_stream_that_all_routes_share(provider: str, harness: CallHarness) -> None:
    """Like Bluetooth: requests and answers go in chunks, interleaved with other routes, both ways on one channel."""

    async def live() -> None:
        server, client = harness.server(waits=True), harness.client()
        await harness.ready(client)
        for size in (0, 100_000, 10, 50_000, 2048):
            client.ask(bytes(size))
        await until(lambda: len(server.asked) == 5, 10.0)
        server.answer(Random(1).shuffle)
        await until(lambda: client.right == 5, 10.0)
        near, far = harness.halves()
        for half in (near, far):
            link, channel = half.route.peer, half.carried.channel
            assert isinstance(link, Link)
            assert link.control is not None
            assert isinstance(channel, StreamDuplex)
            assert channel.via.stream is link.control.stream

    with replaced.TCP_MULTIPLEXED.during(True):
        harness.world.play(life=harness.live(live()))
