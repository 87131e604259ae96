"""An engine without traffic does little, and none of its tasks ends unnoticed."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from tests.support import constants, replaced
from tests.support.bridge import happened, linked
from tests.support.inside import break_waiting
from tests.support.offline import loop, make_context
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Snapshot
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import LostPort, RosProblem
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["loop", "make_context"]


def test_snapshots_come_four_times_a_second_when_watched(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    clock = make_context().clock
    blank = Snapshot(0.0, "robot1", "client", "", 0, running=False)
    publisher = SnapshotPublisher(blank, EventLog(clock), clock)

    class NoBridge:
        def links(self) -> list[Any]:
            return []

        unsaved = False

        def refused(self) -> tuple[()]:
            return ()

    async def renewals(seconds: float, *, look_every: float) -> int:
        times = set()
        for turn in range(round(seconds / 0.05)):
            await asyncio.sleep(0.05)
            looks = turn % round(look_every / 0.05) == 0 if look_every else False
            times.add((publisher.newest() if looks else publisher.latest).time)
        return len(times)

    async def main() -> None:
        running = loop.create_task(publisher.run(NoBridge()))
        assert await renewals(20.0, look_every=0.0) in (20, 21)
        assert await renewals(20.0, look_every=1.0) in (20, 21)
        assert await renewals(20.0, look_every=0.05) in range(76, 82)
        assert await renewals(20.0, look_every=0.5) in range(76, 82)
        await asyncio.sleep(3.0)
        assert await renewals(20.0, look_every=1.0) in (20, 21)
        running.cancel()

    loop.run_until_complete(main())


def test_failing_task_is_reported_and_goes_on(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    server, client = bridge.both()
    failures, tick = list[int](), replaced.CLIENT_TICK.value

    def fail_once(role: object) -> None:
        if not failures:
            failures.append(1)
            raise KeyError("a mistake of ours")
        tick(role)

    replaced.CLIENT_TICK.set(monkeypatch, fail_once)
    eventually(lambda: happened(client, EventCode.ENGINE_ERROR, "a mistake of ours"))
    holds(lambda: linked(client) and linked(server), 7.0)  # it pings on
    bridge.expected.add(client)  # the error is what this test is about


def test_engine_stops_when_its_ros_side_has_failed(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = RosNode(robot.id, "robot1")
    client = bridge.start(bridge.client_session(), node)
    break_waiting(node, monkeypatch)
    eventually(lambda: not client.snapshot().running)
    assert happened(client, EventCode.ENGINE_ROS_FAILED, "the wait set is broken: the engine stops")


def test_the_engine_stops_when_dds_hears_no_node(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.BRIDGE_LISTENS_EVERY.set(monkeypatch, 1)
    node = RosNode(robot.id, "robot1")
    lost, later, other = LostPort("/a", 1), LostPort("/a", 2), LostPort("/b", 3)
    # It may follow its senders a moment later, and then lose the port again.
    told = iter(({lost}, (), {lost}, {later}, {other}, {later, other}))
    monkeypatch.setattr(node, "lost_ports", lambda: frozenset(next(told)))
    client = bridge.start(bridge.client_session(), node)
    eventually(lambda: not client.snapshot().running)
    assert happened(client, EventCode.ENGINE_ROS_FAILED, f"{RosProblem.DEAF(port='/b')}: the engine stops")
    assert not list(told)
