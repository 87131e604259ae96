"""The calls of the other side, from when they come until their answers leave or they are given up.

A call comes from the channel to `ProvidedCalls.receive`, waits its turn (`paced_client`), and goes to ROS in `_call`.
The server's response comes to `responded`, goes to the outbox, and ends the call in `_leaves`, once it is sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.clock import shifted
from rsb_bridge.model.codes import EventCode
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_endpoints import OpenLane, OpenLanes
from rsb_bridge.route.calls.call_frames import CallsOutbox, from_wrong_side
from rsb_bridge.route.calls.calls_flow import CallsKind
from rsb_bridge.route.calls.goals import result_request
from rsb_bridge.route.calls.paced_client import PacedClient
from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.route.gates import chained, compose_when_switched, providing_gates
from rsb_bridge.wire.headers import CallFrame, What, frame_size
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import ExitStack

    from rsb_bridge.ros.ros_interface import RawMessage, Response
    from rsb_bridge.route.calls.call_servers import Provision
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.wire.records import LaneEntry


class CalledService(OpenLane):
    """A client of a service, on the providing side."""

    _owner: ProvidedCalls
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
            self._owner.responded(self, batch)


class HeardTopic(OpenLane):
    """A subscription, on the providing side."""

    _owner: ProvidedCalls

    def _open(self, held: ExitStack) -> None:
        context, link, spec = self._route.context, self._route.peer.name, self._spec()
        if self._member.absolute:  # all nodes publish on this topic: the link's routes share a subscription
            events, node = context.parameter_events, self._route.local_topic
            held.callback(events.listen(spec, link, node, self._put, self._failed).close)
        else:
            held.callback(context.ros.subscribe(spec, self._put, link, self._failed, express=True).close)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        if self._is_open:
            self._owner.published(self.lane, batch)


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


class ProviderKind(CallsKind[PeersCall]):
    """The part of a kind of calls besides passing them on, as `asked_calls.CallerKind` in the other half.

    Attributes:
        keeps_clients: whether its clients have to stay open although nobody on the other side can call.
    """

    def __init__(
        self,
        flow: CallsFlow,
        pending: PendingCalls[PeersCall],
        clients: OpenLanes[CalledService, HeardTopic],
        outbox: CallsOutbox,
    ) -> None:
        super().__init__(flow, pending)
        self._clients, self._outbox = clients, outbox

    @property
    def keeps_clients(self) -> bool:
        return False

    def explained(self, found: Provision) -> Provision:
        """Return the servers found here, with a better reason if none can be called."""
        return found

    def told(self) -> None:
        """Send all that the other side needs after the list of servers."""

    def called(self, frame: CallFrame, call: PeersCall) -> None:
        """Note a call that was given to DDS."""

    def takes(self, service: CalledService, response: Response, call: PeersCall | None) -> bool:
        """Read a response, and return whether it is to a question of this side's own.

        Args:
            call: the other side's that it answers, or None if that has ended.
        """
        return False

    def published(self, lane: int, messages: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """Read messages from ROS, and return those that the callers' side gets."""
        return messages

    def clients_changed(self) -> None:
        """Note that clients have closed, or others are about to open, which number their calls from the start."""

    def disarm(self) -> None:
        """End what began by the arming, before clients may close."""

    def close(self) -> None:
        """Forget what belongs to the opening."""


class ProvidedCalls:
    """The calls that the other side makes here, and the clients that make them.

    Args:
        kind: the class of what they do besides, by their kind.

    Attributes:
        pending: those without an answer yet, and those whose answers wait for the channel.
        outbox: frames, until the channel takes them.
        clients: of the servers here, and subscriptions.
        kind: follows the calls.
        entries: the lanes that the other side has been told that it can call, or empty.
    """

    def __init__(self, flow: CallsFlow, types: LaneTypes, kind: type[ProviderKind]) -> None:
        route = flow.route
        self._flow, self._route, self._types = flow, route, types
        self.outbox = CallsOutbox(flow, self._leaves)
        self.pending = PendingCalls[PeersCall](
            route.context.loop, route.peer.budget.provided, self._expired, self._ended
        )
        self.clients = OpenLanes(flow, self, CalledService, HeardTopic)
        self.kind = kind(flow, self.pending, self.clients, self.outbox)
        self.entries: Sequence[LaneEntry] = ()
        self._present: set[bytes] = set()  # ids of servers; the calls made since the last look share it
        self._by_number: dict[tuple[int, int], int] = {}  # the peer's call, by lane and the client's number
        self._highest = self._given = 0  # the newest call that came, and the newest that was given to DDS
        compose_when_switched(route, self._compose_gates)

    def _compose_gates(self) -> None:
        gates = [providing_gates(self._route, limited=limited) for limited in (False, True)]
        self._arriving = [chained(each.arriving) for each in gates]
        self._leaving = [chained(each.leaving) for each in gates]

    def see(self, servers: set[bytes]) -> bool:
        """Note the ids of the servers that are there now. Return whether they are others than before."""
        changed = servers != self._present
        # In place, as calls under way share the set: DDS may have given these servers calls before they were seen.
        self._present |= servers
        self._present = servers
        return changed

    # --- from the channel to ROS

    def receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        """Take a call of the other side's."""
        if frame.what is not What.CALL:
            raise from_wrong_side(frame)
        if frame.call <= self._highest:
            raise ProtocolError(f"call {frame.call} after call {self._highest}")
        self._highest = frame.call
        self._flow.asked(len(frame.content))
        if (why := self._refusal(frame) if readable else Refused.BYTES_UNDER_WAY) is not None:
            self._refuse(frame, why)
            return
        call = PeersCall(frame.lane, frame_size(frame.content), self._route.context.now(), self._present)
        self.pending.add(frame.call, call, self._flow.timeout_of(frame.lane))
        client = self.clients.services[frame.lane].client
        call.waits = client.is_busy
        client.in_turn(frame.call, partial(self._call, frame, call))

    def due(self, frame: CallFrame) -> float | None:
        return None

    def _refusal(self, frame: CallFrame) -> Refused | None:
        """Return the reason why a call is not made, or take its place in the link's budget and return None."""
        limited = self._flow.members[frame.lane].limited
        arriving, leaving = self._arriving[limited], self._leaving[limited]
        if arriving is not None and (why := arriving(frame, self._route.context.now())) is not None:
            return why
        if not self.entries:  # a question to DDS at each call would take its time
            return Refused.PROVIDER_GONE
        if (why := self._types.malformed(frame, "_Request")) is not None:
            return why
        return None if leaving is None else leaving(frame, self._route.context.now())

    def _call(self, frame: CallFrame, call: PeersCall) -> None:
        """Call the node, unless something has come in between while the call waited for its turn."""
        arriving = self._arriving[self._flow.members[frame.lane].limited] if call.waits else None
        call.waits = False
        if arriving is not None and (why := arriving(frame, self._route.context.now())) is not None:
            self._give_up(frame.call, why)
            return
        try:
            call.number = self.clients.services[frame.lane].client.call(frame.content)
        except RosError as error:
            self._route.notices.message_error(EventCode.ROUTE_CALL_FAILED, str(error))
            self._give_up(frame.call, Refused.NOT_SENT)
            return
        call.asked_at, call.servers = self._route.context.now(), self._present
        self._by_number[frame.lane, call.number] = frame.call
        self._given = max(self._given, frame.call)
        self.kind.called(frame, call)

    def _refuse(self, frame: CallFrame, why: Refused) -> None:
        self._flow.failures.refused(why)
        self.outbox.put(frame._replace(what=What.REFUSED, took=0, content=why.encode()))

    # --- from ROS to the channel

    def responded(self, service: CalledService, responses: Sequence[Response]) -> None:
        """Take responses of servers here, the oldest first."""
        for response in responses:
            if not service.client.answered(response.number):
                self._take_response(service, response)
        self.outbox.flush()

    def _take_response(self, service: CalledService, response: Response) -> None:
        """Answer a call of the other side's."""
        flow, peers = self._flow, self._by_number.pop((service.lane, response.number), 0)
        call = self.pending.get(peers)
        if self.kind.takes(service, response, call):
            return
        if call is None:
            flow.calls.late += 1
            return
        payload, took = response.payload, self._route.context.now() - call.asked_at
        if not flow.members[call.lane].patient:
            flow.calls.timed(took)
        if len(payload) > self.outbox.largest:
            self._give_up(peers, Refused.TOO_LARGE)
        elif not self.pending.resize(call, frame_size(payload)):
            self._give_up(peers, Refused.BYTES_UNDER_WAY)
        else:
            self.outbox.put(CallFrame(What.ANSWER, call.lane, peers, int(took * 1e9), payload))

    def _leaves(self, frame: CallFrame) -> bool:
        """End the call of an answer that is about to be sent. Return whether it has not ended before."""
        if self.pending.end(frame.call) is None:
            return False
        self._flow.answered(len(frame.content))
        return True

    def published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Send messages of a lane that is a topic, the oldest first."""
        route, channel, largest = self._route, self._flow.carried.channel, self.outbox.largest
        still = channel.still(route.context.now()) if channel is not None and channel.ready else 0.0
        for message in self.kind.published(lane, messages):
            if (size := len(message.payload)) > largest:
                text = f"a message of {size:,} bytes for the callers is left out: at most {largest:,} cross"
                self._flow.failures.say(text, EventCode.ROUTE_TOO_LARGE)
                continue
            stamp = shifted(message.stamp, route.context.stamps.shift)
            self.outbox.put(CallFrame(What.MESSAGE, lane, 0, 0, message.payload, stamp=stamp), still)
        self.outbox.flush()

    # --- calls without an answer

    def _ended(self, peers: int) -> None:
        """Forget what else is held of a call that has ended."""
        self.outbox.forget(peers)
        for service in self.clients.services.values():
            service.client.waiting.pop(peers, None)

    def _expired(self, number: int, call: PeersCall) -> None:
        flow = self._flow
        flow.calls.expired += 1
        within = f"{flow.call_timeout:g} s"
        nodes = " and ".join(node_names(flow.carried.endpoints)) or "the server"
        if call.waits:
            flow.calls.waited += 1
            flow.failures.say(
                f"a call waited {within} for its turn, as {nodes} had not answered earlier ones: "
                "make fewer at once, or allow more time"
            )
            return
        # Its answer has come, and waits for the link.
        if call.number and self._by_number.pop((call.lane, call.number), None) is None:
            flow.failures.say(
                f"the link did not take an answer of {nodes} within {within}: send less over it, or allow more time"
            )
            return
        # DDS may hold the request on, for a server that has stopped.
        self._route.peer.budget.provided.linger(call.size, self._route.context.now())
        flow.failures.say(f"{nodes} did not answer a call within {within}")

    def _give_up(self, peers: int, why: Refused) -> None:
        """End a call without an answer, and tell the peer the reason."""
        if (call := self.pending.end(peers)) is None:
            return
        self._by_number.pop((call.lane, call.number), None)
        self._refuse(CallFrame(What.REFUSED, call.lane, peers, 0, b""), why)

    def give_up_orphans(self) -> None:
        """Give up the calls of which all servers have gone that may have got them.

        Of requests for a result it is enough that one has gone: callers have the next server asked.
        """
        for number, call in self.pending.items():
            is_lost = not call.servers <= self._present if call.goal else call.servers.isdisjoint(self._present)
            if is_lost and not call.waits:
                self._give_up(number, Refused.LOST)

    def give_up_all(self, why: str) -> None:
        """Give up all calls, for a reason in words."""
        calls = [(number, call.lane) for number, call in self.pending.clear()]
        for number, lane in calls:
            self.outbox.put(CallFrame(What.REFUSED, lane, number, 0, Refused.LOST.encode()))
        self._by_number.clear()
        self._flow.failures.lost(len(calls), why)

    # --- clients

    def open_clients(self, entries: Sequence[LaneEntry]) -> bool:
        """Have clients of these types. Return whether there are others than before.

        Raises:
            RosError: one cannot be opened.
        """
        clients = self.clients
        changes = not clients.services or len(clients.fitting(entries)) < len(clients.services)
        if changes:
            self.give_up_all("its servers have another type now")
            self.kind.clients_changed()
            clients.open(entries, range(len(entries)))
        clients.open_topics(entries)
        return changes

    def close_clients(self) -> None:
        """Close all clients, unless goals still need them."""
        if not self.kind.keeps_clients:
            self.clients.close()

    def failed(self, error: RosError) -> None:
        self.clients.failed(f"cannot be called here: {error}")
        self.kind.clients_changed()
        self.give_up_all("it cannot be called here")

    def at_node(self) -> tuple[int, int]:
        """Return the newest call that was given to DDS, with all before it, and how many calls wait for their node."""
        waiting = [number for number, call in self.pending.items() if call.waits]
        return min(self._given, waiting[0] - 1) if waiting else self._given, len(waiting)

    def close(self, reason: str) -> None:
        """End the opening; pending calls are lost."""
        self.give_up_all(reason)
        self.outbox.clear()  # with the refusals: the next opening has other calls of the same numbers
        self.kind.close()
        self.entries = ()
        self._highest = self._given = 0
