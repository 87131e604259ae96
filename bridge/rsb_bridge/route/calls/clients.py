"""What the providing side has in ROS for a route of calls: clients of services, and subscriptions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.route.calls.lane_ends import LaneEnds

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.ros.ros_interface import RawMessage, Response, RosError, ServiceClient
    from rsb_bridge.route.calls.lane_ends import Closable, LaneType
    from rsb_bridge.route.peer import Peer


class Clients(LaneEnds):
    """All of one route's, while there is somebody to call.

    Args:
        context: what every part of the engine shares.
        peer: whose callers ask.
        lanes: of the route.
        responded: gets a lane's responses.
        published: gets a lane's messages.
        failed: told of a client or a subscription that has failed and closed itself.

    Attributes:
        clients: by lane.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        lanes: Sequence[Lane],
        responded: Callable[[int, Sequence[Response]], None],
        published: Callable[[int, Sequence[RawMessage]], None],
        failed: Callable[[RosError], None],
    ) -> None:
        super().__init__(context, peer, lanes, failed)
        self.clients: dict[int, ServiceClient] = {}
        self._responded = responded
        self._published = published

    @property
    def ready(self) -> bool:
        """Whether a call of any lane reaches a server."""
        return bool(self.clients) and all(client.ready for client in self.clients.values())

    def _open_service(self, lane: int, name: str, kind: LaneType) -> ServiceClient:
        sink, failed = self._sink(lane, self._responded)
        client = self._context.ros.call_service(name, kind.type_name, kind.type_hash, sink.put, failed)
        self.clients[lane] = client
        return client

    def _open_topic(self, lane: int, name: str, kind: LaneType) -> Closable:
        qos = self._lanes[lane].qos
        assert qos is not None
        sink, failed = self._sink(lane, self._published)
        ros = self._context.ros
        return ros.subscribe(name, kind.type_name, kind.type_hash, qos, sink.put, self._peer.name, failed)

    def close(self, keep: Collection[int] = ()) -> None:
        """Call nobody any more, but the lanes to keep."""
        super().close(keep)
        self.clients = {lane: client for lane, client in self.clients.items() if lane in keep}
