"""A topic that nobody publishes on the sending side, and that a node publishes on the receiving one."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.idling import tick_if_due
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.wire.records import ReceivedReport, SentReport

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

SCAN, TEXT = "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
DESK = Endpoint("/desk", SCAN, "", Qos())
BRIDGE = Endpoint("/_rsb_robot1_0123abcd", SCAN, "", Qos())


class Graph(NoRos):
    """Topics of the receiving side, with their publishers."""

    def __init__(self, **published: Endpoint) -> None:
        self.published = {f"/{name}": [publisher] for name, publisher in published.items()}

    def topics(self) -> dict[str, list[str]]:
        return {topic: [each.type_name for each in found] for topic, found in self.published.items()}

    def publishers(self, topic: str) -> list[Endpoint]:
        return self.published.get(topic, [])


def tick(half: Receiver, peer: FakePeer, loop: VirtualLoop, seconds: int) -> None:
    """Tick the route as its link does: seldom once nothing happens."""
    for _ in range(seconds):
        loop.run_until_complete(asyncio.sleep(1.0))
        for route in peer.timetable.look(loop.time()):
            tick_if_due(route, loop.time(), looked_at=False)


@pytest.mark.parametrize(
    ("graph", "named"),
    [
        (Graph(scan=DESK), (("/desk",), "")),
        (Graph(scna=DESK), (("/desk",), "/scna")),
        (Graph(scan=DESK, scna=DESK), (("/desk",), "")),
        (Graph(scna=BRIDGE), ((), "")),
        (Graph(scna=Endpoint("/desk", TEXT, "", Qos())), ((), "")),
        (Graph(map=DESK), ((), "")),
    ],
)
def test_receiver_reports_who_publishes_here(
    graph: Graph, named: tuple[tuple[str, ...], str], loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    peer = FakePeer()
    half = half_of(Receiver, make_context(ros=graph), Topic("/scan", "transmit", type=SCAN), peer)
    half.route.open(1)
    half.route.on_accepted()
    half.reported(SentReport(route=1))
    tick(half, peer, loop, 3)
    assert half.listeners.published == named
    half.reported(SentReport(route=1, publishers=1))
    half.proceed()
    assert half.listeners.published == ((), "")


def test_near_name_that_appears_later_is_found(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    graph, peer = Graph(), FakePeer()
    half = half_of(Receiver, make_context(ros=graph), Topic("/scan", "transmit", type=SCAN), peer)
    half.route.open(1)
    half.route.on_accepted()
    half.reported(SentReport(route=1))
    tick(half, peer, loop, 120)
    assert half.route.idle
    graph.published["/scna"] = [DESK]
    tick(half, peer, loop, 40)
    [report] = [each for each in half.news() if isinstance(each, ReceivedReport)]
    assert (report.publishers, report.published_as) == (("/desk",), "/scna")
