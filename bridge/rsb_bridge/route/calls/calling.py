"""The callers' half of a route of calls: offers here what the other side provides, and takes callers their answers."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, Stage
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import Request, RosError
from rsb_bridge.route.calls.call_endpoints import Offers, name_of, type_of
from rsb_bridge.route.calls.call_servers import LocalServers, others_called, types_clash, way_here
from rsb_bridge.route.calls.calls_ledger import refused_as
from rsb_bridge.route.calls.calls_route import CallsRoute, frame_size
from rsb_bridge.route.calls.calls_verdict import CallsFacts, Trouble
from rsb_bridge.route.calls.manual_call import CallError, ManualCall
from rsb_bridge.route.calls.pending_calls import Call, UnderWay
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.source_publishers import SlowSubscriberError
from rsb_bridge.route.topic_verdict import named
from rsb_bridge.wire.headers import CallFrame, What
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import ServiceServer
    from rsb_bridge.route.lease import Lease
    from rsb_bridge.route.notices import Notices
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.messages import Propose, Provide
    from rsb_bridge.wire.records import CallsReport, LaneEntry

_CALLER = 16
"""Bytes of `Request.caller` that identify the caller; the others identify the request."""
_AT_ONCE = 1.0
"""s of `max_rate` that may come at once."""


class LaneMessages:
    """Publishes the messages of lanes that are topics while they are offered, and keeps those of latched lanes.

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


@dataclass(slots=True)
class CallerCall(Call):
    """A call of a caller here.

    Attributes:
        server: that took it; the `ManualCall` of an operator's.
        caller: whom it answers.
    """

    server: ServiceServer
    caller: bytes

    def unanswered(self, reason: str) -> None:
        """It will have no answer; nobody but an operator can be told."""
        if isinstance(self.server, ManualCall):
            self.server.fail(reason)


class CallingRoute(CallsRoute):
    """Offers services and publishes topics here, as long as the other side can answer."""

    outgoing: ClassVar[bool] = True

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._provided: Provide | None = None  # in the present opening
        self._resumed_at = 0  # the revision of the pause's end, likewise
        self._reach: frozenset[int] = frozenset()  # the lanes that are offered, and whose calls go to the other side
        self._offers = Offers(
            context, peer, self.lanes, self._asked, self._too_late, self._offer_failed, self._lease_of_requests
        )
        self._rivals = LocalServers(context, peer, self.advance)
        self._served_here: list[str] = []  # the nodes that serve it here, while nobody does on the other side
        self._under_way = UnderWay[CallerCall](context.loop, peer.budget.asked, self._expired, self._outbox.forget)
        self._last_number = 0
        self._messages = LaneMessages(self.lanes, self._offers, peer.budget.kept, self.notices)
        self._allowed = _bucket(0.0, context.now())
        self.limit.apply = self._limit

    def _lease_of_requests(self) -> Lease | None:
        return self.arming.lease if self.arming.required else None

    def _limit(self, rate: float) -> None:
        self._allowed = _bucket(rate, self.context.now())

    # --- setting up

    def provided(self, provide: Provide) -> None:
        """The providing side says what there is to call."""
        if provide.lanes and len(provide.lanes) != len(self.lanes):
            text = f"the other side provides {len(provide.lanes)} lanes, not {len(self.lanes)}"
            self.request_reopen(EventCode.ROUTE_CALLS_BROKEN, text, Level.ERROR)
            return
        for lane, entry in zip(self.lanes, provide.lanes, strict=False):
            agreed = type_of(lane, self.proposal.type)
            if agreed and entry.type != agreed and not lane.is_topic:  # what has to be armed may depend on the type
                text = f"the other side provides {entry.type}, though {agreed} was agreed on"
                self.request_reopen(EventCode.ROUTE_CALLS_BROKEN, text, Level.ERROR)
                return
        self._provided = provide
        self.advance()

    def advance(self) -> None:
        """Open the channel, and offer what can be called, or withdraw it."""
        if not self.accepted:
            return
        if self.channel is None:
            self.peer.open_channel(self)
        self._look()
        lanes = self._to_offer()
        if self._provided is None or not lanes:
            self._failures.clear()
            self._end_offer()
        elif self._reach or not self._rivals.unknown:
            self._offer(self._provided, lanes)
        self._verdict = None

    def _to_offer(self) -> frozenset[int]:
        """The lanes that can be offered now."""
        if self._unavailable is not None or self.notices.loop or not (self.connected and self._has_providers):
            return frozenset()
        if self._provided is not None and not self._load(self._provided.lanes):
            return frozenset()
        resumed = self._provided is not None and self._provided.pause_revision >= self._resumed_at
        return frozenset(
            number for number, lane in enumerate(self.lanes) if not self.held(number) and (resumed or not lane.limited)
        )

    def _paused(self, was: bool) -> None:
        if was and not self.paused and self.id:
            self._resumed_at = self.pausing.revision
        super()._paused(was)

    @property
    def _has_providers(self) -> bool:
        provided = self._provided
        if provided is None or not provided.lanes or not self.peer.bridges:
            return False
        return all(entry.providers for lane, entry in zip(self.lanes, provided.lanes, strict=True) if not lane.is_topic)

    def _look(self) -> None:
        """See who calls, and whether it may be offered here."""
        ros, names = self.context.ros, self.local_names
        services = [name for lane, name in zip(self.lanes, names, strict=True) if not lane.is_topic]
        callers = {service: ros.callers(service) for service in services}
        self.endpoints = [each for found in callers.values() for each in found]
        self._unavailable = self._warning = None
        if self._provided is not None and (entries := self._provided.lanes):
            self._know_type(entries)
            self._warning = others_called(self.lanes, entries, names, callers)
            self._unavailable = self._rivals.look(services, offered=bool(self._reach))
            if self._unavailable is None and self._load(entries):
                self._unavailable = types_clash(ros, self.lanes, entries, names, callers)
        self._served_here = [] if self._provided is None or self._provided.lanes else self._rivals.nodes(services)

    def _offer(self, provided: Provide, lanes: frozenset[int]) -> None:
        """Offer these lanes of what is provided, and no others, unless they are offered already."""
        if self._failures.waits(self._made_of()):
            return
        offers, entries = self._offers, provided.lanes
        ways = [way_here(provided.via, self.peer.bridges, name_of(lane, self.remote_topic)) for lane in self.lanes]
        try:
            offers.announce(ways)
            if any(offers.services_of(entries)[lane] != kind for lane, kind in offers.types.items()):
                self._end_offer()
            was_offered = self.offered
            if not offers.types:
                self.age.publishers.since = self.context.stamps.now()
            offers.open(entries, self.local_names, lanes | self._owed())
            self._reach = lanes
            self._log_offer(was_offered)
            self._messages.offered(offers.open_topics(entries))
        except RosError as error:
            self._offer_failed(error)
        else:
            self._failures.clear()

    def _owed(self) -> set[int]:
        """The lanes on which callers still wait for an answer, which comes only while they are there."""
        under_way = [self._under_way.get(number) for number in self._under_way.numbers()]
        return {call.lane for call in under_way if call is not None} & set(self._offers.types)

    def _log_offer(self, was_offered: bool) -> None:
        if self.offered and not was_offered:
            self.log(Level.INFO, EventCode.ROUTE_OFFERED, f"offered here, answered over {self.transport.name}")
        elif was_offered and not self.offered:
            self.log(Level.INFO, EventCode.ROUTE_WITHDRAWN, "no longer offered")

    def _offer_failed(self, error: RosError) -> None:
        self._end_offer()
        self._offers.close()
        self._ros_failed(f"cannot be offered here: {error}")

    def _made_of(self) -> object:
        return self._provided.lanes if self._provided is not None else ()

    def _end_offer(self) -> None:
        """Offer it no more; callers whose calls are under way get no answer."""
        if self._reach:
            was_offered = self.offered
            self._withdraw()
            self._log_offer(was_offered)
        self._give_up_all("it is no longer offered")

    def _withdraw(self) -> None:
        self._reach = frozenset()
        self._offers.close()
        self._rivals.close()

    def close(self, reason: str) -> None:
        """End the opening; the calls that are under way are lost."""
        super().close(reason)
        self._provided = None
        self._resumed_at = 0
        self._last_number = 0
        self._messages.clear()

    @property
    def offered(self) -> bool:
        return bool(self._reach) and self._reach.issuperset(range(len(self.lanes)))

    @property
    def provider_nodes(self) -> tuple[str, ...]:
        return self._provided.nodes if self._provided is not None else ()

    @property
    def caller_nodes(self) -> tuple[str, ...]:
        return node_names(self.endpoints)

    # --- calls

    def _asked(self, lane: int, requests: Sequence[Request]) -> None:
        """Take requests of callers here, the oldest first."""
        if self.age.is_on and self.lanes[lane].limited:
            requests = [self._stamped(request) for request in requests]
        for request in requests:
            self._asked_for(len(request.payload))
            if (why := self._refusal(lane, request)) is not None:
                self._refuse_caller(lane, request, why)
            else:
                self._begin(lane, request)
        self.flush()

    def _stamped(self, request: Request) -> Request:
        """Return a request with the time from which its age counts as its stamp, or 0 if it is too old."""
        born = self.age.born(request.source, request.stamp, request.caller[:_CALLER])
        return request._replace(stamp=0 if born is None else born)

    def _too_late(self, lane: int, requests: Sequence[Request]) -> None:
        """Requests were on their way from ROS when it was offered no more."""
        for request in requests:
            self._asked_for(len(request.payload))
        self._lose(len(requests), "it is no longer offered")

    def _refusal(self, lane: int, request: Request) -> Refused | None:
        """Why a call is not sent; if it is, it has its place in the link's budget."""
        now = self.context.now()
        if (why := self.held_now(lane)) is not None:
            return why
        if self.age.is_on and self.lanes[lane].limited and not self.age.is_young(request.stamp):
            return Refused.TOO_OLD
        if len(request.payload) > self._outbox.largest:
            return Refused.TOO_LARGE
        if self.limit.rate and self.lanes[lane].limited and not self._allowed.take(1.0, now):
            return Refused.CALLS_A_SECOND
        return self.peer.budget.asked.take(frame_size(request.payload), now)

    def _refuse_caller(self, lane: int, request: Request, why: Refused) -> None:
        """A call is not sent."""
        self._refuse(why)

    def _begin(self, lane: int, request: Request, hand: ManualCall | None = None) -> None:
        """Send a call, which has its place in the budget; `hand`: it is an operator's."""
        self._last_number += 1
        server = hand or self._offers.servers[lane]
        call = CallerCall(lane, frame_size(request.payload), self.context.now(), server, request.caller)
        self._under_way.add(self._last_number, call, self.timeout_of(lane))
        stamp = self._stamp_of(lane, request)
        self._send(CallFrame(What.CALL, lane, self._last_number, 0, request.payload, request.lease, stamp))

    def _stamp_of(self, lane: int, request: Request) -> int:
        """Return the time from which a request's age counts, or 0 if that is not limited."""
        return request.stamp if self.age.is_on and self.lanes[lane].limited else 0

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make a call as a caller here would."""
        if lane not in self._reach:
            raise CallError(self._why_not_now())
        hand, number = ManualCall(self.context.loop), self._last_number + 1
        self._asked_for(len(request))
        lease = self.arming.newest_number if self.arming.required else 0
        made = Request(request, b"", self.context.stamps.now(), lease)
        if (why := self._refusal(lane, made)) is not None:
            self._refuse(why)
            raise CallError(self.calls.last_failure)
        self._begin(lane, made, hand)
        self.flush()
        try:
            return await hand.answered
        except asyncio.CancelledError:
            if (call := self._under_way.get(number)) is not None and call.server is hand:
                self._under_way.end(number)
                self._lose(1, "the operator who made it has gone")
            raise

    def entry(self, lane: int) -> LaneEntry:
        """What there is to call, as the other side says."""
        if self._provided is None or lane not in self._reach:
            raise CallError(self._why_not_now())
        return self._provided.lanes[lane]

    def _why_not_now(self) -> str:
        verdict, _ = self.judged.shown(self.verdict())
        known = verdict.cause != Cause.NO_CALL
        why = verdict.text if known else f"no server of {self.remote_topic} is known on the other side"
        return f"{self.local_topic} cannot be called now: {why}"

    def _leaves(self, frame: CallFrame) -> bool:
        if frame.stamp and frame.call in self._under_way and not self.age.is_young(frame.stamp):
            self._take_refusal(frame, Refused.TOO_OLD)
        return frame.call in self._under_way

    def _take(self, frame: CallFrame) -> None:
        match frame.what:
            case What.ANSWER:
                if (why := self._malformed(frame, "_Response")) is None:
                    self._take_answer(frame)
                else:
                    self._take_unusable(frame, why)
            case What.REFUSED:
                self._take_refusal(frame, refused_as(frame.content))
            case What.MESSAGE:
                if self._malformed(frame, "") is None:
                    self._take_message(frame)
            case _:
                self.unexpected(frame)

    def _take_unreadable(self, frame: CallFrame) -> None:
        if frame.what is not What.MESSAGE:
            self._take_unusable(frame, Refused.BYTES_UNDER_WAY)

    def _take_unusable(self, frame: CallFrame, why: Refused) -> None:
        """An answer came that its caller cannot have."""
        if (call := self._ended(frame)) is not None:
            self._refuse(why)
            call.unanswered(self.calls.last_failure)

    def _ended(self, frame: CallFrame) -> CallerCall | None:
        """The call that a frame ends; None: it is over already."""
        self._call_of(frame)
        return self._under_way.end(frame.call)

    def _call_of(self, frame: CallFrame) -> CallerCall | None:
        """The call that a frame is about; None: it is over already. ProtocolError: there was none on that lane."""
        call = self._under_way.get(frame.call)
        if call is None and not 0 < frame.call <= self._last_number:
            raise ProtocolError(f"an answer to call {frame.call}, which was never made")
        if call is not None and call.lane != frame.lane:
            raise ProtocolError(f"call {frame.call} is answered on lane {frame.lane}, not {call.lane}")
        return call

    def _take_answer(self, frame: CallFrame) -> None:
        """Answer the caller that asked."""
        call = self._ended(frame)
        if call is None:
            self.calls.late += 1
            return
        took, total = frame.took / 1e9, self.context.now() - call.asked_at
        try:
            call.server.answer(call.caller, frame.content)
        except RosError as error:
            self.calls.lost += 1
            self._failed(f"a caller could not be answered: {error}")
            return
        self._answered(len(frame.content))
        if not self.lanes[call.lane].patient:
            self.calls.timed(took, total)

    def _take_refusal(self, frame: CallFrame, why: Refused) -> None:
        """The other side will not answer a call."""
        self._take_unusable(frame, why)

    def _take_message(self, frame: CallFrame) -> None:
        """Publish a message of a lane that is a topic."""
        self._messages.take(frame.lane, frame.content)

    def _expired(self, number: int, call: CallerCall) -> None:
        self.calls.expired += 1
        self._failed(f"a call had no answer within {self.call_timeout:g} s")
        call.unanswered(self.calls.last_failure)

    def _give_up_all(self, why: str) -> None:
        numbers = self._under_way.numbers()
        for number in numbers:
            if (call := self._under_way.end(number)) is not None:
                call.unanswered(f"no answer: {why}; the call was under way, and the node may have acted on it")
        self._lose(len(numbers), why)

    # --- how it is

    def facts(self) -> CallsFacts:
        facts = super().facts()
        if not self._served_here or self.judged.peer.cause != Cause.NO_SERVER:
            return facts
        text = (
            f"nobody serves {self.remote_topic} on the providing side, but {named(self._served_here)} serves "
            f"{self.local_topic} on the callers' side: if that node is meant, set provider: "
            f"{'client' if self.spec.provider == 'server' else 'server'}"
        )
        return facts._replace(unavailable=Trouble(Cause.NO_SERVER, text))

    def reported(self, report: CallsReport) -> None:
        """The peer said what it counts, and what it makes of the route."""
        super().reported(report)
        peer = self.judged.peer
        self.notices.set_loop(peer.text if peer.cause == Cause.LOOP else "")

    def _stages(self) -> tuple[Stage, ...]:
        """From the server there to the caller here."""
        provided, peer = self._provided, self.judged.peer
        seen = None if provided is None else self._has_providers
        trouble = self._unavailable or self._failures.trouble
        failure = trouble.text if trouble is not None else ""
        nobody = peer.text or f"no server of {self.remote_topic} on the other side"
        return (
            Stage("server seen", seen, ", ".join(self.provider_nodes) if seen else nobody if seen is False else ""),
            Stage("type known", bool(self.type_name) or None, self.type_name),
            self._link_stage(),
            self._accepted_stage(),
            Stage("offered", False if failure else self.offered or None, failure),
            Stage("called", self.calls.asked > 0 or None),
            Stage("answered", self.calls.answered > 0 or None, "" if self.calls.answered else self.calls.last_failure),
        )


def _bucket(rate: float, now: float) -> TokenBucket:
    return TokenBucket(max(1.0, rate * _AT_ONCE), rate, now)
