"""One peer: its control connection, its routes, its keepalive. `client` and `server` add who calls whom."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.graph import topics_of, type_hint
from rsb_bridge.incoming import IncomingRoute
from rsb_bridge.keepalive import Keepalive
from rsb_bridge.lanes import DatagramPath, Lane, Prober
from rsb_bridge.outgoing import OutgoingRoute
from rsb_bridge.paths import StreamPath
from rsb_bridge.proposals import same_route, topic_of
from rsb_bridge.route import Route, route_key
from rsb_bridge.snapshot import Level, LinkSnapshot, State, TopicInfo
from rsb_bridge.transport.tcp import ListenError
from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter, parse_header
from rsb_bridge.wire.framing import DataReader, DataWriter
from rsb_bridge.wire.messages import (
    Accept,
    Close,
    ControlMessage,
    Describe,
    Hello,
    ListTopics,
    Pause,
    Ping,
    Pong,
    Propose,
    Ready,
    Refuse,
    RefuseCode,
    Report,
    Shutdown,
    TopicEntry,
    TopicList,
    Welcome,
)

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from rsb_bridge.context import Context
    from rsb_bridge.control import Control
    from rsb_bridge.session import Topic
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.transport.udp import Address
    from rsb_bridge.wire.sealing import Role, SessionKeys

_REPROPOSED_WITHIN = 3.0
_ANSWER_WITHIN = 5.0


class LinkError(Exception):
    """The link can't do what was asked; the message says why."""


class Link:
    """A peer and its routes. It lives on while the peer is away.

    Attributes:
        name: the client's name, on both sides.
        is_client: whether this side is the client.
        routes: by key.
        control: the authenticated connection; None: not linked.
        keys: what the present connection's handshake left; None: not linked.
    """

    def __init__(self, context: Context, name: str, *, is_client: bool, fingerprint: str, encrypted: bool) -> None:
        self.context = context
        self.name = name
        self.is_client = is_client
        self.side: Role = "client" if is_client else "server"
        self.other_side: Role = "server" if is_client else "client"
        self.routes: dict[str, Route] = {}
        self.control: Control | None = None
        self.keys: SessionKeys | None = None
        self.peer: Hello | Welcome | None = None
        self.fingerprint = fingerprint
        self.encrypted = encrypted
        self.reason = "not connected yet"
        self.retry_at: float | None = None
        self.attempts = 0
        self.prober: Prober | None = None
        self.lanes: dict[int, Lane] = {}
        self._by_id: dict[int, Route] = {}
        self._next_id = 0
        self._since = time.time()
        self._linked_at = 0.0
        self._keepalive = Keepalive(context.now())
        self._requests: dict[int, asyncio.Future[tuple[TopicEntry, ...]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    # --- what client and server do differently

    @property
    def address(self) -> str:
        """The peer's address in words."""
        raise NotImplementedError

    def shared_port(self) -> int:
        """The port or channel of the link itself."""
        raise NotImplementedError

    @property
    def is_bluetooth(self) -> bool:
        """Whether the link is RFCOMM."""
        return False

    def open_stream(self, route: Route) -> None:
        """Get a stream of the route's own going; a server waits for the client's."""
        raise NotImplementedError

    def open_lane(self, port: int) -> Lane | None:
        """Datagrams to and from the peer by that port; None: not now."""
        raise NotImplementedError

    async def prepare_port(self, route: Route) -> None:
        """Have the port that a route names ready for the client; ListenError where it is taken."""
        raise NotImplementedError

    def admit(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic; LinkError where it may not be."""
        raise NotImplementedError

    def told_to_stop(self, message: Shutdown) -> None:
        """The peer closes the link on purpose."""
        raise NotImplementedError

    # --- up and down

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        return self.control is not None

    @property
    def down_reason(self) -> str:
        """Why it isn't linked."""
        return "" if self.control else self.reason

    @property
    def clock_offset(self) -> float | None:
        """s, the peer's clock minus ours."""
        return self._keepalive.clock.offset

    @property
    def clock_uncertainty(self) -> float | None:
        """Seconds by which `clock_offset` may be wrong."""
        return self._keepalive.clock.uncertainty

    def up(self, control: Control, peer: Hello | Welcome, keys: SessionKeys) -> None:
        """The peer is connected and authenticated."""
        self.control, self.peer, self.keys = control, peer, keys
        self.prober = Prober(keys, self.side, self.other_side)
        self._linked_at = self.context.now()
        self._keepalive = Keepalive(self._linked_at)
        self._since = time.time()
        self._next_id = 1 if self.is_client else 2
        self.attempts = 0
        self.retry_at = None
        words = f"encrypted with {keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        self.log(Level.INFO, f"linked with {control.stream.peer}, {words}, rsb-console {peer.version} there")
        for route in tuple(self.routes.values()):
            if route.proposed_here:
                self.propose(route)

    def down(self, reason: str, *, on_purpose: bool = False) -> None:
        """The connection is over."""
        if self.control is None:
            return
        self.control = self.keys = self.prober = None
        self.reason = reason
        self._since = time.time()
        self._by_id.clear()
        for route in self.routes.values():
            route.close(reason)
        for lane in self.lanes.values():
            lane.close()
        self.lanes.clear()
        for future in self._requests.values():
            future.cancel()
        self._requests.clear()
        self.log(Level.INFO if on_purpose else Level.WARNING, f"link {'closed' if on_purpose else 'lost'}: {reason}")

    def destroy(self) -> None:
        """End routes and tasks for good."""
        for task in self._tasks:
            task.cancel()
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    def spawn(self, work: Coroutine[None, None, None]) -> None:
        """Run a coroutine beside; it ends with the link."""
        task = self.context.loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def send(self, message: ControlMessage) -> None:
        """Send a control message; without a connection, nothing happens."""
        if self.control is not None:
            self.control.send(message)

    # --- routes

    def add(self, spec: Topic, proposal: Propose, *, proposed_here: bool) -> Route:
        """Make a route's half here; with `proposed_here` the peer is asked for its half at once.

        Raises:
            LinkError: there is such a route.
        """
        key = route_key(self.name, proposal)
        if key in self.routes:
            raise LinkError(f"{proposal.topic} is bridged in that direction already: edit or remove that route")
        kind = OutgoingRoute if proposal.from_client == self.is_client else IncomingRoute
        route = kind(self.context, self, spec, proposal, proposed_here=proposed_here)
        self.routes[key] = route
        if proposed_here and self.linked:
            self.propose(route)
        return route

    def remove(self, route: Route, reason: str) -> None:
        """End a route on both sides."""
        if route.id:
            self.send(Close(route=route.id, reason=reason, removed=True))
        self.forget(route, reason)

    def forget(self, route: Route, reason: str) -> None:
        """End a route on this side."""
        self._by_id.pop(route.id, None)
        self.routes.pop(route.key, None)
        route.destroy()
        route.log(Level.INFO, reason)

    def pause(self, route: Route, paused: bool) -> None:
        """Pause or resume a route on both sides."""
        route.set_paused(paused)
        if route.id:
            self.send(Pause(route=route.id, paused=paused))

    @property
    def shut_down(self) -> bool:
        """Whether it is down on purpose, and this side is the one to call again."""
        return False

    def retry_routes(self) -> None:
        """Open at once what was refused."""
        for route in tuple(self.routes.values()):
            if self.linked and route.proposed_here and not route.id:
                self.propose(route)

    def open_route(self, route_id: int) -> Route | None:
        """The open route of that id."""
        return self._by_id.get(route_id)

    def propose(self, route: Route) -> None:
        """Ask the peer to open a route, anew if it was open."""
        self._reopen(route, self._next_id)
        self._next_id += 2
        self.spawn(self._propose(route, route.id))

    async def _propose(self, route: Route, route_id: int) -> None:
        try:
            await self.prepare_port(route)
        except ListenError as error:
            route.refuse(str(error))
        if route.id == route_id:
            self.send(msgspec.structs.replace(route.proposal, route=route_id, paused=route.paused))

    def _reopen(self, route: Route, route_id: int) -> None:
        self._by_id.pop(route.id, None)
        route.close("opened anew")
        route.open(route_id)
        self._by_id[route_id] = route

    async def _consider(self, proposal: Propose) -> None:
        """Answer the peer's proposal."""
        try:
            admitted = self.admit(proposal)
            known = self.routes.get(route_key(self.name, admitted))
            if known is not None and known.proposed_here:
                raise LinkError(f"{admitted.topic} is bridged in that direction already")
            if known is not None and not same_route(known.proposal, admitted):
                self.forget(known, "replaced")
                known = None
            route = known or self.add(topic_of(admitted), admitted, proposed_here=False)
            self._reopen(route, proposal.route)
            await self.prepare_port(route)
        except (LinkError, ListenError, ValueError) as error:
            code: RefuseCode = "port_taken" if isinstance(error, ListenError) else "denied"
            self.log(Level.WARNING, f"refused {proposal.topic}: {error}", source="route", topic=proposal.topic)
            self.send(Refuse(route=proposal.route, code=code, reason=str(error)))
            return
        if route.id != proposal.route:
            return
        type_name, type_hash = type_hint(self.context.ros, route.local_topic)
        self.send(Accept(route=route.id, topic=route.local_topic, type=type_name, type_hash=type_hash))
        route.paused = proposal.paused
        route.agreed()

    def make_path(self, route: Route) -> None:
        """Set a route's path going."""
        if route.transport != "udp":
            self.open_stream(route)
            return
        assert self.keys is not None
        port = route.proposal.port or self.shared_port()
        lane = self.lanes.get(port) or self.open_lane(port)
        if lane is None:
            return
        self.lanes[port] = lane
        if isinstance(route, OutgoingRoute):
            writer = DatagramWriter(self.keys.route_sealer(route.id, self.side), self.keys.link_id, route.id)
            route.path = DatagramPath(lane, route, writer)
        elif isinstance(route, IncomingRoute):
            reader = DatagramReader(self.keys.datagram_opener(route.id, self.other_side), route.id)
            route.path = DatagramPath(lane, route, reader)

    def attach_stream(self, route: Route, stream: Stream, beginning: bytes) -> None:
        """A stream of the route's own is let in; `beginning` came behind its opening."""
        assert self.keys is not None
        end = (
            DataWriter(self.keys.route_sealer(route.id, self.side), route.id)
            if route.outgoing
            else DataReader(self.keys.stream_opener(route.id, self.other_side), route.id)
        )
        path = StreamPath(stream, route, end)
        route.path = path
        if beginning:
            path.received(beginning)
        route.advance()

    def datagram(self, lane: Lane, datagram: bytes, address: Address) -> None:
        """A datagram came that says it is this link's."""
        header = parse_header(datagram)
        if header is not None and lane.received(datagram, header.route, address, self.context.now()):
            for route in tuple(self._by_id.values()):
                route.advance()

    # --- the peer's words

    def handle(self, message: ControlMessage) -> None:
        """Do what a control message says."""
        match message:
            case Propose():
                self.spawn(self._consider(message))
            case Ping():
                self.send(Keepalive.answer(message))
            case Pong():
                self._keepalive.answered(message)
            case Report():
                self._take_report(message)
            case ListTopics():
                self.spawn(self._list_topics(message.request))
            case TopicList():
                future = self._requests.pop(message.request, None)
                if future is not None and not future.done():
                    future.set_result(message.topics)
            case Shutdown():
                self.told_to_stop(message)
            case Accept() | Refuse() | Describe() | Ready() | Close() | Pause():
                route = self._by_id.get(message.route)
                if route is not None:  # else it was closed here while the message was under way
                    self._about_route(route, message)

    def _about_route(self, route: Route, message: Accept | Refuse | Describe | Ready | Close | Pause) -> None:
        match message:
            case Accept():
                route.named(message.topic)
                route.agreed(message.type, message.type_hash)
            case Refuse():
                self._by_id.pop(route.id, None)
                route.refuse(f"refused by the other side: {message.reason}")
            case Describe() if isinstance(route, IncomingRoute):
                route.described(message)
            case Ready() if isinstance(route, OutgoingRoute):
                route.peer_ready()
            case Close() if message.removed:
                self.forget(route, f"removed by the other side: {message.reason}")
            case Close():
                self._by_id.pop(route.id, None)
                route.refuse(f"closed by the other side: {message.reason}")
            case Pause():
                route.set_paused(message.paused)

    def _take_report(self, report: Report) -> None:
        for sent in report.sent:
            route = self._by_id.get(sent.route)
            if isinstance(route, IncomingRoute):
                route.reported(sent)
        for received in report.received:
            route = self._by_id.get(received.route)
            if isinstance(route, OutgoingRoute):
                route.reported(received)

    async def _list_topics(self, request: int) -> None:
        topics = await asyncio.to_thread(topics_of, self.context.ros)
        entries = tuple(
            TopicEntry(t.topic, t.type_name, t.type_hash, t.qos, t.publishers, t.subscriptions) for t in topics
        )
        self.send(TopicList(request=request, topics=entries))

    async def remote_topics(self) -> list[TopicInfo]:
        """The peer's graph.

        Raises:
            LinkError: there is no peer now, or it doesn't answer.
        """
        if self.control is None:
            raise LinkError(f"{self.name} is not linked: {self.reason}")
        request = self._next_id  # any number that is not in use
        while request in self._requests:
            request += 1
        future = self._requests[request] = self.context.loop.create_future()
        self.send(ListTopics(request=request))
        try:
            async with asyncio.timeout(_ANSWER_WITHIN):
                entries = await future
        except (TimeoutError, asyncio.CancelledError):
            self._requests.pop(request, None)
            raise LinkError(f"{self.name} did not answer") from None
        return [TopicInfo(e.topic, e.type, e.type_hash, e.qos, e.publishers, e.subscriptions) for e in entries]

    # --- time

    def poll(self) -> None:
        """Four times a second: whatever waits for the graph or the peer."""
        now = self.context.now()
        for lane in self.lanes.values():
            if not lane.ready:
                lane.tick(now)
        if self.linked:
            for route in tuple(self.routes.values()):
                if route.id and not route.flowing:
                    route.advance()

    def tick(self) -> None:
        """Once a second: keepalive, reports, retries, histories."""
        now = self.context.now()
        for route in tuple(self.routes.values()):
            route.tick()
        if self.control is None:
            return
        stream = self.control.stream
        lanes = set(self.lanes.values())
        self.send(
            self._keepalive.tick(
                stream.received_bytes + sum(lane.received_bytes for lane in lanes),
                stream.sent_bytes + sum(lane.sent_bytes for lane in lanes),
                now,
            )
        )
        if self._keepalive.dead(now):
            self.control.abort("the peer is silent")
            return
        for lane in lanes:
            lane.tick(now)
        self._report()
        for route in tuple(self.routes.values()):
            if route.proposed_here and not route.id and now >= route.retry_at:
                self.propose(route)
            elif not route.proposed_here and not route.id and now - self._linked_at > _REPROPOSED_WITHIN:
                self.forget(route, "the other side no longer asks for it")

    def _report(self) -> None:
        routes = [route for route in self.routes.values() if route.id]
        sent = tuple(r.sent_report() for r in routes if isinstance(r, OutgoingRoute))
        received = tuple(r.received_report() for r in routes if isinstance(r, IncomingRoute))
        if sent or received:
            self.send(Report(sent=sent, received=received))

    # --- how it is

    def snapshot(self) -> LinkSnapshot:
        """The link as it is now."""
        now = self.context.now()
        keepalive, keys, peer = self._keepalive, self.keys, self.peer
        return LinkSnapshot(
            name=self.name,
            peer=self.address,
            state=State.OK if self.linked else State.DOWN,
            reason=self.down_reason,
            since=self._since,
            retry_in=None if self.retry_at is None else max(0.0, self.retry_at - now),
            attempts=self.attempts,
            encrypted=self.encrypted,
            cipher=keys.suite.name if keys and self.encrypted else "",
            fingerprint=self.fingerprint,
            rtt=keepalive.clock.rtt,
            clock_offset=keepalive.clock.offset,
            clock_uncertainty=keepalive.clock.uncertainty,
            rx_bytes_per_second=keepalive.rx_rate if self.linked else 0.0,
            tx_bytes_per_second=keepalive.tx_rate if self.linked else 0.0,
            peer_version=peer.version if peer else "",
            peer_domain=peer.domain_id if peer else None,
        )

    def log(self, level: Level, text: str, *, source: str = "link", topic: str = "") -> None:
        """Add an event about this link."""
        self.context.log(level, source, text, link=self.name, topic=topic)
