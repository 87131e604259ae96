"""The offer of what the other side provides: services and publishers here, as long as it can answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, Stage
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import BATCH, RosError
from rsb_bridge.route.calls.call_endpoints import OpenLane, OpenLanes
from rsb_bridge.route.calls.call_frames import from_wrong_side
from rsb_bridge.route.calls.call_servers import LocalServers, others_called, types_clash, way_here
from rsb_bridge.route.calls.calls_end import Trouble
from rsb_bridge.route.calls.lane_types import TypeComparison
from rsb_bridge.route.combined_verdict import named, node_names
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.source_publishers import SlowSubscriberError, VolatileTopic
from rsb_bridge.wire.headers import What
from rsb_bridge.wire.messages import Provide

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import ExitStack

    from rsb_bridge.model.calls import ServiceMember
    from rsb_bridge.model.hops import Via
    from rsb_bridge.ros.ros_interface import Request, ServiceServer
    from rsb_bridge.route.calls.asked_calls import AskedCalls
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.wire.headers import CallFrame

_UNKNOWN = Provide(route=0)
"""Before the other side has sent what it provides."""


class OfferedService(OpenLane):
    """A service that others can call, on the callers' side."""

    _owner: ServiceOffer
    server: ServiceServer

    def _open(self, held: ExitStack) -> None:
        context, arming = self._route.context, self._route.arming
        self._via: Via | None = None
        self._announcement = b""
        held.callback(self._withdraw)
        self.announce()  # first: others must not take it for a node's
        put = self._put
        if arming.required and arming.lease is not None:
            marker = Marker(arming.lease, context.ros.turns, BATCH)

            def put(batch: Sequence[Request]) -> None:
                self._put(marker.marked(batch))

        self.server = context.ros.serve(self._name, *self.version, put, self._failed, self._route.peer.name)
        held.callback(self.server.close)

    def announce(self) -> None:
        """Announce which bridges the answers cross, if that has changed.

        Raises:
            RosError: there are too many.
        """
        if (via := self._owner.via_of(self.lane)) != self._via:
            self._via = via
            self._withdraw()
            announcements, link = self._route.context.announcements, self._route.peer.name
            self._announcement = announcements.offer(self._name, link, *self.version, via)

    def _withdraw(self) -> None:
        self._route.context.announcements.withdraw(self._announcement)

    def offer(self, batch: Sequence[Request]) -> None:
        if self._is_open:
            self._owner.calls.asked(self.lane, self.server, batch)
        else:
            self._owner.calls.asked_too_late(batch)


class OfferedTopic(OpenLane):
    """A publisher, on the callers' side.

    Attributes:
        publisher: bounds the memory that DDS holds for subscribers.
    """

    _owner: ServiceOffer
    publisher: VolatileTopic

    def _open(self, held: ExitStack) -> None:
        context, peer, spec = self._route.context, self._route.peer, self._spec()
        publisher = context.ros.advertise(spec, peer.name)
        self.publisher = VolatileTopic(publisher, spec.qos.depth, peer.budget.unacknowledged, context.now)
        held.callback(self.publisher.close)

    def publish(self, content: bytes) -> None:
        """Publish a message, or report why that is impossible."""
        try:
            self.publisher.publish(content)
        except RosError as error:
            self._route.notices.message_error(EventCode.ROUTE_PUBLISH_FAILED, str(error))
        except SlowSubscriberError as error:
            self._route.notices.message_error(EventCode.ROUTE_SLOW_SUBSCRIBER, str(error))


def _why_unacceptable(provide: Provide, members: Sequence[ServiceMember], agreed_type: str) -> str:
    """Return the reason why the other side's list breaks the agreement between the two sides, or an empty string."""
    if provide.lanes and len(provide.lanes) != len(members):
        return f"the other side provides {len(provide.lanes)} lanes, not {len(members)}"
    for member, entry in zip(members, provide.lanes, strict=False):
        agreed = member.type_in(agreed_type)
        if agreed and entry.type != agreed and not member.is_topic:  # whether it requires arming may depend on this
            return f"the other side provides {entry.type}, though {agreed} was agreed on"
    return ""


class ServiceOffer:
    """The servers and publishers here that stand for the other side's.

    Attributes:
        calls: the calls of its callers.
        lanes: its services and publishers.
        reach: the lanes that are offered, and whose calls go to the other side.
        provided: the other side's list of what can be called, in the present opening.
        warning: the trouble that does not keep it from being offered, or None.
    """

    def __init__(self, flow: CallsFlow, types: LaneTypes, calls: AskedCalls) -> None:
        self._flow, self._route, self._carried, self._types = flow, flow.route, flow.carried, types
        self.calls = calls
        self.lanes = OpenLanes(flow, self, OfferedService, OfferedTopic)
        self.reach: frozenset[int] = frozenset()
        self.provided = _UNKNOWN
        self.warning: Trouble | None = None
        self._trouble: Trouble | None = None  # that keeps it from being offered here
        self._comparison = TypeComparison(flow.route)
        self._local_servers = LocalServers(flow.route)
        self._served_here: list[str] = []  # nodes that serve it on this side, while none does on the other side
        self._kept: dict[int, bytes] = {}  # the last messages of latched topics, by lane

    def take(self, provide: Provide) -> str:
        """Take the other side's list of what can be called, or return the reason why it breaks the agreement."""
        if why := _why_unacceptable(provide, self._flow.members, self._route.proposal.type):
            return why
        had_server, self.provided = self.has_servers, provide
        if not self.lanes.services:
            self._route.context.place(self._route, provide.nodes)
        if had_server and not self.has_servers:
            self.calls.kind.server_gone()
        return ""

    @property
    def has_servers(self) -> bool:
        """Whether the other side has servers of all services."""
        entries = self.provided.lanes
        if not entries or not self._route.peer.bridges:
            return False
        return all(
            entry.providers for member, entry in zip(self._flow.members, entries, strict=True) if not member.is_topic
        )

    # --- offering

    def proceed(self) -> None:
        """Offer what can be called, or withdraw it."""
        self._find_callers()
        lanes = self._to_offer()
        if not lanes:
            self.lanes.retry.clear()
            self._end()
        # What is offered stays offered while it is unclear whether a server of this bridge's name is a dead process's.
        elif (self.reach or not self._local_servers.unknown) and not self.lanes.retry.waits(self.provided.lanes):
            self._offer(lanes)

    def _find_callers(self) -> None:
        """Find the callers, and what keeps it from being offered here."""
        members, types, ros = self._flow.members, self._types, self._route.context.ros
        names = [member.name_on(self._route.local_topic) for member in members]
        services = [name for member, name in zip(members, names, strict=True) if not member.is_topic]
        callers = {service: ros.callers(service) for service in services}
        self._carried.endpoints = [each for found in callers.values() for each in found]
        self._trouble = self.warning = None
        if entries := self.provided.lanes:
            self._carried.type_name, self._carried.type_hash = types.know(entries)
            self.warning = others_called(members, entries, names, callers)
            self._trouble = self._local_servers.find_trouble(services, offered=bool(self.reach))
            if self._trouble is None and types.load(entries):
                self._trouble = types_clash(ros, members, entries, names, callers, self._comparison)
        nobody_provides = self.provided is not _UNKNOWN and not entries
        self._served_here = self._local_servers.nodes(services) if nobody_provides else []

    def _to_offer(self) -> frozenset[int]:
        """Return the lanes that can be offered now."""
        route = self._route
        if self._trouble is not None or route.notices.loop or not (route.connected and self.has_servers):
            return frozenset()
        if not self._types.load(self.provided.lanes):
            return frozenset()
        # Until the other side has heard of the end of the pause, it refuses calls.
        limited_too = route.crossing.flows and self.provided.pause_revision >= route.pausing.unpaused
        return frozenset(
            number for number, member in enumerate(self._flow.members) if limited_too or not member.limited
        )

    def _offer(self, reach: frozenset[int]) -> None:
        """Offer these lanes of what is provided, and no others."""
        lanes, entries = self.lanes, self.provided.lanes
        try:
            for service in lanes.services.values():
                service.announce()
            if len(lanes.fitting(entries)) < len(lanes.services):
                self._end()
            was_offered = self.offered
            # No request is older than the first server: an earlier stamp shows a caller's wrong clock.
            if not lanes.services:
                self._route.age.publishers.since = self._route.context.stamps.now()
            lanes.open(entries, reach | self._owed())
            self.reach = reach
            self._log(was_offered)
            self.calls.send_again(self._servers)
            for topic in lanes.open_topics(entries):
                if topic.lane in self._kept:
                    topic.publish(self._kept[topic.lane])
        except RosError as error:
            self.failed(error)
            return
        lanes.retry.clear()

    @property
    def _servers(self) -> dict[int, ServiceServer]:
        return {lane: each.server for lane, each in self.lanes.services.items()}

    def _owed(self) -> set[int]:
        """Return the lanes on which callers still wait for an answer: it needs their servers."""
        return self.calls.lanes & self.lanes.services.keys()

    def via_of(self, lane: int) -> Via:
        """Return the bridges that a lane's answers cross."""
        name = self._flow.members[lane].name_on(self._route.remote_topic)
        return way_here(self.provided.via, self._route.peer.bridges, name)

    def _log(self, was_offered: bool) -> None:
        """Log that it is offered now, or no longer."""
        offered = self.offered
        if offered and not was_offered:
            text = f"offered here; calls go over {self._route.transport.name}"
            self._route.log(Level.INFO, EventCode.ROUTE_OFFERED, text)
        elif was_offered and not offered:
            self._route.log(Level.INFO, EventCode.ROUTE_WITHDRAWN, "no longer offered")

    def failed(self, error: RosError) -> None:
        self._end()
        self.lanes.failed(f"cannot be offered here: {error}")

    def _end(self) -> None:
        """Withdraw the offer, and give up the calls that were asked since the opening began."""
        if self.reach:
            was_offered = self.offered
            self.withdraw()
            self._log(was_offered)
        self.calls.give_up("it is no longer offered")

    def move(self) -> bool:
        """Offer it again by another node, unless callers wait for an answer; return whether that was done."""
        if self._owed():
            return False
        self.lanes.close()
        self._route.advance()
        return True

    def withdraw(self) -> None:
        """Close everything by which callers see that it can be reached."""
        self.reach = frozenset()
        self.lanes.close()
        self._local_servers.close()

    def close(self) -> None:
        """End the opening: what the other side provides is unknown again."""
        self.withdraw()
        self._trouble = self.warning = None
        self.lanes.retry.clear()
        self.provided = _UNKNOWN
        self._comparison.forget()
        self._route.peer.budget.kept.give(sum(map(len, self._kept.values())))
        self._kept.clear()

    def act(self) -> None:
        """Have the next server asked, and close services that stayed open only for answers, once nobody waits."""
        if self.calls.lost:
            self.calls.ask_next(self._servers)
        open_lanes = self.lanes.services.keys()
        if self.reach and not open_lanes <= self.reach and open_lanes - self.reach - self._owed():
            self._route.advance()

    # --- messages

    def receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        """Publish a message of a lane that is a topic."""
        if frame.what is not What.MESSAGE:
            raise from_wrong_side(frame)
        if not readable or self._types.malformed(frame, "") is not None or not self.calls.kind.publishes(frame):
            return
        qos = self._flow.members[frame.lane].qos
        if qos is not None and qos.latched:
            kept, budget = self._kept, self._route.peer.budget.kept
            budget.give(len(kept.pop(frame.lane, b"")))
            if budget.take(len(frame.content)):
                kept[frame.lane] = frame.content
        if (topic := self.lanes.topics.get(frame.lane)) is not None:
            topic.publish(frame.content)

    # --- facts

    @property
    def offered(self) -> bool:
        return bool(self.reach) and self.reach.issuperset(range(len(self._flow.members)))

    def nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return node_names(self._carried.endpoints), self.provided.nodes

    @property
    def nodes_there(self) -> tuple[str, ...]:
        return self.provided.nodes

    def at_node(self) -> tuple[int, int]:
        report = self._flow.report
        return (report.given, report.waiting) if report is not None else (0, 0)

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called; of an absent server, with the node here that may be meant."""
        route = self._route
        if not self._served_here or route.judged.peer.cause != Cause.NO_SERVER:
            return self._trouble or self.lanes.retry.trouble
        text = (
            f"nobody serves {route.remote_topic} on the providing side, but {named(self._served_here)} serves "
            f"{route.local_topic} on the callers' side: if that node is meant, set provider: "
            f"{'client' if route.spec.provider == 'server' else 'server'}"
        )
        return Trouble(Cause.NO_SERVER, text)

    def stages(self) -> tuple[Stage, Stage, Stage]:
        served, type_name = None if self.provided is _UNKNOWN else self.has_servers, self._carried.type_name
        seen = ", ".join(self.provided.nodes)
        if served is False:
            seen = self._route.judged.peer.text or f"no server of {self._route.remote_topic} on the other side"
        trouble = self._trouble or self.lanes.retry.trouble
        return (
            Stage("server seen", served, seen),
            Stage("type known", bool(type_name) or None, type_name),  # if not, the other side knows why
            Stage("offered", False if trouble else self.offered or None, trouble.text if trouble else ""),
        )
