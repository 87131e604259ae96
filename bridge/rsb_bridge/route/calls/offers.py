"""What the callers' side has in ROS for a route of calls: services that others can call, and publishers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import BATCH
from rsb_bridge.route.calls.lane_ends import LaneEnds
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.volatile import VolatileTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.model.sources import Via
    from rsb_bridge.ros.ros_interface import Request, RosError, ServiceServer
    from rsb_bridge.route.calls.lane_ends import LaneType
    from rsb_bridge.route.lease import Lease
    from rsb_bridge.route.peer import Peer


class Offers(LaneEnds):
    """All of one route's, while it is offered.

    Args:
        context: what every part of the engine shares.
        peer: whose providers answer.
        lanes: of the route.
        asked: gets a lane's requests.
        too_late: gets those that came when it was offered no more.
        failed: told of a server that has failed and closed itself.
        marks: gives the lease that requests are marked with, or None if they need not be.

    Attributes:
        servers: by lane.
        publishers: by lane; what DDS holds for their subscribers is bounded, of those that keep one message, too.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        lanes: Sequence[Lane],
        asked: Callable[[int, Sequence[Request]], None],
        too_late: Callable[[int, Sequence[Request]], None],
        failed: Callable[[RosError], None],
        marks: Callable[[], Lease | None] = lambda: None,
    ) -> None:
        super().__init__(context, peer, lanes, failed)
        self._marks = marks
        self.servers: dict[int, ServiceServer] = {}
        self.publishers: dict[int, VolatileTopic] = {}
        self._ways: list[Via] = []
        self._announced: dict[int, bytes] = {}
        self._asked = asked
        self._too_late = too_late

    def announce(self, ways: list[Via]) -> None:
        """Say by which bridges the answers come, of what is offered and will be.

        Args:
            ways: by lane.

        Raises:
            RosError: there are too many.
        """
        if ways != self._ways:
            self._ways = ways
            for lane, kind in self.types.items():
                self._announce(lane, kind)

    def _announce(self, lane: int, kind: LaneType) -> None:
        announcements = self._context.announcements
        if lane in self._announced:
            announcements.withdraw(self._announced.pop(lane))
        self._announced[lane] = announcements.offer(
            self._names[lane], self._peer.name, kind.type_name, kind.type_hash, self._ways[lane]
        )

    def _open_service(self, lane: int, name: str, kind: LaneType) -> ServiceServer:
        self._announce(lane, kind)  # first: others must not take it for a node's
        sink, failed = self._sink(lane, self._asked, self._too_late)
        put = sink.put
        if (lease := self._marks()) is not None:
            marker = Marker(lease, self._context.ros.turns, BATCH)

            def put(batch: Sequence[Request]) -> None:
                sink.put(marker.marked(batch))

        server = self._context.ros.serve(name, kind.type_name, kind.type_hash, put, failed)
        self.servers[lane] = server
        return server

    def _open_topic(self, lane: int, name: str, kind: LaneType) -> VolatileTopic:
        qos = self._lanes[lane].qos
        assert qos is not None
        context, budget = self._context, self._peer.budget.unacknowledged
        publisher = context.ros.advertise(name, kind.type_name, kind.type_hash, qos, self._peer.name)
        self.publishers[lane] = bounded = VolatileTopic(publisher, qos.depth, budget, context.now)
        return bounded

    def close(self, keep: Collection[int] = ()) -> None:
        """Offer nothing any more, but the lanes to keep."""
        super().close(keep)
        for lane in [each for each in self._announced if each not in keep]:
            self._context.announcements.withdraw(self._announced.pop(lane))
        self.servers = {lane: server for lane, server in self.servers.items() if lane in keep}
        self.publishers = {lane: publisher for lane, publisher in self.publishers.items() if lane in keep}
