"""The messages of a route's lanes that are topics, where its callers are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.volatile import SlowSubscriberError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.calls import Lane
    from rsb_bridge.route.calls.offers import Offers
    from rsb_bridge.route.notices import Notices
    from rsb_bridge.wire.framing import Budget


class LaneMessages:
    """Publishes them while they are offered, and keeps the last one of a latched lane for the next offer.

    Args:
        lanes: of the route.
        offers: have the publishers.
        budget: bytes that may be kept on the link.
        notices: told of messages that cannot be published.
    """

    def __init__(self, lanes: Sequence[Lane], offers: Offers, budget: Budget, notices: Notices) -> None:
        self._lanes = lanes
        self._offers = offers
        self._budget = budget
        self._notices = notices
        self._kept: dict[int, bytes] = {}  # by lane

    def take(self, lane: int, content: bytes) -> None:
        """Publish a message that came."""
        qos = self._lanes[lane].qos
        if qos is not None and qos.latched:
            self._keep(lane, content)
        self._publish(lane, content)

    def offered(self, lanes: Iterable[int]) -> None:
        """Publish what is kept on lanes that are offered from now on."""
        for lane in lanes:
            if lane in self._kept:
                self._publish(lane, self._kept[lane])

    def clear(self) -> None:
        """Keep nothing."""
        for lane in tuple(self._kept):
            self._keep(lane, b"")

    def _keep(self, lane: int, content: bytes) -> None:
        self._budget.give(len(self._kept.pop(lane, b"")))
        if content and self._budget.take(len(content)):
            self._kept[lane] = content

    def _publish(self, lane: int, content: bytes) -> None:
        publisher = self._offers.publishers.get(lane)
        if publisher is None:
            return
        try:
            publisher.publish(content)
        except RosError as error:
            self._notices.message_error(EventCode.ROUTE_PUBLISH_FAILED, str(error))
        except SlowSubscriberError as error:
            self._notices.message_error(EventCode.ROUTE_SLOW_SUBSCRIBER, str(error))
