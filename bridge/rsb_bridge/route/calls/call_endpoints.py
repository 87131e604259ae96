"""The endpoints of a route of calls in ROS, by lane: clients and subscriptions, or services and publishers."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, TypeVar

from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import BATCH, TopicSpec
from rsb_bridge.route.calls.calls_verdict import Trouble
from rsb_bridge.route.calls.kept_calls import result_request
from rsb_bridge.route.calls.paced_client import PacedClient
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.peer import TypeUse
from rsb_bridge.route.source_publishers import VolatileTopic

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import ServiceMember
    from rsb_bridge.model.names import Via
    from rsb_bridge.ros.ros_interface import (
        OnFailure,
        RawMessage,
        Request,
        Response,
        RosError,
        ServiceServer,
    )
    from rsb_bridge.route.lease import LeaseHalf
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.wire.records import LaneEntry

T = TypeVar("T")

_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s between attempts, at first and at most. Round figures: nothing announces that ROS would take an endpoint now."""
_HEALED_AFTER = 60.0
"""s without a failure after which the first delay applies again: twice the longest delay."""


def name_of(member: ServiceMember, route_name: str) -> str:
    """Return the name of a lane's service or topic: ``/navigate/_action/send_goal``."""
    return member.absolute or route_name + member.suffix


def type_of(member: ServiceMember, route_type: str) -> str:
    """Return a lane's type, ``pkg/action/Navigate_SendGoal``, or an empty string if it is not known.

    Most lanes' types depend on the route's.
    """
    return member.type_name or (route_type + member.type_suffix if route_type else "")


def route_type_of(member: ServiceMember, lane_type: str) -> str:
    """Return the route's type, derived from a lane's, or an empty string if they are independent."""
    if member.type_name or not lane_type.endswith(member.type_suffix):
        return ""
    return lane_type.removesuffix(member.type_suffix)


class LaneType(NamedTuple):
    """The type of a lane's endpoints."""

    type_name: str
    type_hash: str


class Closable(Protocol):
    """An endpoint."""

    def close(self) -> None:
        """Free its resources. May be called twice."""


class LaneSink(Generic[T]):
    """Passes messages, requests or responses of one lane from the ROS thread to the I/O loop.

    Args:
        lane: its place among the route's members.
        taken: gets them, on the I/O loop, as long as the sink is open.
        late: gets them after that, or None to drop them.

    Attributes:
        put: passes a batch on; called on the ROS thread.
    """

    def __init__(
        self,
        context: Context,
        lane: int,
        taken: Callable[[int, Sequence[T]], None],
        late: Callable[[int, Sequence[T]], None] | None = None,
    ) -> None:
        self.open = True
        self.put: Callable[[Sequence[T]], None] = partial(context.ros_queue.put, self)
        self._lane = lane
        self._taken = taken
        self._late = late

    def offer(self, batch: Sequence[T]) -> None:
        """Take a batch; called on the I/O loop."""
        if self.open:
            self._taken(self._lane, batch)
        elif self._late is not None:
            self._late(self._lane, batch)


class LaneEndpoints:
    """The endpoints of one route's lanes on this side.

    Services open and close together; a topic opens once its type has been found.

    Args:
        failed: called, on the I/O loop, for an endpoint that has failed and closed itself.

    Attributes:
        types: of the services that are open, by lane.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        members: Sequence[ServiceMember],
        failed: Callable[[RosError], None],
    ) -> None:
        self.types: dict[int, LaneType] = {}
        self._context = context
        self._peer = peer
        self._members = members
        self._failed = failed
        self._names: Sequence[str] = ()
        self._endpoints: dict[int, Closable] = {}
        self._sinks: dict[int, LaneSink[object]] = {}
        self._uses: dict[int, TypeUse] = {}

    def __bool__(self) -> bool:
        """Whether all services are open."""
        return len(self.types) == sum(not member.is_topic for member in self._members)

    # --- what the sides do differently

    def _open_service(self, lane: int, name: str, kind: LaneType) -> Closable:
        """Open a lane's service or client."""
        raise NotImplementedError

    def _open_topic(self, lane: int, name: str, kind: LaneType) -> Closable:
        """Open a lane's publisher or subscription."""
        raise NotImplementedError

    # --- what is the same

    def services_of(self, entries: Sequence[LaneEntry]) -> dict[int, LaneType]:
        """Return what `types` will be if all these services are open."""
        return {
            number: LaneType(entry.type, entry.type_hash)
            for number, (member, entry) in enumerate(zip(self._members, entries, strict=True))
            if not member.is_topic
        }

    def open(self, entries: Sequence[LaneEntry], names: Sequence[str], lanes: Collection[int] | None = None) -> None:
        """Open the services. Topics stay open, and so do services of the right type.

        Args:
            names: of the lanes' services and topics on this side.
            lanes: the services to have open, or None for all.

        Raises:
            RosError: one cannot be opened; nothing is left open.
        """
        services = self.services_of(entries)
        wanted = {lane: kind for lane, kind in services.items() if lanes is None or lane in lanes}
        # Then the topics close, too: the types of most follow from the route's.
        if any(services[lane] != kind for lane, kind in self.types.items()):
            self.close(keep=[lane for lane, kind in self.types.items() if wanted.get(lane) == kind])
        else:
            self.close(keep=[lane for lane in self._uses if lane in wanted or self._members[lane].is_topic])
        self._names = names
        opened = False
        try:
            for lane, kind in wanted.items():
                if lane not in self._endpoints:
                    # First, as for topics: `close` goes through the uses, also if ROS refuses the endpoint.
                    self._use(lane, kind, is_service=True)
                    self._endpoints[lane] = self._open_service(lane, names[lane], kind)
                    self.types[lane] = kind
            opened = True
        finally:
            if not opened:
                self.close()

    def open_topics(self, entries: Sequence[LaneEntry]) -> list[int]:
        """Open the topics whose types are known by now.

        Returns:
            The lanes that were opened.

        Raises:
            RosError: one cannot be opened.
        """
        new = []
        for number, (member, entry) in enumerate(zip(self._members, entries, strict=True)):
            if member.is_topic and number not in self._endpoints and entry.type_hash:
                kind = LaneType(entry.type, entry.type_hash)
                self._use(number, kind, is_service=False)
                self._endpoints[number] = self._open_topic(number, self._names[number], kind)
                new.append(number)
        return new

    def _use(self, lane: int, kind: LaneType, *, is_service: bool) -> None:
        self._uses[lane] = use = TypeUse(self._context.ros, self._peer.budget.types)
        use.begin(kind.type_name, kind.type_hash, is_service=is_service)

    def _sink(
        self,
        lane: int,
        taken: Callable[[int, Sequence[T]], None],
        late: Callable[[int, Sequence[T]], None] | None = None,
    ) -> tuple[LaneSink[T], OnFailure]:
        """Return a sink for a lane's endpoint, and the function that the endpoint calls if it fails."""
        context, sink = self._context, LaneSink(self._context, lane, taken, late)
        self._sinks[lane] = sink  # type: ignore[assignment]  # they are only closed

        def failed(error: RosError) -> None:
            # Not if another endpoint is in its place by then.
            context.call(lambda: self._endpoint_failed(lane, error) if sink.open else None)

        return sink, failed

    def _endpoint_failed(self, lane: int, error: RosError) -> None:
        """Handle that an endpoint has closed itself; it may not outlive the interruption that follows, others may."""
        self._failed(error)
        self.close(keep=[each for each in self._uses if each != lane])

    def close(self, keep: Collection[int] = ()) -> None:
        """Close the endpoints of all lanes, except the lanes to keep."""
        for lane in [each for each in self._uses if each not in keep]:
            if (sink := self._sinks.pop(lane, None)) is not None:
                sink.open = False
            if (end := self._endpoints.pop(lane, None)) is not None:
                end.close()
            self._uses.pop(lane).end()
            self.types.pop(lane, None)


class Clients(LaneEndpoints):
    """Clients of services, and subscriptions to topics, of one providing half.

    Args:
        responded: gets a lane's responses.
        published: gets a lane's messages.
        failed: called for a client or a subscription that has failed and closed itself.

    Attributes:
        node: the node with the parameters, or empty unless the route is of parameters.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        members: Sequence[ServiceMember],
        responded: Callable[[int, Sequence[Response]], None],
        published: Callable[[int, Sequence[RawMessage]], None],
        failed: Callable[[RosError], None],
    ) -> None:
        super().__init__(context, peer, members, failed)
        self.clients: dict[int, PacedClient] = {}
        self.node = ""
        self._responded = responded
        self._published = published

    @property
    def ready(self) -> bool:
        """Whether a call on every lane would reach a server."""
        return bool(self.clients) and all(client.ready for client in self.clients.values())

    def _open_service(self, lane: int, name: str, kind: LaneType) -> PacedClient:
        sink, failed = self._sink(lane, self._responded)
        client = self._context.ros.call_service(name, kind.type_name, kind.type_hash, sink.put, failed)
        # A server answers at once that it knows no such goal.
        probe = result_request(bytes(16)) if self._members[lane].patient else b""
        self.clients[lane] = paced = PacedClient(client, self._context.loop, probe)
        return paced

    def _open_topic(self, lane: int, name: str, kind: LaneType) -> Closable:
        qos = self._members[lane].qos
        assert qos is not None
        sink, failed = self._sink(lane, self._published)
        context, link = self._context, self._peer.name
        spec = TopicSpec(name, *kind, qos)
        if self.node:  # all nodes publish their events on one topic: the link's routes share a subscription
            return context.parameter_events.listen(spec, link, self.node, sink.put, failed)
        return context.ros.subscribe(spec, sink.put, link, failed)

    def close(self, keep: Collection[int] = ()) -> None:
        """Close the clients and subscriptions of all lanes, except the lanes to keep."""
        super().close(keep)
        self.clients = {lane: client for lane, client in self.clients.items() if lane in keep}


class Offers(LaneEndpoints):
    """Services that others can call, and publishers, of one callers' half.

    Args:
        asked: gets a lane's requests.
        too_late: gets requests that come after the offer has ended.
        failed: called for a server that has failed and closed itself.
        marks: returns the lease that requests are marked with, or None without arming.

    Attributes:
        publishers: by lane; the memory that DDS holds for their subscribers is bounded.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        members: Sequence[ServiceMember],
        asked: Callable[[int, Sequence[Request]], None],
        too_late: Callable[[int, Sequence[Request]], None],
        failed: Callable[[RosError], None],
        marks: Callable[[], LeaseHalf | None] = lambda: None,
    ) -> None:
        super().__init__(context, peer, members, failed)
        self._marks = marks
        self.servers: dict[int, ServiceServer] = {}
        self.publishers: dict[int, VolatileTopic] = {}
        self._vias: list[Via] = []
        self._announced: dict[int, bytes] = {}
        self._asked = asked
        self._too_late = too_late

    def announce(self, vias: list[Via]) -> None:
        """Announce which bridges the answers cross, for present and later offers.

        Args:
            vias: the bridges, by lane.

        Raises:
            RosError: there are too many.
        """
        if vias != self._vias:
            self._vias = vias
            for lane, kind in self.types.items():
                self._announce(lane, kind)

    def _announce(self, lane: int, kind: LaneType) -> None:
        announcements = self._context.announcements
        if lane in self._announced:
            announcements.withdraw(self._announced.pop(lane))
        self._announced[lane] = announcements.offer(
            self._names[lane], self._peer.name, kind.type_name, kind.type_hash, self._vias[lane]
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
        qos = self._members[lane].qos
        assert qos is not None
        context, budget = self._context, self._peer.budget.unacknowledged
        publisher = context.ros.advertise(TopicSpec(name, *kind, qos), self._peer.name)
        self.publishers[lane] = bounded = VolatileTopic(publisher, qos.depth, budget, context.now)
        return bounded

    def close(self, keep: Collection[int] = ()) -> None:
        """Close the services and publishers of all lanes, except the lanes to keep."""
        super().close(keep)
        for lane in [each for each in self._announced if each not in keep]:
            self._context.announcements.withdraw(self._announced.pop(lane))
        self.servers = {lane: server for lane, server in self.servers.items() if lane in keep}
        self.publishers = {lane: publisher for lane, publisher in self.publishers.items() if lane in keep}


class RosRetry:
    """Delays new attempts after ROS has refused an endpoint.

    Args:
        try_again: called when a delay is over.

    Attributes:
        trouble: the last failure, or None once an attempt has succeeded.
    """

    def __init__(self, context: Context, try_again: Callable[[], None]) -> None:
        self.trouble: Trouble | None = None
        self._context = context
        self._try_again = try_again
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._failed_at = float("-inf")
        self._entries: Sequence[LaneEntry] = ()
        self._timer: asyncio.TimerHandle | None = None

    def waits(self, entries: Sequence[LaneEntry]) -> bool:
        """Return whether endpoints of these types failed so lately that it is too early for a new attempt."""
        return self._timer is not None and entries == self._entries

    def failed(self, text: str, entries: Sequence[LaneEntry]) -> None:
        """Note that endpoints of these types could not be made, or closed themselves, for a reason in words."""
        now = self._context.now()
        if now - self._failed_at >= _HEALED_AFTER:
            self._backoff.reset()
        self._failed_at, self._entries = now, entries
        self.trouble = Trouble(Cause.OFFER_FAILED, f"{text}; trying again")
        self._stop()
        self._timer = self._context.loop.call_later(self._backoff.next(), self._due)

    def clear(self) -> None:
        """Note that all endpoints that are wanted exist."""
        self.trouble = None
        self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._try_again()
