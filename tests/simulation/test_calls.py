"""Services over a bridge, in worlds where nothing happens but what is made to happen."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from random import Random
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from tests.simulation.booths import SETTLED, TYPE, Booth
from tests.simulation.ros import hash_of

from rsb_bridge.link import roles
from rsb_bridge.link.link import Link
from rsb_bridge.link.link_arming import LinkArming
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import ArmTopic, DisarmTopic, Pause
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.lease import Lease
from rsb_bridge.transport.tcp import Tcp

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.simulation.conftest import Play

    from rsb_bridge.route.calls.calls_route import CallsRoute
    from rsb_bridge.route.calls.pending_calls import Call

_WITHDRAWN_WITHIN = 1.0


def lived(play: Play, booth: Booth, life: Coroutine[None, None, None], seconds: float = 120.0) -> None:
    """Play a world until a life is over; whatever fails in it fails here."""
    failure: list[BaseException] = []
    over: list[bool] = []

    async def live() -> None:
        await asyncio.sleep(10.0)
        try:
            await life
        except BaseException as error:
            failure.append(error)
            raise
        over.append(True)

    play(booth.world, seconds, live())
    if failure:
        raise failure[0]
    assert over, "it has not come to an end"


async def until(condition: Callable[[], object], within: float) -> None:
    """Wait for something, with a deadline."""
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 — plain state of a simulated world
            await asyncio.sleep(0.02)


def under_way(route: CallsRoute) -> list[Call]:
    """The calls of a half."""
    return list(route._pending._calls.values())  # type: ignore[attr-defined]


def say(booth: Booth) -> tuple[tuple[State, str], tuple[State, str]]:
    """State and cause, on the callers' side and on the other."""
    near, far = booth.shown()
    return (near.state, near.cause), (far.state, far.cause)


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.parametrize("seed", range(1, 4))
def test_many_calls_at_once_are_answered_in_any_order(seed: int, provider: str, play: Play) -> None:
    booth = Booth(seed, provider)

    async def live() -> None:
        teller, askers = booth.teller(waits=True), [booth.asker(f"/asker{n}") for n in range(5)]
        for asker in askers:
            await booth.ready(asker)
        for _ in range(200):
            for asker in askers:
                asker.ask()
        await until(lambda: len(teller.asked) == 1000, 5.0)
        near, far = booth.counted()
        assert near.in_flight == far.in_flight == 1000
        teller.answer(Random(seed).shuffle)
        await until(lambda: sum(asker.right for asker in askers) == 1000, 5.0)
        near, far = booth.counted()
        assert near.answered == far.answered == 1000
        await asyncio.sleep(SETTLED)
        near, far = booth.counted()
        assert near.node_p50 == pytest.approx(far.node_p50, abs=1e-6)
        assert near.way_p50 is not None
        assert say(booth) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))
        assert all(stage.done for shown in booth.shown() for stage in shown.stages)

    lived(play, booth, live())


def test_a_service_is_offered_only_while_somebody_answers(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        asker = booth.asker()
        await asyncio.sleep(SETTLED)
        assert not booth.offered
        assert say(booth) == ((State.WAITING, Cause.NO_SERVER), (State.WAITING, Cause.NO_SERVER))
        for _ in range(3):
            teller = booth.teller()
            await booth.ready(asker)
            asker.ask()
            await until(lambda: len(asker.answers) == len(asker.requests), 1.0)
            await asyncio.sleep(SETTLED)
            assert say(booth)[0] == (State.OK, Cause.NONE)
            teller.server.close()
            await until(lambda: not booth.offered and not asker.client.ready, _WITHDRAWN_WITHIN)
            await asyncio.sleep(SETTLED)
            assert say(booth) == ((State.DOWN, Cause.SERVER_GONE), (State.DOWN, Cause.SERVER_GONE))
        assert asker.right == 3

    lived(play, booth, live())


def test_calls_are_lost_with_the_server_that_had_them(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        asker.ask()
        await until(lambda: teller.asked, 1.0)
        teller.server.close()
        await asyncio.sleep(SETTLED)
        near, far = booth.counted()
        assert (near.lost, far.lost, near.in_flight, far.in_flight) == (1, 1, 0, 0)
        assert near.last_failure
        # one that is killed and started again answers at once, though the dead one is still seen
        teller = booth.teller(waits=True)
        await booth.ready(asker)
        teller.die()
        booth.teller()
        await asyncio.sleep(0.5)
        number = asker.ask()
        await until(lambda: number in asker.answers, 1.0)

    lived(play, booth, live())


def test_a_server_that_is_killed_loses_its_calls_when_it_is_seen_no_more(play: Play) -> None:
    booth = Booth(timeout=100.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        asker.ask()
        await until(lambda: teller.asked, 1.0)
        teller.die()
        await asyncio.sleep(5.0)
        assert booth.offered
        assert booth.counted()[0].in_flight == 1
        await until(lambda: not booth.offered, 42.0)
        await asyncio.sleep(1.0)
        assert [calls.lost for calls in booth.counted()] == [1, 1]

    lived(play, booth, live(), 200.0)


def test_a_call_that_has_no_answer_is_given_up_and_its_answer_goes_to_nobody(play: Play) -> None:
    booth = Booth(timeout=2.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        for _ in range(3):
            asker.ask()
        await asyncio.sleep(1.5)
        assert booth.counted()[0].in_flight == 3
        await asyncio.sleep(SETTLED)
        assert [calls.expired for calls in booth.counted()] == [3, 3]
        assert say(booth) == ((State.SLOW, Cause.UNANSWERED), (State.SLOW, Cause.UNANSWERED))
        teller.answer()
        await asyncio.sleep(SETTLED)
        assert not asker.answers
        assert booth.counted()[1].late == 3
        await asyncio.sleep(60.0)
        assert say(booth) == ((State.SLOW, Cause.UNANSWERED), (State.SLOW, Cause.UNANSWERED))
        asker.ask()
        await until(lambda: len(teller.asked) == 4, 1.0)
        teller.answer()
        await asyncio.sleep(SETTLED + 1.0)
        assert say(booth) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))

    lived(play, booth, live())


@pytest.mark.parametrize("provider", ["server", "client"])
def test_a_link_that_is_cut(provider: str, play: Play) -> None:
    booth = Booth(1, provider, timeout=30.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        for _ in range(10):
            asker.ask()
        await until(lambda: len(teller.asked) == 10, 1.0)
        with booth.world.trouble("cut", booth.robot):
            booth.world.network.cut(booth.near.machine, booth.far.machine)
            await until(lambda: not booth.offered, 8.0)
            assert booth.counted()[0].lost == 10
            assert say(booth)[0] == (State.DOWN, Cause.LINK_DOWN)
            await until(lambda: booth.counted()[1].lost == 10, 8.0)
            teller.answer()
            await asyncio.sleep(10.0)
            booth.world.network.heal(booth.near.machine, booth.far.machine)
        await booth.ready(asker)
        asker.ask()
        await until(lambda: len(teller.asked) == 11, 1.0)
        teller.answer()
        await until(lambda: asker.right == 1, 1.0)
        await asyncio.sleep(SETTLED)
        near, far = booth.counted()
        assert (near.asked, near.answered, near.lost) == (11, 1, 10)
        assert (far.asked, far.answered, far.lost) == (11, 1, 10)

    lived(play, booth, live())


def test_a_pause_gives_up_what_is_under_way(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        asker.ask()
        await until(lambda: teller.asked, 1.0)
        assert booth.far.run is not None
        bridge, key = booth.far.run.bridge, booth.halves()[1].key
        await booth.far.run.command(bridge.do(Pause(key, paused=True)))
        await until(lambda: not booth.offered, _WITHDRAWN_WITHIN)
        await asyncio.sleep(SETTLED)
        assert [calls.lost for calls in booth.counted()] == [1, 1]
        assert say(booth) == ((State.PAUSED, Cause.PAUSED), (State.PAUSED, Cause.PAUSED))
        await booth.far.run.command(bridge.do(Pause(key, paused=False)))
        await booth.ready(asker)
        asker.ask()
        await until(lambda: len(teller.asked) == 2, 1.0)
        teller.answer()
        await until(lambda: asker.right == 1, 1.0)

    lived(play, booth, live())


def test_arming(play: Play) -> None:
    booth = Booth(arm=True, deadman=0.0)

    async def live() -> None:
        booth.teller()
        asker = booth.asker()
        await asyncio.sleep(SETTLED)
        assert not booth.offered
        assert say(booth)[0] == (State.DISARMED, Cause.DISARMED)
        assert booth.near.run is not None
        bridge, key = booth.near.run.bridge, booth.halves()[0].key
        await booth.near.run.command(bridge.do(ArmTopic(key)))
        await booth.ready(asker)
        asker.ask()
        await until(lambda: asker.right == 1, 1.0)
        await booth.near.run.command(bridge.do(DisarmTopic(key)))
        await until(lambda: not booth.offered, _WITHDRAWN_WITHIN)
        await asyncio.sleep(SETTLED)
        assert say(booth)[1] == (State.DISARMED, Cause.DISARMED)

    lived(play, booth, live())


async def _called_at_once(booth: Booth) -> None:
    """An operator of the callers' side arms it; a call that is made at once may overtake what keeps the lease."""
    booth.teller()
    booth.world.network.path(booth.near.machine, booth.far.machine).latency = (0.0, 0.6)
    await asyncio.sleep(SETTLED)
    assert booth.near.run is not None
    run, bridge = booth.near.run, booth.near.run.bridge
    for number in range(12):
        asker, key = booth.asker(f"/asker{number}"), booth.halves()[0].key
        arms = booth.world.loop.create_task(run.command(bridge.do(ArmTopic(key))))
        while not asker.client.ready:  # the providing side has reasons to look at its graph meanwhile
            booth.teller("/passer_by", suffix="_else").server.close()
            await asyncio.sleep(0.02)
        asker.ask()
        await arms
        await asyncio.sleep(2.0)
        assert [calls.refused for calls in booth.counted()] == [{}, {}]
        assert asker.right == 1
        asker.client.close()
        await run.command(bridge.do(DisarmTopic(key)))
        await asyncio.sleep(SETTLED)


@pytest.mark.parametrize("provider", ["server", "client"])
def test_a_call_right_after_arming_is_answered(provider: str, play: Play) -> None:
    booth = Booth(1, provider, arm=True, deadman=0.0, max_age=0.0)
    lived(play, booth, _called_at_once(booth))


def test_it_has_to_be_offered_only_once_the_lease_has_begun(play: Play) -> None:
    booth = Booth(arm=True, deadman=0.0, max_age=0.0)
    begun = property(lambda _: True)
    with patch.object(Lease, "begun", begun), pytest.raises(AssertionError, match="'link silent': 1"):
        lived(play, booth, _called_at_once(booth))


async def _offered_soon(booth: Booth) -> None:
    """An operator arms it on a slow link, where nothing else happens."""
    booth.teller()
    for path in booth.world.network.both_ways(booth.near.machine, booth.far.machine):
        path.latency = (0.3, 0.3)
    await asyncio.sleep(SETTLED)
    assert booth.near.run is not None
    arming = booth.near.run.bridge.do(ArmTopic(booth.halves()[0].key))
    arms = booth.world.loop.create_task(booth.near.run.command(arming))
    await until(lambda: booth.offered, 1.5)
    await arms


def test_it_is_offered_once_the_two_sides_hear_each_other(play: Play) -> None:
    booth = Booth(arm=True, deadman=0.0)
    lived(play, booth, _offered_soon(booth))


def test_it_has_to_be_opened_when_the_lease_begins(play: Play) -> None:
    booth = Booth(arm=True, deadman=0.0)
    with patch.object(LinkArming, "_lease_lives", _forgotten), pytest.raises(TimeoutError):
        lived(play, booth, _offered_soon(booth))
    assert not booth.offered


def _forgotten(*_: object) -> None:
    """What was forgotten."""


def _different_version_there(booth: Booth) -> None:
    booth.near.domain.installed[TYPE] = hash_of(TYPE, 1)
    booth.teller()
    booth.asker()


def _different_version_of_a_caller(booth: Booth) -> None:
    booth.teller()
    booth.asker(type_hash=hash_of(TYPE, 1))


def _different_type_of_a_caller(booth: Booth) -> None:
    booth.teller()
    booth.asker(type_name="std_srvs/srv/Trigger")


def _servers_of_different_types(booth: Booth) -> None:
    booth.teller("/one")
    booth.teller("/two", type_name="std_srvs/srv/Trigger")
    booth.asker()


def _servers_of_different_versions(booth: Booth) -> None:
    booth.teller("/one")
    booth.teller("/two", type_hash=hash_of(TYPE, 1))
    booth.asker()


def _another_type_than_the_session_says(booth: Booth) -> None:
    booth.teller("/one", type_name="std_srvs/srv/Trigger")
    booth.asker()


@pytest.mark.parametrize(
    "differ",
    [
        _different_version_there,
        _different_version_of_a_caller,
        _different_type_of_a_caller,
        _servers_of_different_types,
        _servers_of_different_versions,
        _another_type_than_the_session_says,
    ],
)
def test_types_that_differ_are_refused_on_both_sides(differ: Callable[[Booth], None], play: Play) -> None:
    booth = Booth(type=TYPE if differ is _another_type_than_the_session_says else "auto")

    async def live() -> None:
        differ(booth)
        await asyncio.sleep(SETTLED)
        assert not booth.offered
        assert say(booth) == ((State.DOWN, Cause.TYPE_CONFLICT), (State.DOWN, Cause.TYPE_CONFLICT))
        assert TYPE.rpartition("/")[2] in booth.shown()[0].reason

    lived(play, booth, live())


def test_the_other_side_is_asked_about_one_version_at_a_time(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        asked: list[tuple[str, Callable[[str], None]]] = []
        near = booth.halves()[0]
        assert isinstance(near, CallingRoute)
        near.compare_types = lambda _, types, tell: asked.append((types[0].type_hash, tell))
        booth.near.domain.installed[TYPE] = hash_of(TYPE, 9)
        for version in range(4):
            teller = booth.teller(type_hash=hash_of(TYPE, version))
            await asyncio.sleep(SETTLED)
            assert hash_of(TYPE, version) in booth.shown()[0].reason
            if version < 3:
                teller.server.close()
                await asyncio.sleep(SETTLED)
        assert [each for each, _ in asked] == [hash_of(TYPE, 0)]
        asked[0][1]("the old difference")
        assert "the old difference" not in booth.shown()[0].reason
        assert [each for each, _ in asked] == [hash_of(TYPE, 0), hash_of(TYPE, 3)]
        asked[1][1]("the new difference")
        await asyncio.sleep(SETTLED)
        assert all("the new difference" in shown.reason for shown in booth.shown())

    lived(play, booth, live())


def test_a_caller_that_has_the_wrong_type_takes_nothing_from_the_others(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        asker.ask()
        await until(lambda: teller.asked, 1.0)
        wrong = booth.asker("/wrong", type_name="std_srvs/srv/Trigger")
        await asyncio.sleep(SETTLED)
        assert say(booth) == ((State.UNHEARD, Cause.TYPE_CONFLICT), (State.UNHEARD, Cause.TYPE_CONFLICT))
        assert all("/wrong" in shown.reason for shown in booth.shown())
        teller.answer()
        await until(lambda: asker.right == 1, 1.0)
        wrong.client.close()
        await asyncio.sleep(SETTLED)
        assert say(booth) == ((State.OK, Cause.NONE), (State.OK, Cause.NONE))

    lived(play, booth, live())


def test_two_servers_are_named_and_the_first_answer_counts(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        tellers = [booth.teller("/one"), booth.teller("/two")]
        asker = booth.asker()
        await booth.ready(asker)
        asker.ask()
        await asyncio.sleep(SETTLED)
        assert asker.right == 1
        assert booth.counted()[1].late == 1
        assert say(booth) == ((State.UNHEARD, Cause.SEVERAL_SERVERS), (State.UNHEARD, Cause.SEVERAL_SERVERS))
        assert "/one and /two" in booth.shown()[0].reason
        tellers[0].server.close()
        await asyncio.sleep(SETTLED)
        assert say(booth)[0] == (State.OK, Cause.NONE)

    lived(play, booth, live())


def test_a_server_on_the_callers_side_is_named_and_nothing_is_offered_beside_it(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        booth.teller()
        asker = booth.asker()
        await booth.ready(asker)
        local = booth.teller("/local", far=False)
        await until(lambda: not booth.offered, _WITHDRAWN_WITHIN)
        await asyncio.sleep(SETTLED)
        assert say(booth) == ((State.DOWN, Cause.SERVED_HERE), (State.DOWN, Cause.SERVED_HERE))
        assert "/local" in booth.shown()[1].reason
        local.server.close()
        await until(lambda: booth.offered, 2.0)

    lived(play, booth, live())


@contextmanager
def bounds(**limits: Any) -> Iterator[None]:
    """Other bounds than the usual ones."""
    with patch.multiple("rsb_bridge.route.peer", **limits):
        yield


@pytest.mark.parametrize(
    ("limits", "cause", "passing"),
    [
        ({"CALLS_UNDER_WAY": 10}, "calls under way", 10),
        ({"BYTES_UNDER_WAY": 10_000}, "bytes under way", 9),
        ({"CALLS_A_SECOND": 20.0}, "calls a second", 20),
    ],
)
def test_beyond_its_bounds_a_call_is_refused_and_counted(
    limits: dict[str, Any], cause: str, passing: int, play: Play
) -> None:
    booth = Booth(timeout=2.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        for _ in range(50):
            asker.ask(bytes(1000))
        await asyncio.sleep(1.0)
        near, far = booth.counted()
        assert len(teller.asked) == passing
        assert (near.in_flight, far.in_flight) == (passing, passing)
        assert near.refused == {cause: 50 - passing}
        await asyncio.sleep(1.0 + SETTLED)
        assert say(booth)[0][0] is State.SLOW
        near, _ = booth.counted()
        assert near.expired == passing
        asker.ask(bytes(1000))  # what was held is free again
        await until(lambda: len(teller.asked) == passing + 1, 2.0)

    with bounds(**limits):
        lived(play, booth, live())


def test_the_providing_side_enforces_its_bounds(play: Play) -> None:
    """A peer that keeps to none of them is refused call by call, and counts that."""
    booth = Booth(timeout=5.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        near, _ = booth.halves()
        with patch.object(near.peer.budget.asked, "take", lambda *_: None):
            for _ in range(50):
                asker.ask()
            await until(lambda: booth.counted()[0].refused, 2.0)
        await asyncio.sleep(1.0)
        calls, peers = booth.counted()
        assert len(teller.asked) == peers.in_flight == 12  # 10, and a quarter more
        assert calls.refused == peers.refused == {"calls under way": 38}
        near.peer.budget.asked._calls.held = calls.in_flight  # as if it had kept to them
        near.peer.budget.asked._bytes.held = sum(call.size for call in under_way(near))

    with bounds(CALLS_UNDER_WAY=10):
        lived(play, booth, live())


def test_max_rate_is_of_calls(play: Play) -> None:
    booth = Booth(max_rate=5.0)

    async def live() -> None:
        teller, asker = booth.teller(), booth.asker()
        await booth.ready(asker)
        for _ in range(100):
            asker.ask()
            await asyncio.sleep(0.05)
        await asyncio.sleep(SETTLED)
        near, _ = booth.counted()
        assert 25 <= len(teller.asked) <= 32
        assert near.refused == {"calls a second": 100 - len(teller.asked)}

    lived(play, booth, live())


@pytest.mark.parametrize("provider", ["server", "client"])
def test_over_one_stream_that_all_routes_share(provider: str, play: Play) -> None:
    """As on Bluetooth: requests and answers go in chunks, between those of other routes, both ways on one channel."""
    booth = Booth(1, provider, compression="none")

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        for size in (0, 100_000, 10, 50_000, 2048):
            asker.ask(bytes(size))
        await until(lambda: len(teller.asked) == 5, 10.0)
        teller.answer(Random(1).shuffle)
        await until(lambda: asker.right == 5, 10.0)
        near, far = booth.halves()
        for half in (near, far):
            link = half.peer
            assert isinstance(link, Link)
            assert link.control is not None
            assert half.channel is not None
            assert half.channel.carrier is link.control.stream

    with patch.object(Tcp, "multiplexed", True):
        lived(play, booth, live())


def test_compression(play: Play) -> None:
    booth = Booth(compression="zstd")

    async def live() -> None:
        booth.teller()
        asker = booth.asker()
        await booth.ready(asker)
        for size in (0, 10, 100_000, 3_000_000):
            asker.ask(bytes(size))
        await until(lambda: asker.right == 4, 5.0)
        near, _ = booth.halves()
        assert near.channel is not None
        assert near.channel.carrier.sent_bytes < 100_000

    lived(play, booth, live())


def test_an_older_peer_is_told_of_no_calls(play: Play) -> None:
    booth = Booth()

    async def live() -> None:
        booth.teller()
        await asyncio.sleep(SETTLED)
        near, _ = (each.run for each in (booth.near, booth.far))
        assert near is not None
        (route,) = near.links()[0].routes.values()
        assert (route.snapshot().state, route.snapshot().cause) == (State.DOWN, Cause.REFUSED)
        assert "update" in route.snapshot().reason
        assert len([event for event in near.events.after(0) if event.code == EventCode.ROUTE_REFUSED]) == 1

    with patch.object(roles, "FEATURES", ()):
        lived(play, booth, live())
