"""The providing half of a route of calls: finds who answers here, tells the peer, and calls them for its callers.

A call comes from the channel to `ProvidingRoute._receive`, and goes to ROS in `_call`. The server's response comes to
`_responded`, goes to the outbox in `_answer`, and ends the call in `_leaves`, once the channel takes it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import msgspec

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_endpoints import Clients, name_of
from rsb_bridge.route.calls.call_servers import CallLoopGuard, Provision, provision
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.calls_route import CallsRoute, from_wrong_side
from rsb_bridge.route.calls.calls_verdict import CallsFacts, CallsProgress, Trouble
from rsb_bridge.route.calls.manual_call import CallError, call_directly
from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.gates import chained, compose_when_switched, providing_gates, why_not_by_hand
from rsb_bridge.wire.headers import CallFrame, What, frame_size
from rsb_bridge.wire.messages import Provide
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

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
_OPEN, _UNANSWERED = 8, 0.5
"""Calls of one service that its node has before the next ones wait for an answer, and s without one after which it may
have twice as many. A node keeps 10 requests by default, and loses the oldest of 50 that a link delivers at once after a
gap; but it may answer in any order, or none before more calls have come. The time is a round figure."""
_EXPLAINED_AGAIN = 0.5
"""s until the next look whether a bridge has announced where its answers come from. A round figure."""


@dataclass(slots=True)
class PeersCall(PendingCall):
    """A call of the other side's.

    Attributes:
        number: of the client's call here, or 0 if it waits for the answer to another call.
        servers: ids of the servers that may have got it.
    """

    number: int
    servers: set[bytes]


@dataclass(slots=True)
class _Pace:
    """The calls of one lane that its node has, and the calls that wait for its answers.

    Attributes:
        most: calls that the node may have.
        answered_at: when it answered last, or got the first one, in s.
        waiting: when each came (s), and its frame; each has its place in the budget.
    """

    most: int = _OPEN
    open: int = 0
    answered_at: float = 0.0
    waiting: deque[tuple[float, CallFrame]] = field(default_factory=deque)


class ProvidingRoute(CallsRoute):
    """Tells the peer what is provided here, and passes its calls on.

    It has more than 40 methods because calls come from the peer and answers from ROS, and either may end before a call
    does.

    Attributes:
        come_as: the kinds of frames that are calls.
    """

    outgoing: ClassVar[bool] = False
    come_as: ClassVar[tuple[What, ...]] = (What.CALL,)

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        compose_when_switched(self, self._compose_gates)
        self._provision = Provision()
        self._loop_guard = CallLoopGuard(context, peer)
        self._present: set[bytes] = set()  # ids of servers; the calls made since the last look share it
        self._last_sent: Provide | None = None  # in the present opening
        self._served_in = 0  # the last connection in which a server was there, or 0
        self._clients = Clients(context, peer, self.members, self._responded, self._published, self._client_failed)
        self._pending = PendingCalls[PeersCall](context.loop, peer.budget.provided, self._expired, self._ended)
        self._by_number: dict[tuple[int, int], int] = {}  # the peer's call, by lane and the client's number
        self._paces = {lane: _Pace() for lane, member in enumerate(self.members) if member.limited}
        self._unanswered: asyncio.TimerHandle | None = None
        self._highest = 0
        self._again: asyncio.TimerHandle | None = None
        self._unmatched_since = 0.0

    # --- setting up

    def advance(self) -> None:
        """Open the channel; find who provides it, have clients for them, and tell the other side."""
        if not self.life.accepted:
            return
        if self.channel is None:
            self.peer.open_channel(self)
        self._find_servers()
        entries = self._provision.entries
        if not entries or all(self.held(lane) for lane in range(len(self.members))):
            self._retry.clear()
            if self._clients:
                self._close_clients()
                why = "it was paused" if self.paused else "it is not armed" if entries else "its server has gone"
                self._give_up_all(why)
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
        self._unavailable, self._warning = None if loop else self._or_gone(found.unavailable), found.warning
        if found.entries:
            # Also while it is paused or not armed: the first call afterwards would wait for them.
            self.types.load(found.entries)
            self.type_name, self.type_hash = self.types.know(found.entries)
            self._served_in = self.peer.connections

    def _or_gone(self, trouble: Trouble | None) -> Trouble | None:
        """Return a trouble; a missing server that was there before has gone."""
        has_gone = self._served_in == self.peer.connections and not self._loop_guard.waits
        if trouble is None or trouble.cause is not Cause.NO_SERVER or not has_gone:
            return trouble
        return Trouble(Cause.SERVER_GONE, f"{trouble.text} any more: start its node again")

    def _find(self) -> Provision:
        """Return what can be called here."""
        context, guard = self.context, self._loop_guard
        names = [(name_of(each, self.local_topic), name_of(each, self.topic)) for each in self.members]
        guard.begin()
        found = provision(
            context.ros,
            self.members,
            self.local_topic,
            self.proposal.type,
            context.domain_id,
            lambda lane: guard.servers(*names[lane]),
        )
        if guard.waits:
            self._advance_after(_EXPLAINED_AGAIN)
        return found

    def _have_clients(self, entries: Sequence[LaneEntry]) -> None:
        clients = self._clients
        try:
            if clients.types != clients.services_of(entries):
                self._give_up_all("its servers have another type now")
                clients.open(entries, self.local_names)
                self._unmatched_since = self.context.now()
            clients.open_topics(entries)
        except RosError as error:
            self._no_clients(error)
        else:
            self._retry.clear()

    def _tell(self) -> None:
        """Tell the peer what it can call, once a call would reach a server."""
        entries = self._provision.entries if self._clients.ready else ()
        provide = Provide(route=self.id, pause_revision=self.pausing.revision)
        if entries:
            nodes = node_names(self.endpoints)
            provide = msgspec.structs.replace(provide, lanes=entries, nodes=nodes, via=self._loop_guard.via)
        if self._clients and not self._clients.ready:
            waited = self.context.now() - self._unmatched_since
            self._advance_after(min(max(_MATCHED_AGAIN, _WAITED_PART * waited), _LONGEST_MATCHED_AGAIN))
        if provide != self._last_sent:
            self._last_sent = provide
            self.peer.send(provide)

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
        self._advance_if_open()

    def _client_failed(self, error: RosError) -> None:
        """Handle that a client has failed and closed itself."""
        self._no_clients(error)
        self._tell()
        self.flush()

    def _no_clients(self, error: RosError) -> None:
        self._clients.close()
        self._give_up_all("it cannot be called here")
        self._ros_failed(f"cannot be called here: {error}", self._provision.entries)

    def _close_clients(self) -> None:
        self._clients.close()

    def _withdraw(self) -> None:
        self._close_clients()
        if self._unanswered is not None:
            self._unanswered.cancel()
            self._unanswered = None
        if self._again is not None:
            self._again.cancel()
            self._again = None

    def close(self, reason: str) -> None:
        """End the opening; pending calls are lost."""
        super().close(reason)
        self._last_sent = None
        self._highest = self._given = 0

    def destroy(self) -> None:
        """End the route for good."""
        super().destroy()
        self._clients.close()

    @property
    def offered(self) -> bool:
        return self._report is not None and self._report.offered

    def end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return self._report.nodes if self._report is not None else (), node_names(self.endpoints)

    # --- calls, from the channel to ROS

    def _receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        if frame.what not in self.come_as:
            raise from_wrong_side(frame)
        if frame.call <= self._highest:
            raise ProtocolError(f"call {frame.call} after call {self._highest}")
        self._highest = frame.call
        self._asked_for(len(frame.content))
        if (why := self._refusal(frame) if readable else Refused.BYTES_UNDER_WAY) is not None:
            self._refuse_peer(frame, why)
            return
        pace = self._paces.get(frame.lane)
        if pace is None or (pace.open < pace.most and not pace.waiting):
            self._pass_on(frame)
            return
        pace.waiting.append((self.context.now(), frame))
        if self._unanswered is None:
            self._unanswered = self.context.loop.call_later(_UNANSWERED, self._have_more)

    def _pass_on(self, frame: CallFrame) -> None:
        """Handle a call that has its place in the budget."""
        self._call(frame)

    def _compose_gates(self) -> None:
        gates = [providing_gates(self, limited=limited) for limited in (False, True)]
        self._arriving = [chained(each.arriving) for each in gates]
        self._leaving = [chained(each.leaving) for each in gates]

    def _refusal(self, frame: CallFrame) -> Refused | None:
        """Return the reason why a call is not made, or take its place in the link's budget and return None."""
        limited = self._is_limited(frame)
        arriving, leaving = self._arriving[limited], self._leaving[limited]
        if arriving is not None and (why := arriving(frame, self.context.now())) is not None:
            return why
        if self._last_sent is None or not self._last_sent.lanes:  # a question to DDS at each call would take its time
            if not self._is_answered(frame):
                return Refused.PROVIDER_GONE
        elif (why := self._malformed(frame, "_Request")) is not None:
            return why
        return None if leaving is None else leaving(frame, self.context.now())

    @property
    def waiting_calls(self) -> int:
        """Calls that wait until the node has answered others."""
        return sum(len(pace.waiting) for pace in self._paces.values())

    def _have_more(self) -> None:
        """Give more calls to a node that has answered none for a while, and expire calls that have waited too long."""
        self._unanswered = None
        now = self.context.now()
        for lane, pace in self._paces.items():
            while pace.waiting and now - pace.waiting[0][0] > self.call_timeout:
                _, frame = pace.waiting.popleft()
                self.peer.budget.provided.give(frame_size(frame.content))
                self.calls.expired += 1
                nodes = " and ".join(node_names(self.endpoints)) or "the server"
                self.failures.say(f"{nodes} did not answer earlier calls of {self.local_names[lane]} in time")
            if pace.waiting and pace.answered_at <= now - _UNANSWERED:
                pace.most *= 2
            self._pass_on_waiting(pace)
        if self._unanswered is None and any(pace.waiting for pace in self._paces.values()):
            self._unanswered = self.context.loop.call_later(_UNANSWERED, self._have_more)

    def _pass_on_waiting(self, pace: _Pace) -> None:
        while pace.waiting and pace.open < pace.most:
            _, frame = pace.waiting.popleft()
            arriving = self._arriving[self._is_limited(frame)]
            why = None if arriving is None else arriving(frame, self.context.now())
            if why is None and frame.lane not in self._clients.clients and not self._is_answered(frame):
                why = Refused.PROVIDER_GONE
            if why is None:
                self._pass_on(frame)
            else:
                self.peer.budget.provided.give(frame_size(frame.content))
                self._refuse_peer(frame, why)

    def _left(self, lane: int, number: int, *, answered: bool = False) -> int | None:
        """Return the peer's call that a client's call was made for, which is over, or None if it was over before."""
        peers = self._by_number.pop((lane, number), None)
        if peers is not None and (pace := self._paces.get(lane)) is not None:
            pace.open -= 1
            if answered:  # one that has expired does not show that the node answers
                pace.most = max(_OPEN, min(pace.most, pace.open + 1))
                pace.answered_at = self.context.now()
            self._pass_on_waiting(pace)
        return peers

    def _is_limited(self, frame: CallFrame) -> bool:
        """Return whether arming, pauses and limits apply to a call."""
        return self.members[frame.lane].limited

    def _is_answered(self, frame: CallFrame) -> bool:
        """Return whether a call needs no server."""
        return False

    def _call(self, frame: CallFrame) -> PeersCall | None:
        """Make a call that has its place in the budget. Return None if ROS refuses it."""
        try:
            number = self._clients.clients[frame.lane].call(frame.content)
        except RosError as error:
            self.peer.budget.provided.give(frame_size(frame.content))
            self.notices.message_error(EventCode.ROUTE_CALL_FAILED, str(error))
            self._refuse_peer(frame, Refused.NOT_SENT)
            return None
        self._by_number[frame.lane, number] = self._given = frame.call
        if (pace := self._paces.get(frame.lane)) is not None:
            if not pace.open:
                pace.answered_at = self.context.now()
            pace.open += 1
        return self._add(frame, number)

    def _add(self, frame: CallFrame, number: int = 0) -> PeersCall:
        call = PeersCall(frame.lane, frame_size(frame.content), self.context.now(), number, self._present)
        self._pending.add(frame.call, call, self.timeout_of(frame.lane))
        return call

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
        name, within = self.local_names[lane], self.timeout_of(lane)
        return await call_directly(self.context, name, self.entry(lane), request, within, may)

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane that can be called here, even if the link is down."""
        found = self._find()
        if found.unavailable is not None:
            raise CallError(found.unavailable.text)
        return found.entries[lane]

    # --- answers, from ROS to the channel

    def _responded(self, lane: int, responses: Sequence[Response]) -> None:
        """Take responses of servers here, the oldest first."""
        for response in responses:
            self._take_response(lane, response)
        self.flush()

    def _take_response(self, lane: int, response: Response) -> None:
        peers = self._left(lane, response.number, answered=True)
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

    def _leaves(self, frame: CallFrame) -> bool:
        """End the call of an answer that is about to be sent. Return False if it has ended before."""
        if self._pending.end(frame.call) is None:
            return False
        self._answered(len(frame.content))
        return True

    # --- calls without an answer

    def _ended(self, peers: int) -> None:
        """Forget what else is held of a call that has ended."""
        self._outbox.forget(peers)

    def _expired(self, number: int, call: PeersCall) -> None:
        self.calls.expired += 1
        nodes, within = " and ".join(node_names(self.endpoints)) or "the server", f"within {self.call_timeout:g} s"
        # Its answer has come, and waits for the link.
        if call.number and self._left(call.lane, call.number) is None:
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
        self._left(call.lane, call.number)
        self._refuse_peer(CallFrame(What.REFUSED, call.lane, peers, 0, b""), why)

    def _is_orphan(self, call: PeersCall) -> bool:
        """Return whether all servers that may have got a call have gone."""
        return call.servers.isdisjoint(self._present)

    def _give_up_all(self, why: str) -> None:
        calls = [(number, call.lane) for number, call in self._pending.clear()]
        for lane, pace in self._paces.items():
            for _, frame in pace.waiting:
                self.peer.budget.provided.give(frame_size(frame.content))
                calls.append((frame.call, lane))
            self._paces[lane] = _Pace()
        for number, lane in calls:
            self._outbox.put(CallFrame(What.REFUSED, lane, number, 0, Refused.LOST.encode()))
        self._by_number.clear()
        self.failures.lost(len(calls), why)

    # --- messages of lanes that are topics

    def _published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Send messages from ROS, the oldest first."""
        for message in messages:
            self._outbox.put(CallFrame(What.MESSAGE, lane, 0, 0, message.payload))
        self.flush()

    # --- verdict and snapshot

    def facts(self) -> CallsFacts:
        facts = super().facts()
        trouble = facts.unavailable
        if trouble is None or trouble.cause is not Cause.NO_SERVER or self._served_in or self.endpoints:
            return facts
        hint = self.context.suggester.of((self.spec.kind, self.local_topic))
        return facts._replace(unavailable=Trouble(trouble.cause, f"{trouble.text}; {hint}")) if hint else facts

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
