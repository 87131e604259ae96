"""Calls over a bridge whose endpoints in ROS cannot be had, or fail."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from tests.simulation.beds import until
from tests.support import constants, replaced
from tests.support.goals import cancel_request, goal, goal_request
from tests.support.inside import clients_of, offers_of, paced, waiting_frames

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, LANES, STATUS, Refused
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.providing import ProvidingRoute
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from tests.simulation.call_harness import CallHarness, ScriptedClient, ScriptedServer

_ACTION = "test_msgs/action/Fibonacci"


async def test_uncallable_service_ends_route_not_link(harness: CallHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    _, far = harness.halves()
    connections = far.peer.connections

    def fails(*_: Any) -> None:
        raise RosError("another version is installed")

    replaced.SIMULATED_CALL_SERVICE.set(monkeypatch, fails)
    harness.server()
    await asyncio.sleep(30.0)
    _, far = harness.halves()
    assert far.peer.connections == connections
    assert "another version is installed" in harness.shown()[0].reason
    assert "another version is installed" in harness.shown()[1].reason
    monkeypatch.undo()
    await harness.ready(harness.client())


def _action(harness: CallHarness) -> list[ScriptedServer]:
    """Add the servers of an action, which answer on `answer`."""
    return [
        harness.server(suffix=lane.suffix, type_name=lane.type_name or _ACTION + lane.type_suffix, waits=True)
        for lane in LANES["action"]
        if not lane.is_topic
    ]


def _client_of(harness: CallHarness, lane: int) -> ScriptedClient:
    kind = LANES["action"][lane]
    return harness.client(f"/client{lane}", suffix=kind.suffix, type_name=kind.type_name or _ACTION + kind.type_suffix)


@pytest.mark.bed(kind="action")
async def test_endpoints_that_fail_are_replaced_while_goals_run(harness: CallHarness) -> None:
    """Endpoints that an interruption leaves open have to work."""
    servers, client = _action(harness), _client_of(harness, GET_RESULT)
    await harness.ready(client)
    client.ask(bytes(16))
    await until(lambda: servers[GET_RESULT].asked, 2.0)
    near, far = harness.halves()
    assert isinstance(near, CallingRoute)
    assert isinstance(far, ProvidingRoute)
    paced(clients_of(far).services[CANCEL_GOAL].client).fail()
    await until(lambda: not harness.counted()[1].in_flight and clients_of(far).services, 15.0)
    await harness.ready(client)
    offers_of(near).services[GET_RESULT].server.fail()
    await asyncio.sleep(1.0)
    await until(lambda: len(offers_of(near).services) == 3, 15.0)
    await harness.ready(client)
    await until(lambda: len(servers[GET_RESULT].asked) == 2, 15.0)  # the first client's question is as lost as it is
    servers[GET_RESULT].answer()
    await until(lambda: client.answers, 5.0)


@pytest.mark.bed(kind="action")
async def test_new_cancel_without_server_is_refused(harness: CallHarness) -> None:
    """It says what one said that was answered, and is no repetition of it."""
    servers, client = _action(harness), _client_of(harness, CANCEL_GOAL)
    await harness.ready(client)
    content = bytes(24)
    client.ask(content)
    await until(lambda: servers[CANCEL_GOAL].asked, 2.0)
    servers[CANCEL_GOAL].answer()
    await until(lambda: client.right, 2.0)
    near, far = harness.halves()
    connections = far.peer.connections
    for server in servers:
        server.endpoint.close()
    await until(lambda: not near.offered, 2.0)
    assert near.channel is not None
    harness.world.breaks_format = True
    near.channel.send([(CallFrame(What.CALL, CANCEL_GOAL, 1000, 0, client.requests[1]).pack(), 0, 0)])
    await asyncio.sleep(2.0)
    assert far.peer.connections == connections
    assert far.calls.snapshot().refused == {"provider gone": 1}


@pytest.mark.bed(timeout=1.0)
async def test_expired_calls_hold_nothing(harness: CallHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    for half, answers in zip(harness.halves(), (False, True), strict=True):
        with monkeypatch.context() as stuck:
            for _ in range(8):
                client.ask()
            if answers:
                await until(lambda: len(server.asked) == 8, 1.0)
            replaced.CHANNEL_CONGESTED.set(stuck, True)
            server.answer()
            await asyncio.sleep(5.0)
            assert harness.counted()[answers].expired == 8
            assert not waiting_frames(half)


@pytest.mark.bed(timeout=3.0)
async def test_calls_that_wait_expire_on_both_sides(harness: CallHarness) -> None:
    """The node takes 0.2 s for each; none reaches it once its caller has given up."""
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    loop = asyncio.get_running_loop()
    for _ in range(100):
        client.ask()
    given_up_at = loop.time() + 3.0
    while loop.time() < given_up_at:
        await asyncio.sleep(0.2)
        near, far = harness.counted()
        if far.waiting:
            server.answer_one()
    assert 10 < len(server.asked) < 30
    await until(lambda: not any(each.in_flight for each in harness.counted()), 5.0)
    asked = len(server.asked)
    server.answer()
    await asyncio.sleep(5.0)
    assert len(server.asked) == asked
    near, far = harness.counted()
    assert (near.answered + near.expired, far.answered + far.expired) == (100, 100)
    assert near.answered == client.right
    assert 8 <= asked - near.answered <= 9, "an answer may come late"
    assert {each.cause for each in (half.verdict() for half in harness.halves())} == {Cause.CALLS_WAIT}


@pytest.mark.bed(kind="action")
async def test_more_goals_run_than_results_are_kept(harness: CallHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.RESULTS_KEPT.set(monkeypatch, 8)
    servers, client = _action(harness), _client_of(harness, GET_RESULT)
    await harness.ready(client)
    for number in range(1, 21):
        client.endpoint.call(goal_request(goal(number)))
    asked = servers[GET_RESULT].asked
    await until(lambda: len(set(asked)) == 21, 10.0)  # with the probe
    servers[GET_RESULT].answer()
    await until(lambda: len(client.answers) == 20, 2.0)


@pytest.mark.bed(kind="action")
async def test_cancel_without_room_after_outage_is_repeated(harness: CallHarness) -> None:
    servers, client = _action(harness), _client_of(harness, CANCEL_GOAL)
    await harness.ready(client)
    near, _ = harness.halves()
    client.endpoint.call(cancel_request(goal(1)))
    await until(lambda: servers[CANCEL_GOAL].asked, 1.0)
    with patch.object(near.peer.budget.asked, "take", lambda *_: Refused.CALLS_UNDER_WAY):
        connections = near.peer.connections
        near.peer.control.abort("cut")  # type: ignore[attr-defined]
        await until(lambda: near.peer.connections > connections and near.offered, 30.0)
        await asyncio.sleep(2.0)
        assert len(servers[CANCEL_GOAL].asked) == 1
    await until(lambda: len(servers[CANCEL_GOAL].asked) == 2, 5.0)
    servers[CANCEL_GOAL].answer()
    await until(lambda: client.answers, 5.0)


@pytest.mark.bed(kind="action")
async def test_kept_messages_are_in_peers_budget(harness: CallHarness) -> None:
    _action(harness)
    await harness.ready(_client_of(harness, CANCEL_GOAL))
    near, _ = harness.halves()
    assert isinstance(near, CallingRoute)
    budget = near.peer.budget.kept
    budget.limit = 2000  # instead of 1 GB, which takes seconds to fill
    for size in (1000, 10, budget.limit + 1, 100):
        near.deliver([(CallFrame(What.MESSAGE, STATUS, 0, 0, bytes(size)).pack(), 0, 0)])
        assert budget.held == (size if size < budget.limit else 0)
    near.close("over")
    assert budget.held == 0


@pytest.mark.bed(kind="action")
async def test_refusal_on_other_lane_keeps_counts(harness: CallHarness) -> None:
    servers, client = _action(harness), _client_of(harness, CANCEL_GOAL)
    await harness.ready(client)
    client.endpoint.call(cancel_request(goal(1)))
    await until(lambda: servers[CANCEL_GOAL].asked, 1.0)
    near, far = harness.halves()
    first = near.id
    assert far.channel is not None
    harness.world.breaks_format = True
    far.channel.send([(CallFrame(What.REFUSED, GET_RESULT, 1, 0, b"provider gone").pack(), 0, 0)])
    await until(lambda: near.id != first and near.offered, 15.0)
    await until(lambda: len(servers[CANCEL_GOAL].asked) == 2, 5.0)
    servers[CANCEL_GOAL].answer()
    await until(lambda: client.answers, 5.0)
    assert harness.counted()[0].in_flight == 0
    assert harness.counted()[0].answered == 1
