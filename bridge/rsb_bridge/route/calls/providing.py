"""The providing half of a route of calls: sees who answers here, says so, and calls them for the peer's callers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import msgspec

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Stage
from rsb_bridge.model.sources import MOST_HOPS
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_endpoints import Clients, name_of
from rsb_bridge.route.calls.call_servers import CallLoopGuard, Provision, provision
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.calls_route import CallsRoute, frame_size
from rsb_bridge.route.calls.calls_verdict import CallsFacts, Trouble
from rsb_bridge.route.calls.manual_call import CallError, call_directly
from rsb_bridge.route.calls.pending_calls import Call, UnderWay
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.wire.headers import CallFrame, What
from rsb_bridge.wire.messages import Provide
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import Endpoint, RawMessage, Response
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import LaneEntry

_MATCHED_AGAIN = 0.05
"""s until it is seen again whether DDS has matched a new client with its server."""
_EXPLAINED_AGAIN = 0.5
"""s until it is seen again whether a bridge has said where the answers come from."""


@dataclass(slots=True)
class PeersCall(Call):
    """A call of the other side's.

    Attributes:
        number: of the client's call here.
        servers: that may have got it: ids.
    """

    number: int
    servers: set[bytes]


class ProvidingRoute(CallsRoute):
    """Tells what is provided here, and has it answer."""

    outgoing: ClassVar[bool] = False
    takes: ClassVar[tuple[What, ...]] = (What.CALL,)
    """The frames that its peer may send."""
    makes: ClassVar[type[Clients]] = Clients

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._provision = Provision()
        self._circles = CallLoopGuard(context, peer)
        self._via: dict[str, None] = {}  # the bridges that answers cross before they come here
        self._present: set[bytes] = set()  # ids of servers; the calls made since the last look share it
        self._told: Provide | None = None  # in the present opening
        self._served_in = 0  # the last connection in which somebody provided it; 0: in none
        self._clients = self.makes(context, peer, self.lanes, self._responded, self._published, self._client_failed)
        self._under_way = UnderWay[PeersCall](context.loop, peer.budget.provided, self._expired, self._is_over)
        self._by_number: dict[tuple[int, int], int] = {}  # the peer's call, by lane and the client's number
        self._highest = 0
        self._again: asyncio.TimerHandle | None = None

    # --- setting up

    def advance(self) -> None:
        """Open the channel; see who provides it, have clients for them, and tell the other side."""
        if not self.accepted:
            return
        if self.channel is None:
            self.peer.open_channel(self)
        self._look()
        entries = self._provision.entries
        if not entries or all(self.held(lane) for lane in range(len(self.lanes))):
            self._failures.clear()
            if self._clients:
                self._close_clients()
                why = "it was paused" if self.paused else "it is not armed" if entries else "its server has gone"
                self._give_up_all(why)
        elif self._load(entries):
            self._have_clients(entries)
        self._give_up_orphans()
        self._tell()
        self.flush()
        self._verdict = None

    def _have_clients(self, entries: Sequence[LaneEntry]) -> None:
        if self._failures.waits(self._made_of()):
            return
        clients = self._clients
        try:
            if clients.types != clients.services_of(entries):
                self._give_up_all("its servers have another type now")
                clients.open(entries, self.local_names)
            clients.open_topics(entries)
        except RosError as error:
            self._no_clients(error)
        else:
            self._failures.clear()

    def _close_clients(self) -> None:
        """Nothing may be called, or there is nobody to call."""
        self._clients.close()

    def _look(self) -> None:
        self._via.clear()
        self._provision = found = self._find()
        self.endpoints = found.servers
        present = {each.gid for each in found.servers}
        self._present |= present  # DDS may have given them calls before they were seen here
        self._present = present
        loop = found.unavailable is not None and found.unavailable.cause is Cause.LOOP
        self.notices.set_loop(found.unavailable.text if loop and found.unavailable else "")
        self._unavailable, self._warning = None if loop else self._or_gone(found.unavailable), found.warning
        if found.entries:
            self._load(found.entries)
            self._know_type(found.entries)
            self._served_in = self.peer.connections

    def _or_gone(self, trouble: Trouble | None) -> Trouble | None:
        """Nobody provides it yet, or nobody does any more."""
        has_gone = self._served_in == self.peer.connections and not self._circles.waits
        if trouble is None or trouble.cause is not Cause.NO_SERVER or not has_gone:
            return trouble
        return Trouble(Cause.SERVER_GONE, f"{trouble.text} any more: start its node again")

    def _find(self) -> Provision:
        """What there is to call here."""
        context, type_name = self.context, self.proposal.type
        return provision(context.ros, self.lanes, self.local_topic, type_name, context.domain_id, self._servers_of)

    def _servers_of(self, lane: int) -> Sequence[Endpoint]:
        """The servers of a lane that may be called.

        Raises:
            UnavailableError: there are some, but none may.
        """
        service = self.local_names[lane]
        usable = self._circles.sort(service, name_of(self.lanes[lane], self.topic))
        self._via.update(dict.fromkeys(usable.via))
        if usable.unexplained:
            self._advance_after(_EXPLAINED_AGAIN)
        usable.check(service, self.context.domain_id)
        return usable.servers

    def _tell(self) -> None:
        """Say what there is to call, once a call would reach somebody."""
        entries = self._provision.entries if self._clients.ready else ()
        provide = Provide(route=self.id, pause_revision=self.pausing.revision)
        if entries:
            via = tuple(self._via)[: MOST_HOPS - 1]
            provide = msgspec.structs.replace(provide, lanes=entries, nodes=node_names(self.endpoints), via=via)
        if self._clients and not self._clients.ready:
            self._advance_after(_MATCHED_AGAIN)
        if provide != self._told:
            self._told = provide
            self.peer.send(provide)

    def _advance_after(self, seconds: float) -> None:
        """Look again soon, as the graph does not tell what is waited for."""
        if self._again is None:
            self._again = self.context.loop.call_later(seconds, self._advance_again)

    def _advance_again(self) -> None:
        self._again = None
        if self.id:
            self.advance()

    def _client_failed(self, error: RosError) -> None:
        """One has failed and closed itself."""
        self._no_clients(error)
        self._tell()
        self.flush()

    def _no_clients(self, error: RosError) -> None:
        self._clients.close()
        self._give_up_all("it cannot be called here")
        self._ros_failed(f"cannot be called here: {error}")

    def _made_of(self) -> object:
        return self._provision.entries

    def _withdraw(self) -> None:
        self._close_clients()
        if self._again is not None:
            self._again.cancel()
            self._again = None

    def close(self, reason: str) -> None:
        """End the opening; the calls that are under way are lost."""
        super().close(reason)
        self._told = None
        self._highest = 0

    @property
    def offered(self) -> bool:
        return self._report is not None and self._report.offered

    @property
    def provider_nodes(self) -> tuple[str, ...]:
        return node_names(self.endpoints)

    @property
    def caller_nodes(self) -> tuple[str, ...]:
        return self._report.nodes if self._report is not None else ()

    # --- calls

    def _take(self, frame: CallFrame) -> None:
        if frame.what not in self.takes:
            self.unexpected(frame)
        self._count_peers(frame)
        if (why := self._refusal(frame)) is not None:
            self._refuse_peer(frame, why)
        else:
            self._take_call(frame)

    def _take_unreadable(self, frame: CallFrame) -> None:
        if frame.what not in self.takes:
            self.unexpected(frame)
        self._count_peers(frame)
        self._refuse_peer(frame, Refused.BYTES_UNDER_WAY)

    def _count_peers(self, frame: CallFrame) -> None:
        if frame.call <= self._highest:
            raise ProtocolError(f"call {frame.call} after call {self._highest}")
        self._highest = frame.call
        self._asked_for(len(frame.content))

    def _refusal(self, frame: CallFrame) -> Refused | None:
        """Why a call is not made here; if it is, it has its place in the link's budget."""
        now = self.context.now()
        limited = self._is_limited(frame)
        if limited and (why := self._why_held(frame)) is not None:
            return why
        if self._told is None or not self._told.lanes:  # asking DDS again would take its time at each call
            return Refused.PROVIDER_GONE
        if (why := self._malformed(frame, "_Request")) is not None:
            return why
        if limited and (why := self._why_held(frame)) is not None:  # the look at its content may have taken long
            return why
        if limited and not self.limit.admits(now):
            return Refused.CALLS_A_SECOND
        return self.peer.budget.provided.take(frame_size(frame.content), now)

    def _why_held(self, frame: CallFrame) -> Refused | None:
        """Why a call that operators limit may not be made now."""
        if self.age.is_on and self.age.why_old(frame.stamp) is not None:
            return Refused.TOO_OLD
        return self.held_now(frame.lane) or (None if self.arming.admits(frame.lease) else Refused.DISARMED)

    def _is_limited(self, frame: CallFrame) -> bool:
        """Whether what operators limit is about this call."""
        return self.lanes[frame.lane].limited

    def _refuse_peer(self, frame: CallFrame, why: Refused) -> None:
        self._refuse(why)
        self._send(frame._replace(what=What.REFUSED, took=0, content=why.encode()))

    def _take_call(self, frame: CallFrame) -> None:
        """Make a call here, which has its place in the budget."""
        size = frame_size(frame.content)
        try:
            number = self._clients.clients[frame.lane].call(frame.content)
        except RosError as error:
            self.peer.budget.provided.give(size)
            self.notices.message_error(EventCode.ROUTE_CALL_FAILED, str(error))
            self._refuse_peer(frame, Refused.NOT_SENT)
            return
        call = PeersCall(frame.lane, size, self.context.now(), number, self._present)
        self._by_number[frame.lane, number] = frame.call
        self._under_way.add(frame.call, call, self.timeout_of(frame.lane))

    def _responded(self, lane: int, responses: Sequence[Response]) -> None:
        """Take responses of servers here, the oldest first."""
        for response in responses:
            self._take_response(lane, response)
        self.flush()

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Call the node here; that is no call of the other side's, and not counted. What has to be armed has to be."""
        if (why := self.unarmed_now(lane)) is not None:  # be it paused, too
            raise CallError(f"{self.local_topic} cannot be called now: {REMEDIES[why]}")
        name, within = self.local_names[lane], self.timeout_of(lane)
        return await call_directly(self.context, name, self.entry(lane), request, within)

    def entry(self, lane: int) -> LaneEntry:
        """What there is to call here, whatever becomes of the link."""
        found = self._find()
        if found.unavailable is not None:
            raise CallError(found.unavailable.text)
        return found.entries[lane]

    def _take_response(self, lane: int, response: Response) -> None:
        peers = self._by_number.pop((lane, response.number), None)
        if peers is None or peers not in self._under_way:
            self.calls.late += 1
        else:
            self._answer_peer(peers, response.payload)

    def _answer_peer(self, peers: int, payload: bytes) -> None:
        """Answer a call that is under way."""
        call = self._under_way.get(peers)
        if call is None:
            return
        took = self.context.now() - call.asked_at
        if not self.lanes[call.lane].patient:
            self.calls.node.add(took)
        if len(payload) > self._outbox.largest:
            self._give_up(peers, Refused.TOO_LARGE)
        elif not self._under_way.resize(call, frame_size(payload)):
            self._give_up(peers, Refused.BYTES_UNDER_WAY)
        else:
            self._send(CallFrame(What.ANSWER, call.lane, peers, max(0, int(took * 1e9)), payload))

    def _leaves(self, frame: CallFrame) -> bool:
        """An answer is about to be sent, which is the end of its call."""
        if self._under_way.end(frame.call) is None:
            return False
        self._answered(len(frame.content))
        return True

    def _published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Take messages of a lane that is a topic, the oldest first."""
        for message in messages:
            self._send(CallFrame(What.MESSAGE, lane, 0, 0, message.payload))
        self.flush()

    def _expired(self, number: int, call: PeersCall) -> None:
        self.calls.expired += 1
        nodes, within = " and ".join(self.provider_nodes) or "the server", f"within {self.call_timeout:g} s"
        if call.number and self._by_number.pop((call.lane, call.number), None) is None:
            self._failed(f"the link did not take an answer of {nodes} {within}: send less over it, or allow more time")
            return
        self.peer.budget.provided.linger(call.size, self.context.now())
        self._failed(f"{nodes} did not answer a call {within}")

    def _give_up(self, peers: int, why: Refused) -> None:
        """Say that a call which is under way will have no answer, and why."""
        if (call := self._under_way.end(peers)) is not None:
            self._by_number.pop((call.lane, call.number), None)
            self._refuse_peer(CallFrame(What.REFUSED, call.lane, peers, 0, b""), why)

    def _is_over(self, peers: int) -> None:
        """A call is over, whatever became of it."""
        self._outbox.forget(peers)

    def _is_orphan(self, call: PeersCall) -> bool:
        """Whether nobody is there any more who could answer it."""
        return call.servers.isdisjoint(self._present)

    def _give_up_orphans(self) -> None:
        """Give up the calls of which no server is there any more."""
        for number in self._under_way.numbers():
            if (call := self._under_way.get(number)) is not None and self._is_orphan(call):
                self._give_up(number, Refused.LOST)

    def _give_up_all(self, why: str) -> None:
        numbers = self._under_way.numbers()
        for number in numbers:
            if (call := self._under_way.end(number)) is not None:
                self._send(CallFrame(What.REFUSED, call.lane, number, 0, Refused.LOST.encode()))
        self._by_number.clear()
        self._lose(len(numbers), why)

    # --- how it is

    def facts(self) -> CallsFacts:
        facts = super().facts()
        trouble = facts.unavailable
        if trouble is None or trouble.cause is not Cause.NO_SERVER or self._served_in or self.endpoints:
            return facts
        hint = self.context.meant.by(self.spec.kind, self.local_topic)
        return facts._replace(unavailable=Trouble(trouble.cause, f"{trouble.text}; {hint}")) if hint else facts

    def _stages(self) -> tuple[Stage, ...]:
        """From the server here to the caller there."""
        trouble, seen, known = self._unavailable, bool(self.endpoints), bool(self._provision.entries)
        failed, why_not = self._failures.trouble.text if self._failures.trouble else "", self.judged.peer.text
        return (
            Stage("server seen", seen, ", ".join(self.provider_nodes) if seen else trouble.text if trouble else ""),
            Stage(
                "type known",
                known or (False if seen else None),
                self.type_name if known else trouble.text if seen and trouble else "",
            ),
            self._link_stage(),
            self._accepted_stage(),
            Stage("offered", False if failed else self.offered or None, "" if self.offered else failed or why_not),
            Stage("called", self.calls.asked > 0 or None),
            Stage("answered", self.calls.answered > 0 or None, "" if self.calls.answered else self.calls.last_failure),
        )
