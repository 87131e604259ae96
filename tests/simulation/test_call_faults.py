"""Calls over a bridge whose endpoints in ROS cannot be had, or fail."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
from tests.simulation.beds import until
from tests.support import replaced
from tests.support.goals import cancel_request, goal
from tests.support.inside import paced, waiting_frames

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, LANES, STATUS
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from tests.simulation.call_harness import CallHarness, ScriptedClient, ScriptedServer

_ACTION = "test_msgs/action/Fibonacci"


async def test_uncallable_service_ends_route_not_link(harness: CallHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    peer = harness.halves()[1].route.peer
    connections = peer.connections

    def fails(*_: Any) -> None:
        raise RosError("another version is installed")

    replaced.SIMULATED_CALL_SERVICE.set(monkeypatch, fails)
    harness.server()
    await asyncio.sleep(30.0)
    assert peer.connections == connections
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
    servers, client = _action(harness), _client_of(harness, GET_RESULT)
    await harness.ready(client)
    client.ask(bytes(16))
    await until(lambda: servers[GET_RESULT].asked, 2.0)
    near, far = harness.halves()
    paced(far.under_way.clients.services[CANCEL_GOAL].client).fail()
    await until(lambda: not harness.counted()[1].in_flight and far.under_way.clients.services, 15.0)
    await harness.ready(client)
    offered: Any = near.offer.lanes.services[GET_RESULT].server
    offered.fail()
    await asyncio.sleep(1.0)
    await until(lambda: len(near.offer.lanes.services) == 3, 15.0)
    await harness.ready(client)
    client.ask(bytes(16))  # the first question is lost with its client
    await until(lambda: len(servers[GET_RESULT].asked) == 2, 15.0)
    servers[GET_RESULT].answer()
    await until(lambda: client.answers, 5.0)


@pytest.mark.bed(kind="action")
async def test_new_cancel_without_server_is_refused(harness: CallHarness) -> None:
    servers, client = _action(harness), _client_of(harness, CANCEL_GOAL)
    await harness.ready(client)
    content = bytes(24)
    client.ask(content)
    await until(lambda: servers[CANCEL_GOAL].asked, 2.0)
    servers[CANCEL_GOAL].answer()
    await until(lambda: client.right, 2.0)
    near, far = harness.halves()
    connections = far.route.peer.connections
    for server in servers:
        server.endpoint.close()
    await until(lambda: not near.facts.end.offered, 2.0)
    assert near.carried.channel is not None
    harness.world.breaks_format = True
    near.carried.channel.send([(CallFrame(What.CALL, CANCEL_GOAL, 1000, 0, client.requests[1]).pack(), 0, 0)])
    await asyncio.sleep(2.0)
    assert far.route.peer.connections == connections
    assert far.flow.calls.snapshot().refused == {"provider gone": 1}


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
    assert {each.cause for each in (half.route.verdict() for half in harness.halves())} == {Cause.CALLS_WAIT}


@pytest.mark.bed(kind="action")
async def test_kept_messages_are_in_peers_budget(harness: CallHarness) -> None:
    _action(harness)
    await harness.ready(_client_of(harness, CANCEL_GOAL))
    near, _ = harness.halves()
    budget = near.route.peer.budget.kept
    budget.limit = 2000  # instead of 1 GB, which takes seconds to fill
    for size in (1000, 10, budget.limit + 1, 100):
        near.deliver([(CallFrame(What.MESSAGE, STATUS, 0, 0, bytes(size)).pack(), 0, 0)])
        assert budget.held == (size if size < budget.limit else 0)
    near.route.close("over")
    assert budget.held == 0


@pytest.mark.bed(kind="action")
async def test_refusal_on_other_lane_keeps_counts(harness: CallHarness) -> None:
    servers, client = _action(harness), _client_of(harness, CANCEL_GOAL)
    await harness.ready(client)
    client.endpoint.call(cancel_request(goal(1)))
    await until(lambda: servers[CANCEL_GOAL].asked, 1.0)
    near, far = harness.halves()
    first = near.route.id
    assert far.carried.channel is not None
    harness.world.breaks_format = True
    far.carried.channel.send([(CallFrame(What.REFUSED, GET_RESULT, 1, 0, b"provider gone").pack(), 0, 0)])
    await until(lambda: near.route.id != first and near.facts.end.offered, 15.0)
    counted = harness.counted()[0]
    assert (counted.asked, counted.in_flight, counted.lost) == (1, 1, 0)
    await until(lambda: len(servers[CANCEL_GOAL].asked) == 2, 1.0)
