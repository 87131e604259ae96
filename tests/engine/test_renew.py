"""Topics with `renew`: a publisher that sends all that it has to a new subscriber learns of one on the other side."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from rclpy.event_handler import PublisherEventCallbacks
from std_msgs.msg import String
from tests.support.bridge import carries, happened, route
from tests.support.domain import RELIABLE, text
from tests.support.spun import Spun
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.route.renewal import APART

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.event_handler import QoSPublisherMatchedInfo
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain


class Costmap(Spun):
    """A publisher that sends all that it has whenever a subscriber comes.

    Attributes:
        came: how often somebody came.
    """

    def __init__(self, domain_id: int) -> None:
        self.came = 0
        super().__init__(domain_id, "costmap", start_parameter_services=False)

    def _create(self) -> None:
        events = PublisherEventCallbacks(matched=self._matched)
        self.publisher = self.node.create_publisher(String, "/map", RELIABLE, event_callbacks=events)

    def _matched(self, info: QoSPublisherMatchedInfo) -> None:
        if info.total_count_change > 0:  # whoever went and came while this process stood still has come, too
            self.came += info.total_count_change
            self.publisher.publish(text("all"))


@pytest.fixture
def costmap(robot: Domain) -> Iterator[Costmap]:
    with closing(Costmap(robot.id)) as made:
        yield made


def test_far_subscriber_gets_all(bridge: Bridge, costmap: Costmap, pc: Domain) -> None:
    server, client = bridge.both(Topic("/map", "transmit", renew=True))
    listeners = [pc.listener("/map")]
    carries([costmap.publisher], server, ["/map"])
    for _ in range(3):
        eventually(lambda: "all" in listeners[-1].texts(100))
        listeners.append(pc.listener("/map"))
    assert costmap.came >= 3
    assert happened(client, EventCode.ROUTE_RENEWED)
    assert route(client, "/map").ledger.lost_in_dds == 0


def test_without_it_nobody_comes(bridge: Bridge, costmap: Costmap, pc: Domain) -> None:
    server, client = bridge.both(Topic("/map", "transmit"))
    pc.listener("/map")
    carries([costmap.publisher], server, ["/map"])
    eventually(lambda: costmap.came, what="its event, which may come later than its messages")
    came, second = costmap.came, pc.listener("/map")
    eventually(lambda: second.matched and route(client, "/map").audience.count == 2)
    holds(lambda: costmap.came == came, APART)
