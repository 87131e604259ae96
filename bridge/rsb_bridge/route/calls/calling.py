"""The callers' half of a route of calls: offers here what the other side provides, and answers callers.

A call goes through `CallingRoute.asked` (from ROS), `_begin`, and the outbox to the channel. What the provider says of
it comes to `_receive`, and goes to ROS in `_answer_caller`, or ends the call in `_end_refused`.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_interface import BATCH, Request, RosError
from rsb_bridge.route.calls.call_endpoints import OpenLane, OpenLanes
from rsb_bridge.route.calls.call_servers import LocalServers, others_called, types_clash, way_here
from rsb_bridge.route.calls.calls_ledger import refused_as
from rsb_bridge.route.calls.calls_route import CallsRoute, from_wrong_side
from rsb_bridge.route.calls.calls_verdict import CallsProgress, Trouble
from rsb_bridge.route.calls.lane_types import TypeComparison
from rsb_bridge.route.calls.manual_call import CallError, ManualCall
from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.gates import CallRateGate, calling_gates, chained, compose_when_switched
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.source_publishers import SlowSubscriberError, VolatileTopic
from rsb_bridge.route.topic_verdict import named
from rsb_bridge.wire.headers import CallFrame, What, frame_size
from rsb_bridge.wire.messages import Provide
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import ExitStack

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import ServiceMember
    from rsb_bridge.model.names import Via
    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import ServiceServer
    from rsb_bridge.route.calls.kept_calls import KeptCall
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import CallsReport, LaneEntry

_UNKNOWN = Provide(route=0)
"""Before the other side has sent what it provides."""


class OfferedService(OpenLane):
    """A service that others can call, on the callers' side."""

    _route: CallingRoute
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

        self.server = context.ros.serve(self._name, *self.version, put, self._failed)
        held.callback(self.server.close)

    def announce(self) -> None:
        """Announce which bridges the answers cross, if that has changed.

        Raises:
            RosError: there are too many.
        """
        if (via := self._route.via_of(self.lane)) != self._via:
            self._via = via
            self._withdraw()
            announcements, link = self._route.context.announcements, self._route.peer.name
            self._announcement = announcements.offer(self._name, link, *self.version, via)

    def _withdraw(self) -> None:
        self._route.context.announcements.withdraw(self._announcement)

    def offer(self, batch: Sequence[Request]) -> None:
        if self._is_open:
            self._route.asked(self, batch)
        else:
            self._route.asked_too_late(batch)


class OfferedTopic(OpenLane):
    """A publisher, on the callers' side.

    Attributes:
        publisher: bounds the memory that DDS holds for subscribers.
    """

    _route: CallingRoute
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


@dataclass(slots=True)
class CallerCall(PendingCall):
    """A call of a caller on this side.

    Attributes:
        server: took it, or is an operator's `ManualCall`.
        caller: names the request in `server.answer`.
        kept: the request of an action's call, which may have to be sent again; None for other calls.
    """

    server: ServiceServer | ManualCall
    caller: bytes
    kept: KeptCall | None = None


class CallerCalls(PendingCalls[CallerCall]):
    """The calls of one callers' half that wait for answers, numbered as they are sent.

    Attributes:
        last: number of the newest one in the present opening.
    """

    last = 0

    def begin(self, call: CallerCall, timeout: float | None) -> int:
        """Number a call, which expires after `timeout` s, or never if that is None."""
        self.last += 1
        self.add(self.last, call, timeout)
        return self.last

    def end_by(self, frame: CallFrame) -> CallerCall | None:
        """End the call that a frame is about, and return it, or None if it has ended before.

        Raises:
            ProtocolError: it was never made, or not on that lane.
        """
        call = self.get(frame.call)
        if call is None and not 0 < frame.call <= self.last:
            raise ProtocolError(f"an answer to call {frame.call}, which was never made")
        if call is not None and call.lane != frame.lane:
            raise ProtocolError(f"call {frame.call} is answered on lane {frame.lane}, not {call.lane}")
        return self.end(frame.call)


class LandedText(Wording):
    """The progress of a call without an answer on the other side."""

    GIVEN = "it was given to DDS there, so the node may have acted on it"
    UNREPORTED = "not reported whether it was given to DDS there: the node may have acted on it"


def _landed(number: int, report: CallsReport | None) -> str:
    """Return how far a call without an answer got, as the other side has reported it, once a second."""
    given = report is not None and number <= report.given
    return (LandedText.GIVEN if given else LandedText.UNREPORTED)()


def _why_unacceptable(provide: Provide, members: Sequence[ServiceMember], agreed_type: str) -> str:
    """Return the reason why the other side's list breaks the agreement between the two sides, or an empty string."""
    if provide.lanes and len(provide.lanes) != len(members):
        return f"the other side provides {len(provide.lanes)} lanes, not {len(members)}"
    for member, entry in zip(members, provide.lanes, strict=False):
        agreed = member.type_in(agreed_type)
        if agreed and entry.type != agreed and not member.is_topic:  # whether it requires arming may depend on this
            return f"the other side provides {entry.type}, though {agreed} was agreed on"
    return ""


class CallingRoute(CallsRoute):
    """Offers services and publishes topics here, as long as the other side can answer.

    It has more than 40 methods because calls come from ROS and answers from the peer, and either may end before a call
    does.
    """

    outgoing: ClassVar[bool] = True

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._provided = _UNKNOWN  # in the present opening
        self._comparison = TypeComparison(self)
        self._resumed_at = 0  # the revision of the pause's end, in the present opening
        self._reach: frozenset[int] = frozenset()  # the lanes that are offered, and whose calls go to the other side
        self._offers = OpenLanes(self, OfferedService, OfferedTopic)
        self._local_servers = LocalServers(self)
        self._served_here: list[str] = []  # nodes that serve it on this side, while none does on the other side
        self._pending: CallerCalls = CallerCalls(context.loop, peer.budget.asked, self._expired, self._outbox.forget)
        self._kept_messages: dict[int, bytes] = {}  # the last ones of latched topics, by lane
        self._rate = CallRateGate(0.0, context.now())
        compose_when_switched(self, self._compose_gates)

    def _compose_gates(self) -> None:
        if self._rate.rate != self.limit.rate:
            self._rate = CallRateGate(self.limit.rate, self.context.now())
        gates = [calling_gates(self, self._outbox, self._rate, limited=limited) for limited in (False, True)]
        self._arriving = [chained(each.arriving) for each in gates]
        self._leaving = [chained(each.leaving) for each in gates]

    # --- offering

    def provided(self, provide: Provide) -> None:
        """Take the providing side's list of what can be called."""
        if text := _why_unacceptable(provide, self.members, self.proposal.type):
            self.request_reopen(EventCode.ROUTE_CALLS_BROKEN, text, Level.ERROR)
        else:
            self._provided = provide
            self.advance()

    def _advance(self) -> None:
        """Open the channel, and offer what can be called, or withdraw it."""
        if not self.life.accepted:
            return
        if self.channel is None:
            self.peer.open_channel(self)
        self._find_callers()
        lanes = self._to_offer()
        if not lanes:
            self._retry.clear()
            self._end_offer()
        # What is offered stays offered while it is unclear whether a server of this bridge's name is a dead process's.
        elif (self._reach or not self._local_servers.unknown) and not self._retry.waits(self._provided.lanes):
            self._offer(lanes)
        self._verdict = None

    def _find_callers(self) -> None:
        """Find the callers, and what keeps it from being offered here."""
        ros, names = self.context.ros, [member.name_on(self.local_topic) for member in self.members]
        services = [name for member, name in zip(self.members, names, strict=True) if not member.is_topic]
        callers = {service: ros.callers(service) for service in services}
        self.endpoints = [each for found in callers.values() for each in found]
        self._unavailable = self.warning = None
        if entries := self._provided.lanes:
            self.type_name, self.type_hash = self.types.know(entries)
            self.warning = others_called(self.members, entries, names, callers)
            self._unavailable = self._local_servers.find_trouble(services, offered=bool(self._reach))
            if self._unavailable is None and self.types.load(entries):
                self._unavailable = types_clash(ros, self.members, entries, names, callers, self._comparison)
        nobody_provides = self._provided is not _UNKNOWN and not entries
        self._served_here = self._local_servers.nodes(services) if nobody_provides else []

    def _to_offer(self) -> frozenset[int]:
        """Return the lanes that can be offered now."""
        if self._unavailable is not None or self.notices.loop or not (self.connected and self._has_providers):
            return frozenset()
        if not self.types.load(self._provided.lanes):
            return frozenset()
        # Until the other side has heard of the end of the pause, it refuses calls.
        limited_too = self.crossing.flows and self._provided.pause_revision >= self._resumed_at
        return frozenset(number for number, member in enumerate(self.members) if limited_too or not member.limited)

    def _paused(self, was: bool) -> None:
        if was and not self.pausing.paused and self.id:
            self._resumed_at = self.pausing.revision
        super()._paused(was)

    @property
    def _has_providers(self) -> bool:
        entries = self._provided.lanes
        if not entries or not self.peer.bridges:
            return False
        return all(entry.providers for member, entry in zip(self.members, entries, strict=True) if not member.is_topic)

    def _offer(self, lanes: frozenset[int]) -> None:
        """Offer these lanes of what is provided, and no others."""
        offers, entries = self._offers, self._provided.lanes
        try:
            for service in offers.services.values():
                service.announce()
            if len(offers.fitting(entries)) < len(offers.services):
                self._end_offer()
            was_offered = self.offered
            # No request is older than the first server: an earlier stamp shows a caller's wrong clock.
            if not offers.services:
                self.age.publishers.since = self.context.stamps.now()
            offers.open(entries, lanes | self._owed())
            self._reach = lanes
            self._log_offer(was_offered)
            for topic in offers.open_topics(entries):
                if topic.lane in self._kept_messages:
                    topic.publish(self._kept_messages[topic.lane])
        except RosError as error:
            self.endpoint_failed(error)
            return
        self._retry.clear()

    def via_of(self, lane: int) -> Via:
        """Return the bridges that a lane's answers cross."""
        name = self.members[lane].name_on(self.remote_topic)
        return way_here(self._provided.via, self.peer.bridges, name)

    def _owed(self) -> set[int]:
        """Return the lanes on which callers still wait for an answer: it needs their servers."""
        return {call.lane for _, call in self._pending.items()} & self._offers.services.keys()

    def _log_offer(self, was_offered: bool) -> None:
        if self.offered and not was_offered:
            self.log(Level.INFO, EventCode.ROUTE_OFFERED, f"offered here; calls go over {self.transport.name}")
        elif was_offered and not self.offered:
            self.log(Level.INFO, EventCode.ROUTE_WITHDRAWN, "no longer offered")

    def endpoint_failed(self, error: RosError) -> None:
        self._end_offer()
        # Also what stays open for the goals of an action.
        self._offers.close()
        self._ros_failed(f"cannot be offered here: {error}", self._provided.lanes)

    def _end_offer(self) -> None:
        """Withdraw the offer, and give up pending calls."""
        if self._reach:
            was_offered = self.offered
            self._withdraw()
            self._log_offer(was_offered)
        self._give_up_all("it is no longer offered")

    def _withdraw(self) -> None:
        """Close everything by which callers see that it can be reached."""
        self._reach = frozenset()
        self._offers.close(self._outliving())
        self._local_servers.close()

    def _outliving(self) -> tuple[int, ...]:
        """Return the lanes that stay open in ROS although the other side cannot be reached."""
        return ()

    def close(self, reason: str) -> None:
        super().close(reason)
        self._provided = _UNKNOWN
        self._comparison.forget()
        self._resumed_at = self._pending.last = 0
        self.peer.budget.kept.give(sum(map(len, self._kept_messages.values())))
        self._kept_messages.clear()

    def destroy(self) -> None:
        super().destroy()
        self._offers.close()

    @property
    def offered(self) -> bool:
        return bool(self._reach) and self._reach.issuperset(range(len(self.members)))

    def end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return node_names(self.endpoints), self._provided.nodes

    # --- calls, from ROS to the channel

    def asked(self, service: OfferedService, requests: Sequence[Request]) -> None:
        """Send callers' requests, or refuse them."""
        lane, server = service.lane, service.server
        limited = self.members[lane].limited
        with_age, check = self.age.is_on and limited, self._arriving[limited]
        for request in map(self.age.aged, requests) if with_age else requests:
            payload, now = request.payload, self.context.now()
            self._asked_for(len(payload))
            size = frame_size(payload)
            if check is not None and (why := check(request, now)) is not None:
                self._refuse_request(service, request, why)
                continue
            stamp = request.stamp if with_age else 0
            call = CallerCall(lane, size, now, server, request.caller)
            self._remember(call, payload)
            self._begin(call, payload, request.lease, stamp)
        self.flush()

    def _refuse_request(self, service: OfferedService, request: Request, why: Refused) -> None:
        """Handle a caller's request that is not sent."""
        self.failures.refused(why)

    def _remember(self, call: CallerCall, payload: bytes) -> None:
        """Note, of a caller's call that is about to be sent, what later steps need."""

    def asked_too_late(self, requests: Sequence[Request]) -> None:
        """Count requests that were on their way from ROS when the offer ended."""
        for request in requests:
            self._asked_for(len(request.payload))
        self.failures.lost(len(requests), "it is no longer offered")

    def _begin(self, call: CallerCall, payload: bytes, lease: int = 0, stamp: int = 0) -> None:
        """Send a call that has its place in the budget."""
        # `_asked_for` notes this, too, but not of a call that is sent again in a new opening.
        self.came = True
        number = self._pending.begin(call, self.timeout_of(call.lane))
        self._outbox.put(CallFrame(What.CALL, call.lane, number, 0, payload, lease, stamp))

    def leaves(self, frame: CallFrame) -> bool:
        check = self._leaving[self.members[frame.lane].limited]
        # A call that is sent again has no stamp: it was young when it was sent first.
        if check is not None and frame.stamp and (why := check(frame, self.context.now())) is not None:
            if (call := self._pending.end_by(frame)) is not None:
                self._end_refused(call, why)
            return False
        return True  # the outbox forgets calls that have ended

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make a call as a caller here would, but without waiting for the end of an interruption."""
        # For its error, which says why nothing can be called.
        self.entry(lane)
        manual, limited = ManualCall(self.context.loop), self.members[lane].limited
        self._asked_for(len(request))
        lease = self.arming.newest_number if self.arming.required else 0
        made = Request(request, b"", self.context.stamps.now(), lease)
        size, now = frame_size(request), self.context.now()
        check = self._arriving[limited]
        if check is not None and (why := check(made, now)) is not None:
            raise CallError(self.failures.refused(why))
        stamp = made.stamp if self.age.is_on and limited else 0
        self._begin(CallerCall(lane, size, now, manual, b""), request, lease, stamp)
        number = self._pending.last
        self.flush()
        try:
            return await manual.answered
        except asyncio.CancelledError:
            # Each opening numbers its calls from 1: the number may be another call's by now.
            if (call := self._pending.get(number)) is not None and call.server is manual:
                self._pending.end(number)
                self.failures.lost(1, "the operator who made it has gone")
            raise

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane, as the other side has it."""
        if lane in self._reach:
            return self._provided.lanes[lane]
        verdict, _ = self.judged.shown(self.verdict())
        known = verdict.cause != Cause.NO_CALL
        why = verdict.text if known else f"no server of {self.remote_topic} on the other side"
        raise CallError(f"{self.local_topic} cannot be called now: {why}")

    # --- answers, from the channel to ROS

    def _receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        match frame.what:
            case What.MESSAGE:
                if readable and self._malformed(frame, "") is None:
                    self._take_message(frame)
            case _ if not readable:
                self._take_unusable(frame, Refused.BYTES_UNDER_WAY)
            case What.ANSWER:
                if (why := self._malformed(frame, "_Response")) is not None:
                    self._take_unusable(frame, why)
                elif (call := self._pending.end_by(frame)) is not None:
                    self._answer_caller(call, frame)
                else:
                    self.calls.late += 1
            case What.REFUSED:
                if (call := self._pending.end_by(frame)) is not None:
                    self._end_refused(call, refused_as(frame.content))
            case _:
                raise from_wrong_side(frame)

    def _answer_caller(self, call: CallerCall, frame: CallFrame) -> None:
        """Answer the caller."""
        took, total = frame.took / 1e9, self.context.now() - call.asked_at
        try:
            call.server.answer(call.caller, frame.content)
        except RosError as error:
            self.calls.lost += 1
            self.failures.say(f"a caller could not be answered: {error}")
            return
        self._answered(len(frame.content))
        if not self.members[call.lane].patient:
            self.calls.timed(took, total)

    def _take_unusable(self, frame: CallFrame, why: Refused) -> None:
        """End a call whose answer came, but cannot be passed on."""
        if (call := self._pending.end_by(frame)) is not None:
            self._unanswered(call, self.failures.refused(why))

    def _end_refused(self, call: CallerCall, why: Refused) -> None:
        """Handle that the other side will not answer a call, which has ended."""
        self._unanswered(call, self.failures.refused(why))

    def _unanswered(self, call: CallerCall, reason: str) -> None:
        """Tell an operator that no answer to a call will come. ROS has no way to tell other callers."""
        if isinstance(call.server, ManualCall):
            call.server.fail(reason)

    def _take_message(self, frame: CallFrame) -> None:
        """Publish a message of a lane that is a topic."""
        qos = self.members[frame.lane].qos
        if qos is not None and qos.latched:
            kept, budget = self._kept_messages, self.peer.budget.kept
            budget.give(len(kept.pop(frame.lane, b"")))
            if budget.take(len(frame.content)):
                kept[frame.lane] = frame.content
        if (topic := self._offers.topics.get(frame.lane)) is not None:
            topic.publish(frame.content)

    def _expired(self, number: int, call: CallerCall) -> None:
        self.calls.expired += 1
        self.failures.say(f"a call had no answer within {self.call_timeout:g} s")
        self._unanswered(call, f"{self.calls.last_failure}; {_landed(number, self._report)}")

    def _give_up_all(self, why: str) -> None:
        lost = 0
        for number, call in self._pending.clear():
            if not self._keep(call):
                self._unanswered(call, f"no answer: {why}; {_landed(number, self._report)}")
                lost += 1
        self.failures.lost(lost, why)

    def _keep(self, call: CallerCall) -> bool:
        """Have a call wait until it can be sent again; return False if it is given up instead."""
        return False

    # --- verdict and snapshot

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called; of an absent server, with the node here that may be meant."""
        if not self._served_here or self.judged.peer.cause != Cause.NO_SERVER:
            return super().unavailable()
        text = (
            f"nobody serves {self.remote_topic} on the providing side, but {named(self._served_here)} serves "
            f"{self.local_topic} on the callers' side: if that node is meant, set provider: "
            f"{'client' if self.spec.provider == 'server' else 'server'}"
        )
        return Trouble(Cause.NO_SERVER, text)

    def reported(self, report: CallsReport) -> None:
        super().reported(report)
        peer = self.judged.peer
        self.notices.set_loop(peer.text if peer.cause == Cause.LOOP else "")

    def progress(self) -> CallsProgress:
        served = None if self._provided is _UNKNOWN else self._has_providers
        text = self.judged.peer.text or f"no server of {self.remote_topic} on the other side"
        trouble = self._unavailable or self._retry.trouble
        failure = trouble.text if trouble is not None else ""
        return CallsProgress(
            served,
            self._provided.nodes,
            why_unserved=text if served is False else "",
            type_known=bool(self.type_name),
            type_name=self.type_name,
            offered=self.offered,
            offer_failed=bool(failure),
            why_not_offered=failure,
            asked=self.calls.asked,
            answered=self.calls.answered,
            last_failure=self.calls.last_failure,
        )
