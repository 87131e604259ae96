"""An engine without traffic does little, and none of its tasks ends unnoticed."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

from tests.support.bridge import carries, happened, linked, route
from tests.support.domain import text
from tests.support.inside import break_waiting, role_of
from tests.support.offline import loop, make_context
from tests.support.participants import KnownNode
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Snapshot, State
from rsb_bridge.ros.node import RosNode
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import Endpoint

__all__ = ["loop", "make_context"]


class CountingNode(KnownNode):
    """Counts how often the graph is asked for a topic's endpoints."""

    asked = 0

    def publishers(self, topic: str) -> list[Endpoint]:
        self.asked += 1
        return super().publishers(topic)

    def subscriptions(self, topic: str) -> list[Endpoint]:
        self.asked += 1
        return super().subscriptions(topic)


def test_routes_that_wait_do_not_ask_the_graph_again_and_again(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """And yet they see at once what they wait for."""
    nodes = CountingNode(robot.id, "robot1"), CountingNode(pc.id, "pc")
    topics = [Topic(f"/waits{number}", "transmit", protocol=("tcp", "udp")[number % 2]) for number in range(50)]
    server = bridge.start(bridge.server_session(), nodes[1])
    client = bridge.start(bridge.client_session(*topics), nodes[0])
    eventually(lambda: linked(client) and all(each.stages[5].done for each in client.snapshot().routes))
    # Once on each side; four times a second is 1,800. Nodes that come and go in the domain have them asked, too.
    eventually(lambda: asked_within(3.0, nodes) <= 51 + 1 + 2 * 50, what="three seconds without many questions")
    there, out = pc.listener("/waits7"), robot.publisher("/waits7")
    carries([out], server, ["/waits7"])
    out.publish(text("at last"))
    eventually(lambda: there.payloads)
    assert route(client, "/waits8").state is State.WAITING


def asked_within(seconds: float, nodes: tuple[CountingNode, ...]) -> int:
    before = sum(node.asked for node in nodes)
    time.sleep(seconds)
    return sum(node.asked for node in nodes) - before


def test_snapshots_are_renewed_four_times_a_second_while_somebody_looks_often(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    clock = make_context().clock
    blank = Snapshot(0.0, "robot1", "client", "", 0, running=False)
    publisher = SnapshotPublisher(blank, EventLog(clock), clock)

    class NoBridge:
        def links(self) -> list[Any]:
            return []

        def refused(self) -> tuple[()]:
            return ()

    async def renewals(seconds: float, *, look_every: float) -> int:
        times = set()
        for turn in range(round(seconds / 0.05)):
            await asyncio.sleep(0.05)
            looks = turn % round(look_every / 0.05) == 0 if look_every else False
            times.add((publisher.look() if looks else publisher.latest).time)
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


def test_a_regular_task_that_fails_is_reported_and_goes_on(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    server, client = bridge.both()
    role, failures = role_of(client), list[int]()

    def tick() -> None:
        if not failures:
            failures.append(1)
            raise KeyError("a mistake of ours")

    monkeypatch.setattr(role, "tick", tick)
    eventually(lambda: happened(client, EventCode.ENGINE_ERROR, "a mistake of ours"))
    holds(lambda: linked(client) and linked(server), 7.0)  # it pings on
    bridge.expected.add(client)  # the error is what this test is about


def test_the_engine_stops_when_its_ros_side_has_failed(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = RosNode(robot.id, "robot1")
    client = bridge.start(bridge.client_session(), node)
    break_waiting(node, monkeypatch)
    eventually(lambda: not client.snapshot().running)
    assert happened(client, EventCode.ENGINE_ROS_FAILED, "the wait set is broken: the engine stops")
