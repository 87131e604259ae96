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
        counts: how many subscribe, after each change.
    """

    def __init__(self, domain_id: int) -> None:
        self.counts: list[int] = []
        super().__init__(domain_id, "costmap", start_parameter_services=False)

    def _create(self) -> None:
        events = PublisherEventCallbacks(matched=self._matched)
        self.publisher = self.node.create_publisher(String, "/map", RELIABLE, event_callbacks=events)

    def _matched(self, info: QoSPublisherMatchedInfo) -> None:
        self.counts.append(info.current_count)
        if info.current_count_change > 0:
            self.publisher.publish(text("all"))

    @property
    def came(self) -> int:
        """How often somebody came."""
        counts = [*self.counts]
        return sum(after > before for before, after in zip([0, *counts], counts, strict=False))


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
    assert 0 in costmap.counts, "it saw that nobody was there for a moment"
    assert happened(client, EventCode.ROUTE_RENEWED)
    assert route(client, "/map").ledger.lost_in_dds == 0


def test_without_it_nobody_comes(bridge: Bridge, costmap: Costmap, pc: Domain) -> None:
    server, client = bridge.both(Topic("/map", "transmit"))
    pc.listener("/map")
    carries([costmap.publisher], server, ["/map"])
    came, second = costmap.came, pc.listener("/map")
    eventually(lambda: second.matched and route(client, "/map").audience.count == 2)
    holds(lambda: costmap.came == came, APART)
