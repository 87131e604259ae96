"""The providing half of a route of calls: finds who answers here, tells the peer, and calls them for its callers.

A call comes from the channel to `ProvidingRoute._receive`, waits its turn (`paced_client`), and goes to ROS in `_call`.
The server's response comes to `responded`, goes to the outbox in `_answer`, and ends the call in `leaves`, once the
channel takes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import msgspec

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_endpoints import OpenLane, OpenLanes
from rsb_bridge.route.calls.call_servers import CallLoopGuard, Provision, provision
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.calls_route import CallsRoute, from_wrong_side
from rsb_bridge.route.calls.calls_verdict import CallsProgress, Trouble
from rsb_bridge.route.calls.kept_calls import result_request
from rsb_bridge.route.calls.manual_call import CallError, call_directly
from rsb_bridge.route.calls.paced_client import PacedClient
from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.gates import chained, compose_when_switched, providing_gates, why_not_by_hand
from rsb_bridge.wire.headers import CallFrame, What, frame_size
from rsb_bridge.wire.messages import Provide
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence
    from contextlib import ExitStack

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import RawMessage, Response
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import LaneEntry

_MATCHED_AGAIN, _LONGEST_MATCHED_AGAIN = 0.05, 1.0
"""s until the next look whether DDS has matched a client with its server. A look asks the graph of all lanes, and DDS
shows a killed server for up to 40 s."""
_WAITED_PART = 0.1
"""Part of the wait so far that a look may come later than the match. A round figure."""
_EXPLAINED_AGAIN = 0.5
"""s until the next look whether a bridge has announced where its answers come from. A round figure."""


class CalledService(OpenLane):
    """A client of a service, on the providing side."""

    _route: ProvidingRoute
    client: PacedClient

    def _open(self, held: ExitStack) -> None:
        context = self._route.context
        client = context.ros.call_service(self._name, *self.version, self._put, self._failed)
        # A server answers at once that it knows no such goal.
        probe = result_request(bytes(16)) if self._member.patient else b""
        self.client = PacedClient(client, context.loop, probe)
        held.callback(self.client.close)

    def offer(self, batch: Sequence[Response]) -> None:
        if self._is_open:
            self._route.responded(self, batch)


class HeardTopic(OpenLane):
    """A subscription, on the providing side."""

    _route: ProvidingRoute

    def _open(self, held: ExitStack) -> None:
        context, link, spec = self._route.context, self._route.peer.name, self._spec()
        if self._member.absolute:  # all nodes publish on this topic: the link's routes share a subscription
            events, node = context.parameter_events, self._route.local_topic
            held.callback(events.listen(spec, link, node, self._put, self._failed).close)
        else:
            held.callback(context.ros.subscribe(spec, self._put, link, self._failed).close)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        if self._is_open:
            self._route.published(self.lane, batch)


@dataclass(slots=True)
class PeersCall(PendingCall):
    """A call of the other side's.

    Attributes:
        servers: ids of the servers that may have got it.
        number: of the client's call here, or 0 if it waits for its turn or for the answer to another call.
        waits: whether it waits for its turn.
    """

    servers: set[bytes]
    number: int = 0
    waits: bool = False


class ProvidingRoute(CallsRoute):
    """Tells the peer what is provided here, and passes its calls on.

    It has more than 40 methods because calls come from the peer and answers from ROS, and either may end before a call
    does.
    """

    outgoing: ClassVar[bool] = False

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        compose_when_switched(self, self._compose_gates)
        self._provision = Provision()
        self._loop_guard = CallLoopGuard(context, peer)
        self._present: set[bytes] = set()  # ids of servers; the calls made since the last look share it
        self._last_sent: Provide | None = None  # in the present opening
        self._served_in = 0  # the last connection in which a server was there, or 0
        self._clients = OpenLanes(self, CalledService, HeardTopic)
        self._pending = PendingCalls[PeersCall](context.loop, peer.budget.provided, self._expired, self._ended)
        self._by_number: dict[tuple[int, int], int] = {}  # the peer's call, by lane and the client's number
        self._highest = self._given = 0  # the newest call that came, and the newest that was given to DDS
        self._again: asyncio.TimerHandle | None = None
        self._unmatched_since = 0.0

    # --- setting up

    def _advance(self) -> None:
        """Open the channel; find who provides it, have clients for them, and tell the other side."""
        if not self.life.accepted:
            return
        if self.channel is None:
            self.peer.open_channel(self)
        self._find_servers()
        entries = self._provision.entries
        # Nothing ever holds up the lanes that are not limited, as a cancel.
        if not entries or (self.crossing.is_held_back and all(member.limited for member in self.members)):
            self._retry.clear()
            if self._clients.services:
                self._close_clients()
                stopped = "it was paused" if self.pausing.paused else "it is not armed" if entries else ""
                self._give_up_all(stopped or "its server has gone")
        elif self.types.load(entries) and not self._retry.waits(entries):
            self._have_clients(entries)
        for number, call in self._pending.items():
            if self._is_orphan(call):
                self._give_up(number, Refused.LOST)
        self._tell()
        self.flush()
        self._verdict = None

    def _find_servers(self) -> None:
        """Find the servers that may be called, and what is wrong with them."""
        self._provision = found = self._find()
        self.endpoints = found.servers
        present = {each.gid for each in found.servers}
        if present != self._present:
            self._unmatched_since = self.context.now()
        self._present |= present  # DDS may have given them calls before they were seen here
        self._present = present
        loop = found.unavailable is not None and found.unavailable.cause is Cause.LOOP
        self.notices.set_loop(found.unavailable.text if loop and found.unavailable else "")
        self._unavailable, self.warning = None if loop else found.unavailable, found.warning
        has_gone = self._served_in == self.peer.connections and not self._loop_guard.waits
        if has_gone and found.unavailable is not None and found.unavailable.cause is Cause.NO_SERVER:
            text = f"{found.unavailable.text} any more: start its node again"
            self._unavailable = Trouble(Cause.SERVER_GONE, text)
        if found.entries:
            # Also while it is paused or not armed: the first call afterwards would wait for them.
            self.types.load(found.entries)
            self.type_name, self.type_hash = self.types.know(found.entries)
            self._served_in = self.peer.connections

    def _find(self) -> Provision:
        """Return what can be called here."""
        guard = self._loop_guard
        guard.begin()
        found = provision(self.context, self.members, self.local_topic, self.topic, self.proposal.type, guard)
        if guard.waits:
            self._advance_after(_EXPLAINED_AGAIN)
        return found

    def _have_clients(self, entries: Sequence[LaneEntry]) -> None:
        clients = self._clients
        try:
            if not clients.services or len(clients.fitting(entries)) < len(clients.services):
                self._give_up_all("its servers have another type now")
                clients.open(entries, range(len(entries)))
                self._unmatched_since = self.context.now()
            clients.open_topics(entries)
        except RosError as error:
            self.endpoint_failed(error)
        else:
            self._retry.clear()

    def _tell(self) -> None:
        """Tell the peer what it can call, once a call would reach a server."""
        is_ready = self._is_ready
        entries = self._provision.entries if is_ready else ()
        provide = Provide(route=self.id, pause_revision=self.pausing.revision)
        if entries:
            nodes = node_names(self.endpoints)
            provide = msgspec.structs.replace(provide, lanes=entries, nodes=nodes, via=self._loop_guard.via)
        if self._clients.services and not is_ready:
            waited = self.context.now() - self._unmatched_since
            self._advance_after(min(max(_MATCHED_AGAIN, _WAITED_PART * waited), _LONGEST_MATCHED_AGAIN))
        if provide != self._last_sent:
            self._last_sent = provide
            self.peer.send(provide)

    @property
    def _is_ready(self) -> bool:
        """Whether a call on every lane would reach a server."""
        services = self._clients.services
        return bool(services) and all(each.client.ready for each in services.values())

    def _advance_after(self, seconds: float) -> None:
        """Advance again soon: no event announces what is waited for."""
        due = self.context.now() + seconds
        if self._again is not None and self._again.when() > due:
            self._again.cancel()
            self._again = None
        if self._again is None:
            self._again = self.context.loop.call_at(due, self._advance_again)

    def _advance_again(self) -> None:
        self._again = None
        self.advance()

    def endpoint_failed(self, error: RosError) -> None:
        self._clients.close()
        self._give_up_all("it cannot be called here")
        self._ros_failed(f"cannot be called here: {error}", self._provision.entries)
        self._tell()
        self.flush()

    def _close_clients(self) -> None:
        self._clients.close()

    def _withdraw(self) -> None:
        self._close_clients()
        if self._again is not None:
            self._again.cancel()
            self._again = None

    def close(self, reason: str) -> None:
        super().close(reason)
        self._last_sent = None
        self._highest = self._given = 0

    def destroy(self) -> None:
        super().destroy()
        self._clients.close()

    def at_node(self) -> tuple[int, int]:
        waiting = [number for number, call in self._pending.items() if call.waits]
        return min(self._given, waiting[0] - 1) if waiting else self._given, len(waiting)

    @property
    def offered(self) -> bool:
        return self._report is not None and self._report.offered

    def end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return self._report.nodes if self._report is not None else (), node_names(self.endpoints)

    # --- calls, from the channel to ROS

    def _receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        if frame.what is not What.CALL:
            raise from_wrong_side(frame)
        if frame.call <= self._highest:
            raise ProtocolError(f"call {frame.call} after call {self._highest}")
        self._highest = frame.call
        self._asked_for(len(frame.content))
        if (why := self._refusal(frame) if readable else Refused.BYTES_UNDER_WAY) is not None:
            self._refuse_peer(frame, why)
            return
        call = PeersCall(frame.lane, frame_size(frame.content), self.context.now(), self._present)
        self._pending.add(frame.call, call, self.timeout_of(frame.lane))
        self._pass_on(frame, call)

    def _pass_on(self, frame: CallFrame, call: PeersCall) -> None:
        """Call the node, once it has read earlier calls."""
        client = self._clients.services[frame.lane].client
        call.waits = client.is_busy
        client.in_turn(frame.call, partial(self._call, frame, call))

    def _compose_gates(self) -> None:
        gates = [providing_gates(self, limited=limited) for limited in (False, True)]
        self._arriving = [chained(each.arriving) for each in gates]
        self._leaving = [chained(each.leaving) for each in gates]

    def _refusal(self, frame: CallFrame) -> Refused | None:
        """Return the reason why a call is not made, or take its place in the link's budget and return None."""
        limited = self.members[frame.lane].limited
        arriving, leaving = self._arriving[limited], self._leaving[limited]
        if arriving is not None and (why := arriving(frame, self.context.now())) is not None:
            return why
        if self._last_sent is None or not self._last_sent.lanes:  # a question to DDS at each call would take its time
            if not self._is_answered(frame):
                return Refused.PROVIDER_GONE
        elif (why := self._malformed(frame, "_Request")) is not None:
            return why
        return None if leaving is None else leaving(frame, self.context.now())

    def _is_answered(self, frame: CallFrame) -> bool:
        """Return whether a call needs no server."""
        return False

    def _call(self, frame: CallFrame, call: PeersCall) -> None:
        """Call the node, unless something has come in between while the call waited for its turn."""
        arriving = self._arriving[self.members[frame.lane].limited] if call.waits else None
        call.waits = False
        if arriving is not None and (why := arriving(frame, self.context.now())) is not None:
            self._give_up(frame.call, why)
            return
        try:
            call.number = self._clients.services[frame.lane].client.call(frame.content)
        except RosError as error:
            self.notices.message_error(EventCode.ROUTE_CALL_FAILED, str(error))
            self._give_up(frame.call, Refused.NOT_SENT)
            return
        call.asked_at, call.servers = self.context.now(), self._present
        self._by_number[frame.lane, call.number] = frame.call
        self._given = max(self._given, frame.call)

    def _refuse_peer(self, frame: CallFrame, why: Refused) -> None:
        self.failures.refused(why)
        self._outbox.put(frame._replace(what=What.REFUSED, took=0, content=why.encode()))

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Call the node here. Arming applies, but neither pause nor counts do: it is no call of the other side's."""
        opening = self.id

        def may() -> None:
            if not self.members[lane].limited:
                return
            why = why_not_by_hand(self, self.context.now())
            # In another opening, somebody else may have armed it.
            if why is None and self.arming.required and self.id != opening:
                why = Refused.DISARMED
            if why is not None:
                raise CallError(f"{self.local_topic} cannot be called now: {REMEDIES[why]}")

        may()
        name, within = self.members[lane].name_on(self.local_topic), self.timeout_of(lane)
        return await call_directly(self.context, name, self.entry(lane), request, within, may)

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane that can be called here, even if the link is down."""
        found = self._find()
        if found.unavailable is not None:
            raise CallError(found.unavailable.text)
        return found.entries[lane]

    # --- answers, from ROS to the channel

    def responded(self, service: CalledService, responses: Sequence[Response]) -> None:
        """Take responses of servers here, the oldest first."""
        for response in responses:
            if not service.client.answered(response.number):
                self._take_response(service, response)
        self.flush()

    def _take_response(self, service: CalledService, response: Response) -> None:
        peers = self._by_number.pop((service.lane, response.number), None)
        if peers is None or not self._answer(peers, response.payload):
            self.calls.late += 1

    def _answer(self, peers: int, payload: bytes) -> bool:
        """Answer a call of the peer's. Return False if it has ended."""
        call = self._pending.get(peers)
        if call is None:
            return False
        took = self.context.now() - call.asked_at
        if not self.members[call.lane].patient:
            self.calls.timed(took)
        if len(payload) > self._outbox.largest:
            self._give_up(peers, Refused.TOO_LARGE)
        elif not self._pending.resize(call, frame_size(payload)):
            self._give_up(peers, Refused.BYTES_UNDER_WAY)
        else:
            self._outbox.put(CallFrame(What.ANSWER, call.lane, peers, int(took * 1e9), payload))
        return True

    def leaves(self, frame: CallFrame) -> bool:
        """End the call of an answer that is about to be sent. Return False if it has ended before."""
        if self._pending.end(frame.call) is None:
            return False
        self._answered(len(frame.content))
        return True

    # --- calls without an answer

    def _ended(self, peers: int) -> None:
        """Forget what else is held of a call that has ended."""
        self._outbox.forget(peers)
        for service in self._clients.services.values():
            service.client.waiting.pop(peers, None)

    def _expired(self, number: int, call: PeersCall) -> None:
        self.calls.expired += 1
        nodes, within = " and ".join(node_names(self.endpoints)) or "the server", f"within {self.call_timeout:g} s"
        if call.waits:
            self.calls.waited += 1
            self.failures.say(
                f"a call waited {self.call_timeout:g} s for its turn, as {nodes} had not answered earlier ones: "
                "make fewer at once, or allow more time"
            )
            return
        # Its answer has come, and waits for the link.
        if call.number and self._by_number.pop((call.lane, call.number), None) is None:
            self.failures.say(
                f"the link did not take an answer of {nodes} {within}: send less over it, or allow more time"
            )
            return
        # DDS may hold the request on, for a server that has stopped.
        self.peer.budget.provided.linger(call.size, self.context.now())
        self.failures.say(f"{nodes} did not answer a call {within}")

    def _give_up(self, peers: int, why: Refused) -> None:
        """End a call without an answer, and tell the peer the reason."""
        if (call := self._pending.get(peers)) is None:
            return
        self._pending.end(peers)
        self._by_number.pop((call.lane, call.number), None)
        self._refuse_peer(CallFrame(What.REFUSED, call.lane, peers, 0, b""), why)

    def _is_orphan(self, call: PeersCall) -> bool:
        """Return whether all servers that may have got a call have gone."""
        return not call.waits and call.servers.isdisjoint(self._present)

    def _give_up_all(self, why: str) -> None:
        calls = [(number, call.lane) for number, call in self._pending.clear()]
        for number, lane in calls:
            self._outbox.put(CallFrame(What.REFUSED, lane, number, 0, Refused.LOST.encode()))
        self._by_number.clear()
        self.failures.lost(len(calls), why)

    # --- messages of lanes that are topics

    def published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Send messages from ROS, the oldest first."""
        still = self.channel.still(self.context.now()) if self.channel is not None and self.channel.ready else 0.0
        for message in messages:
            if (size := len(message.payload)) > self._outbox.largest:
                text = (
                    f"a message of {size:,} bytes for the callers is left out: at most {self._outbox.largest:,} cross"
                )
                self.failures.say(text, EventCode.ROUTE_TOO_LARGE)
                continue
            stamp = shifted(message.stamp, self.context.stamps.shift)
            self._outbox.put(CallFrame(What.MESSAGE, lane, 0, 0, message.payload, stamp=stamp), still)
        self.flush()

    # --- verdict and snapshot

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called, or None; of an absent server, with a name that may be meant."""
        trouble = super().unavailable()
        if trouble is None or trouble.cause is not Cause.NO_SERVER or self._served_in or self.endpoints:
            return trouble
        hint = self.context.suggester.of((self.spec.kind, self.local_topic), self.judge_again)
        return Trouble(trouble.cause, f"{trouble.text}; {hint}") if hint else trouble

    def progress(self) -> CallsProgress:
        failure = self._retry.trouble.text if self._retry.trouble else ""
        return CallsProgress(
            bool(self.endpoints),
            node_names(self.endpoints),
            why_unserved=self._unavailable.text if self._unavailable is not None else "",
            type_known=bool(self._provision.entries),
            type_name=self.type_name,
            offered=self.offered,
            offer_failed=bool(failure),
            why_not_offered="" if self.offered else failure or self.judged.peer.text,
            asked=self.calls.asked,
            answered=self.calls.answered,
            last_failure=self.calls.last_failure,
        )
